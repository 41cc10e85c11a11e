"""The loss of a crowd that walks unlike the recorded one, and the judges that learn to tell them apart."""

import math
from collections import deque
from collections.abc import Mapping
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.types import OBS_LEN
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.metrics.realism.features import CHANNELS, LENGTH
from pedzoo.train.closed_loop.imitation import SPREADS
from pedzoo.train.crowds.comparison import MANNER_DIM, coarse, compared, parted, summaries
from pedzoo.train.crowds.crowd_walk import CrowdWalk, recorded
from pedzoo.train.crowds.excerpts import Excerpts

COARSE = {"speed": 1.0, "acceleration": 2.0, "heading_rate": 1.5}
"""Weights of features of coarse positions: of changes less is left."""

TAILS = 0.5
"""Weight of distances of logarithms: what is held, what stands, and the few large values count there."""

LARGEST = 0.03
"""Share of accelerations that are compared once more: in a distribution the few large ones count little."""

PLACES = (3, 8, 14, 22, 30)
"""Steps after which places are compared."""

_LEAST_CLIPS = 8
"""Fewer clips teach a judge nothing."""

_LARGEST = 6.0
"""Standard deviations: rarer values are all alike."""


def legible(clips: Tensor, manner: Tensor) -> Tensor:
    """Return clips (W, 8, 14) as a network reads them (W, N): changes and distances, small and large.

    ``manner`` (W, M) says how the people began to walk.
    """
    velocity, change, near, relative, seconds, exit = clips.split((2, 2, 4, 4, 1, 1), 2)
    distance = (near.unflatten(2, (2, 2)).square().sum(3) + 1e-6).sqrt()
    parts = (
        velocity,
        (change / 0.05).asinh(),
        (change / 0.5).asinh(),
        near.asinh(),
        (-distance).exp(),
        relative,
        seconds,
        exit.asinh(),
    )
    held = ((velocity[:, 1:] - velocity[:, :-1]) / 0.02).asinh()
    return torch.cat([*(part.flatten(1) for part in parts), held.flatten(1), manner], 1)


class CrowdDiscriminator(nn.Module):
    """A network, and the clips of the last updates."""

    mean: Tensor
    scale: Tensor

    def __init__(self, hidden_dim: int = 96, buffer: int = 40, drawn: int = 3) -> None:
        """Create the parameters.

        Args:
            hidden_dim: Width of the first hidden layer.
            buffer: Updates whose clips are stored.
            drawn: Of these are drawn for each step of the judge, beside the present one. Both crowds of an
                update are of one recording: recordings differ more than crowds.
        """
        super().__init__()
        size = legible(torch.zeros(1, LENGTH, len(CHANNELS)), torch.zeros(1, MANNER_DIM)).shape[1]
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("scale", torch.zeros(size))
        self.net = nn.Sequential(
            nn.Linear(size, hidden_dim), nn.LeakyReLU(0.2), nn.Linear(hidden_dim, 64), nn.LeakyReLU(0.2),
            nn.Linear(64, 1),
        )  # fmt: skip
        self.drawn = drawn
        self._past: deque[tuple[Tensor, Tensor]] = deque(maxlen=buffer)

    def forward(self, rows: Tensor) -> Tensor:
        """Return how real clips look (W,), logits, from what is `legible` of them (W, N)."""
        rows = (rows - self.mean) / self.scale.clamp_min(0.02)
        return self.net(rows.clamp(-_LARGEST, _LARGEST))[:, 0]

    def remember(self, made: Tensor, true: Tensor) -> None:
        """Take what is `legible` of an update's clips (W, N): of people who walk, and of recorded ones."""
        if not self._past:
            self.mean, self.scale = true.mean(0), true.std(0)
        self._past.append((made.detach(), true.detach()))

    def learning(self, random: torch.Generator) -> Tensor:
        """Return the cross entropy of the judge on the last clips, and on those of updates that are drawn."""
        picked = torch.randint(len(self._past), (self.drawn,), generator=random).tolist()
        pairs = [self._past[-1], *(self._past[number] for number in picked)]
        costs = [
            functional.softplus(self(made)).mean() + functional.softplus(-self(true)).mean()
            for made, true in pairs
        ]
        return torch.stack(costs).mean() / 2

    def passing(self, made: Tensor) -> Tensor:
        """Return the cost of clips (W, N) that do not pass as real; without gradients for the judge."""
        self.requires_grad_(False)
        cost = functional.softplus(-self(made)).mean()
        self.requires_grad_(True)
        return cost


class CrowdLikeness(nn.Module):
    """Compares K walks of a crowd with the recorded one."""

    def __init__(
        self,
        distribution: float = 3.0,
        places: float = 1.0,
        persons: float = 0.5,
        judged: float = 1.0,
        judge_steps: int = 3,
        near: float = 2.0,
        nearest: float = 0.4,
        safety_correction: float = 0.5,
        company: float = 0.0,
    ) -> None:
        """Weigh the terms.

        Args:
            distribution: Distances of the distributions of features, as they are and coarse, in standard
                deviations of recorded people; accelerations count once more by their largest 3 %.
            places: Energy score of places after some steps (Gneiting and Raftery, JASA 2007, eq. 21).
            persons: Energy score of the numbers that sum up each person's walk.
            judged: Cross entropy of two judges, of clips as they are and of coarse ones.
            judge_steps: Steps of the judges in each update.
            near: Metres short of ``nearest`` between two people.
            nearest: Metres between centres.
            safety_correction: Change by a safety layer, m/s.
            company: How far companions walk from each other, see `parted`.
        """
        super().__init__()
        self.weights = {"distribution": distribution, "places": places, "persons": persons, "judged": judged}
        self.weights |= {"near": near, "safety_correction": safety_correction, "company": company}
        self.nearest, self.judge_steps = nearest, judge_steps
        self.judges = nn.ModuleDict(
            {"fine": CrowdDiscriminator(), "coarse": CrowdDiscriminator()} if judged else {}
        )

    def forward(
        self,
        walk: CrowdWalk,
        real: Excerpts,
        samples: int,
        before: int,
        optimizer: torch.optim.Optimizer | None,
        random: torch.Generator,
    ) -> dict[str, Tensor]:
        """Return the weighted terms, scalars; the judges learn first.

        Args:
            walk: Walks of K x B excerpts, all first walks first.
            real: The B excerpts.
            samples: K.
            before: Frames that are not scored, see `pedzoo.train.crowds.crowd_walk.walked_on`.
            optimizer: Of the judges; None to leave them as they are.
            random: Draws earlier updates for the judges.
        """
        many, truth = real.repeated(samples), recorded(real, before)
        terms: dict[str, Tensor] = {}
        apart, passing = [], []
        for name, made_walk, true_walk in (
            ("fine", walk, truth),
            ("coarse", coarse(walk), coarse(truth)),
        ):
            made = compared(made_walk, many)
            with torch.no_grad():
                true = compared(true_walk, real)
            weights: Mapping[str, float] = dict.fromkeys(SPREADS, 1.0) if name == "fine" else COARSE
            apart += [
                TAILS * wasserstein(*(_log(side.features[key]) for side in (made, true)))
                for key in ("acceleration", "speed", "heading_rate")
            ]
            apart += [
                weight * wasserstein(made.features[key], true.features[key]) / SPREADS[key]
                for key, weight in weights.items()
            ]
            strong = (largest(side.features["acceleration"]) for side in (made, true))
            apart.append(weights["acceleration"] * wasserstein(*strong) / SPREADS["acceleration"])
            if self.judges and min(len(made.clips), len(true.clips)) >= _LEAST_CLIPS:
                judge = cast("CrowdDiscriminator", self.judges[name])
                looks = legible(made.clips, made.manner)
                if optimizer is not None:
                    judge.remember(looks, legible(true.clips, true.manner))
                    for _ in range(self.judge_steps):
                        optimizer.zero_grad()
                        judge.learning(random).backward()
                        optimizer.step()
                passing.append(judge.passing(looks))
        terms["distribution"] = torch.stack(apart).mean()
        terms["places"] = _places(walk, truth, many, samples)
        terms["persons"] = _persons(walk, truth, many, samples)
        terms["near"] = _too_near(walk, self.nearest)
        if self.weights["company"]:
            terms["company"] = parted(walk, truth, many, real)
        if passing:
            terms["judged"] = torch.stack(passing).mean()
        if walk.asked is not None and walk.walked is not None:
            change = ((walk.asked - walk.walked).square().sum(-1) + 1e-8).sqrt()
            mine = walk.scored[:, :, -change.shape[2] :]
            terms["safety_correction"] = (change * mine).sum() / mine.sum().clamp_min(1)
        return {key: self.weights[key] * value for key, value in terms.items()}


def largest(values: Tensor) -> Tensor:
    """Return the largest 3 % of values (N,), at least one of them."""
    return values.topk(math.ceil(LARGEST * len(values))).values


def _log(values: Tensor) -> Tensor:
    return (values + 0.02).log()


def _places(walk: CrowdWalk, truth: CrowdWalk, real: Excerpts, samples: int) -> Tensor:
    """Return the energy score of places, in units of usual errors; people who arrived are at their exit."""
    scenes = len(truth.xy)
    total = []
    steps = walk.xy.shape[2] - OBS_LEN
    for step in [step for step in PLACES if step <= steps] or [steps]:
        frame = OBS_LEN - 1 + step
        walks = (real.walks & (real.taken < OBS_LEN) & (real.last >= OBS_LEN))[:scenes]
        made = walk.xy[:, :, frame].unflatten(0, (samples, scenes))
        true = torch.where(truth.there[:, :, frame].unsqueeze(2), truth.xy[:, :, frame], real.exit[:scenes])
        score = _energy(made, true)
        usual = 0.12 * step**0.75 + 0.1
        total.append((score * walks).sum() / walks.sum().clamp_min(1) / usual)
    return torch.stack(total).mean()


def _persons(walk: CrowdWalk, truth: CrowdWalk, real: Excerpts, samples: int) -> Tensor:
    """Return the energy score of the summaries of walks."""
    made, has_made = summaries(walk, real)
    true, has_true = summaries(truth, Excerpts(*(value[: len(truth.xy)] for value in real)))
    both = has_made.unflatten(0, (samples, -1)).all(0) & has_true
    score = _energy(made.unflatten(0, (samples, -1)), true)
    return (score * both).sum() / both.sum().clamp_min(1)


def _energy(made: Tensor, true: Tensor) -> Tensor:
    """Return the energy score (B, A) of samples (K, B, A, N) for the true values (B, A, N)."""
    score = _distance(made, true).mean(0)
    # neighbours in a ring: as many pairs as samples
    return score - 0.5 * _distance(made, made.roll(1, 0)).mean(0) if len(made) > 1 else score


def _too_near(walk: CrowdWalk, nearest: float) -> Tensor:
    """Return by how many metres people come nearer to others than they should, per step."""
    begin = OBS_LEN
    xy, there = (values.transpose(1, 2)[:, begin:] for values in (walk.xy, walk.there))
    scored = walk.scored.transpose(1, 2)[:, begin:]
    apart = _distance(xy.unsqueeze(2), xy.unsqueeze(3))
    pairs = there.unsqueeze(2) & scored.unsqueeze(3)
    pairs &= ~torch.eye(there.shape[2], dtype=torch.bool, device=xy.device)
    short = (nearest - apart).clamp_min(0)
    return torch.where(pairs, short, 0.0).sum() / scored.sum().clamp_min(1)


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return ((first - second).square().sum(-1) + 1e-10).sqrt()
