"""What all models with anchors share: people's frames, the mixture of futures, draws from it, and its loss.

An anchor is a typical future in the frame of a walking person, in units of the person's speed: a centroid of
training futures by k-means. A model moves the anchors and says how likely each of the resulting modes is.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.cluster.vq import kmeans2
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import agents_of, goals_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS, TIMED, GoalProtocol
from pedzoo.models.base import Forecaster, Random, known_displacements
from pedzoo.models.blocks.mixture import FutureMixture
from pedzoo.models.blocks.people import ego_frame, linear_extrapolation
from pedzoo.models.blocks.people.crowd import Crowd

SPEEDS, UNIT = (0.1, 0.338, 0.6), 0.338
"""Metres per step of 0.4 s: bounds of the classes of speeds, each of which has anchors of its own, and the
speed beyond which futures are measured in people's own speed.
"""

LEAST = 0.02
"""Metres per step: the smallest standard deviation, since standing people are recorded at one place."""

MOST, FEW = 20_000, 4
"""Futures that k-means looks at, at most: more change the centroids by less than the seed does. And those per
centroid below which a class of speeds takes the futures of all classes.
"""


@dataclass(frozen=True)
class AnchorLosses:
    """Losses of the training, metres unless they say otherwise.

    Attributes:
        final_weight: Weight of the best final error beside the best average one.
        guess_weight: Weight of the average error of the one best guess.
        choice_weight: Weight of the cross-entropy, nats, of the mode that was best.
        reverse: Whether half of the batches run backwards in time.
    """

    final_weight: float = 0.5
    guess_weight: float = 0.5
    choice_weight: float = 0.1
    reverse: bool = True


class AnchorInputs(NamedTuple):
    """The people of a batch, each in their own frame."""

    history: Tensor  # positions (P, 8, 2) from the last one, metres
    aims: Tensor | None  # goal and desired velocity (P, 2, 2), metres and m/s; None without a goal
    base: Tensor  # positions (P, T, 2) that anchors are added to, metres
    speed: Tensor  # last displacement's length (P,), metres
    unit: Tensor  # metres (P, 1) of one unit of the anchors
    heading: Tensor  # directions of the frames (P, 2)
    crowd: Crowd


class ModePredictions(NamedTuple):
    """What a model says about P people, in units of the anchors."""

    path: Tensor  # positions (P, M + 1, T, 2) from the base: modes, and last the one best guess
    logits: Tensor  # unnormalised log probabilities of the modes (P, M)
    log_scale: Tensor  # log standard deviations of displacements (P, M, T, 2)


class AnchorForecaster(Forecaster):
    """A mixture of modes; subclasses move the anchors.

    The noise of a walking person is one number, which chooses the mode from right to left.
    """

    mode_at_zero = True

    def __init__(
        self, steps: int, modes: int, goal_protocol: GoalProtocol | None, losses: AnchorLosses
    ) -> None:
        """Make room for M ``modes`` of T ``steps`` of 0.4 s. Raises UserError: there are too few."""
        super().__init__()
        if steps < 1 or modes < 2:
            raise UserError(f"steps {steps}, modes {modes}: expected at least 1 step and 2 modes")
        self.steps, self.modes, self.losses = steps, modes, losses
        self.noise_dim, self.goal_protocol = 1, goal_protocol
        classes = len(SPEEDS) + 1
        self.register_buffer("centroids", fan(modes, steps).expand(classes, -1, -1, -1).clone())
        self.register_buffer("fitted", torch.zeros((), dtype=torch.bool))
        self.logits = nn.Parameter(torch.zeros(classes, modes))
        self.log_scale = nn.Parameter(torch.full((classes, modes, steps, 2), -2.0))

    def write(self, batch: TensorDict, seen: AnchorInputs) -> ModePredictions:
        """Return what the model says; by default the anchors of people's speeds."""
        which = _speed_class(seen)
        return ModePredictions(self.get_buffer("centroids")[which], self.logits[which], self.log_scale[which])

    @torch.no_grad()
    def prepare(self, batches: Iterable[TensorDict], seed: int = 0) -> None:
        """Cluster the futures of training batches; later calls change nothing."""
        if self.get_buffer("fitted"):
            return
        parts: list[tuple[Tensor, Tensor]] = []
        for batch in batches:
            self.check(batch)
            seen = self.see(batch)
            known = seen.crowd.pack(agents_of(batch)["future_valid"]).all(-1)
            offsets = (self.truth(batch, seen) - seen.base) / seen.unit.unsqueeze(-1)
            parts.append((offsets[known], _speed_class(seen)[known]))
        offsets, which = (torch.cat(part) for part in zip(*parts, strict=True))
        if not len(offsets):
            raise UserError(
                "no person of the training data has a whole future: set --data.keep_people complete"
            )
        for number, centroids in enumerate(self.get_buffer("centroids")):
            mine = offsets[which == number]
            result = clustered(mine if len(mine) >= FEW * self.modes else offsets, self.modes, seed)
            centroids.copy_(result.centroids)
            self.logits[number] = result.logits
            self.log_scale[number] = result.scale.clamp_min(1e-3).log()
        self.get_buffer("fitted").fill_(True)

    def check(self, batch: TensorDict) -> None:
        """Check that training data have as many steps as the model. Raises UserError: they have not."""
        steps = agents_of(batch)["future"].shape[2]
        if steps != self.steps:
            raise UserError(
                f"the data predict {steps} steps and the model {self.steps}: set both, --data.pred_len and "
                f"--model.generator.architecture.steps {steps}"
            )

    def see(self, batch: TensorDict) -> AnchorInputs:
        """Return the people of a batch in their own frames."""
        agents = agents_of(batch)
        crowd = Crowd.of(agents["mask"])
        history = crowd.pack(agents["history"])
        moved, aims = history.diff(dim=1), None
        if "goal" in self.needs:
            goal, wanted = (crowd.pack(value) for value in goals_of(batch, "this model"))
            aims = torch.stack((goal - history[:, -1], wanted), 1)
        heading = ego_frame.heading(moved, None if aims is None else aims[:, 0])
        own = ego_frame.into(heading, history - history[:, -1:])
        last = ego_frame.into(heading, moved[:, -1])
        base = own.new_zeros(len(own), self.steps, 2)
        if aims is not None:
            aims = ego_frame.into(heading, aims)
            base = linear_extrapolation.bent_line(last, aims[:, 0], self.steps, self.goal_protocol in TIMED)
            base = base.cumsum(1)
        speed = (last.square().sum(-1) + 1e-12).sqrt()
        return AnchorInputs(own, aims, base, speed, speed.clamp_min(UNIT).unsqueeze(-1), heading, crowd)

    def truth(self, batch: TensorDict, seen: AnchorInputs) -> Tensor:
        """Return true positions (P, T, 2) from the last observed one, in each person's frame."""
        agents = agents_of(batch)
        return ego_frame.into(seen.heading, seen.crowd.pack(agents["future"] - agents["history"][:, :, -1:]))

    def placed(self, written: ModePredictions, seen: AnchorInputs) -> Tensor:
        """Return positions (P, M + 1, T, 2), metres, of what was written in units of the anchors."""
        return seen.base.unsqueeze(1) + written.path * seen.unit.view(-1, 1, 1, 1)

    def mixture(self, written: ModePredictions, seen: AnchorInputs) -> FutureMixture:
        """Return the density of displacements in each person's frame."""
        path = self.placed(written, seen)[:, :-1]
        scale = written.log_scale.exp() * seen.unit.view(-1, 1, 1, 1) + LEAST
        return FutureMixture(written.logits, _displacements(path), scale)

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return random futures (B, K, A, T, 2): modes by their probabilities.

        A sample is one of all people of a scene: who would touch others draws once more.
        """
        futures = self._futures(batch)
        path = self._drawn(*futures, samples, steps, generator)
        again = self._drawn(*futures, samples, steps, generator)
        agents = agents_of(batch)
        there = agents["mask"]
        here = torch.where(there[..., None, None], agents["history"][:, :, -1:], 0.0)
        place = (here.unsqueeze(1) + path.cumsum(3)).transpose(2, 3)
        near = torch.cdist(place, place) < 2 * BODY_RADIUS
        near &= (there.unsqueeze(1) & there.unsqueeze(2))[:, None, None]
        near.diagonal(dim1=-2, dim2=-1).fill_(False)  # nobody touches themselves
        return torch.where(near.any(-1).any(2)[..., None, None], again, path)

    def candidates(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return the ``samples`` likeliest modes of each person (B, K, A, T, 2), and draws beyond all."""
        seen, mixture = self._futures(batch)
        order = mixture.logits.argsort(-1, descending=True).T[:samples]
        path = self._world(seen, torch.stack([mixture.mean_of(one) for one in order]), steps)
        if samples <= self.modes:
            return path
        return torch.cat((path, self._drawn(seen, mixture, samples - self.modes, steps, generator)), 1)

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the one best guess (B, 1, A, T, 2): of all futures the one that is least far off."""
        seen = self.see(batch)
        path = self.placed(self.write(batch, seen), seen)[:, -1]
        return self._world(seen, _displacements(path).unsqueeze(0), steps)

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first steps of the best guess, or of the mode that the noise chooses."""
        if noise is None:
            return self.mode(batch, steps)[:, 0]
        seen, mixture = self._futures(batch)
        chosen = mixture.at_quantile(torch.special.ndtr(seen.crowd.pack(noise)[:, 0]))
        return self._world(seen, mixture.mean_of(chosen).unsqueeze(0), steps)[:, 0]

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return the loss, summed over people: that of `AnchorLosses`, and the likelihood of the widths."""
        self.check(batch)
        if self.losses.reverse and torch.rand((), generator=generator) < 0.5:
            batch = reversed_in_time(batch, self.goal_protocol)
        seen = self.see(batch)
        written, truth = self.write(batch, seen), self.truth(batch, seen)
        known = seen.crowd.pack(agents_of(batch)["future_valid"])
        path = self.placed(written, seen)
        error = ((path - truth.unsqueeze(1)).square().sum(-1) + 1e-8).sqrt() * known.unsqueeze(1)
        average = error.sum(-1) / known.sum(-1, keepdim=True).clamp_min(1)
        best = average[:, :-1].min(1)
        own = self.losses
        cost = best.values + own.final_weight * error[:, :-1, -1].amin(1) + own.guess_weight * average[:, -1]
        choice = functional.cross_entropy(written.logits, best.indices, reduction="none")
        # the widths alone learn from the likelihood, of the mode that was best
        person = torch.arange(len(best.indices), device=truth.device)
        wrong = _displacements(path[person, best.indices].detach() - truth)
        scale = written.log_scale[person, best.indices].exp() * seen.unit.unsqueeze(-1) + LEAST
        moves = seen.crowd.pack(known_displacements(batch))
        nats = (0.5 * (wrong / scale).square() + scale.log()).sum(-1) * moves
        nats = nats.sum(-1) / moves.sum(-1).clamp_min(1)
        return ((cost + own.choice_weight * choice + nats) * known.any(-1)).sum()

    @torch.no_grad()
    def log_likelihood(self, batch: TensorDict, generator: Random = None) -> Tensor | None:
        """Return each person's log density (B, A), nats; None for other numbers of steps than trained."""
        if agents_of(batch)["future"].shape[2] != self.steps:
            return None
        seen, mixture = self._futures(batch)
        known = seen.crowd.pack(known_displacements(batch))
        return seen.crowd.unpack(mixture.log_prob(_displacements(self.truth(batch, seen)), known))

    def _futures(self, batch: TensorDict) -> tuple[AnchorInputs, FutureMixture]:
        seen = self.see(batch)
        return seen, self.mixture(self.write(batch, seen), seen)

    def _drawn(
        self, seen: AnchorInputs, mixture: FutureMixture, samples: int, steps: int, random: Random
    ) -> Tensor:
        device = mixture.logits.device
        drawn_on = random.device if random else device
        share = torch.rand(samples, len(mixture.logits), generator=random, device=drawn_on)
        many = FutureMixture(*(value.expand(samples, *value.shape) for value in mixture))
        return self._world(seen, many.mean_of(many.at_quantile(share.to(device))), steps)

    def _world(self, seen: AnchorInputs, path: Tensor, steps: int) -> Tensor:
        """Return displacements (K, P, T, 2) in people's frames as (B, K, A, steps, 2) in the world."""
        # beyond the steps of the training the last one is repeated
        more = path[:, :, -1:].expand(-1, -1, max(steps - self.steps, 0), -1)
        path = ego_frame.out_of(seen.heading, torch.cat((path, more), 2)[:, :, :steps])
        return seen.crowd.unpack_samples(path)


def _speed_class(seen: AnchorInputs) -> Tensor:
    return torch.bucketize(seen.speed, seen.speed.new_tensor(SPEEDS))


def _displacements(path: Tensor) -> Tensor:
    """Return displacements of positions (..., T, 2) from the last observed one."""
    return torch.cat((path[..., :1, :], path.diff(dim=-2)), -2)


class Clusters(NamedTuple):
    """Futures (..., T, 2), positions from here, in the units and frames that they were given in."""

    centroids: Tensor  # M centroids from right to left and, as the last one, the mean of all (M + 1, T, 2)
    logits: Tensor  # log shares of the futures that each of the M is nearest to (M,)
    scale: Tensor  # standard deviations of displacements around a centroid's (M, T, 2)


def clustered(futures: Tensor, modes: int, seed: int) -> Clusters:
    """Return clusters of futures (N, T, 2) by k-means of ``modes`` centroids; N is at least 1."""
    steps = futures.shape[1]
    random = np.random.default_rng(seed)
    points = futures.flatten(1).double().cpu().numpy()
    if len(points) > MOST:
        points = points[random.choice(len(points), MOST, replace=False)]
    elif len(points) < modes:
        points = np.resize(points, (modes, points.shape[1]))
    # of equal points, as of people who stand, no two can be centroids
    points = points + random.normal(0, 1e-5, points.shape)
    centroids, nearest = kmeans2(points, modes, iter=100, minit="++", rng=random, missing="warn")
    order = np.argsort(np.arctan2(centroids[:, -1], centroids[:, -2] + 1e-9), kind="stable")
    centroids, label = centroids[order], torch.from_numpy(np.argsort(order)[nearest])
    count = torch.bincount(label, minlength=modes).float()
    moved, typical = (
        torch.from_numpy(np.diff(each.reshape(-1, steps, 2), axis=1, prepend=0)).float()
        for each in (points, centroids)
    )
    squared = (moved - typical[label]).square()
    # one more future, as far off as all are: a cluster of one is not certain
    total = squared.mean(0).expand(modes, -1, -1).clone().index_add_(0, label, squared)
    centres = torch.from_numpy(np.concatenate((centroids, points.mean(0, keepdims=True)))).float()
    logits = ((count + 1) / (count + 1).sum()).log()
    return Clusters(centres.view(-1, steps, 2), logits, (total / (count + 1).view(-1, 1, 1)).sqrt())


def fan(modes: int, steps: int) -> Tensor:
    """Return futures (modes + 1, T, 2) for models that have seen no data: even walks in many directions."""
    angle = torch.linspace(-1, 1, modes) * math.pi / 3
    speed = 0.5 + 0.75 * torch.arange(modes).remainder(4) / 3
    step = torch.cat((speed.unsqueeze(1) * torch.stack((angle.cos(), angle.sin()), 1), torch.eye(2)[:1]))
    return step.unsqueeze(1) * torch.arange(1, steps + 1).view(-1, 1)


def reversed_in_time(batch: TensorDict, goal: GoalProtocol | None) -> TensorDict:
    """Return a batch of recorded scenes that run backwards, with the people who are known throughout.

    A destination lies outside of the window: batches with other goals than ``window_end`` stay as they are.
    """
    if goal not in (None, "none", "window_end"):
        return batch
    agents = agents_of(batch)
    observed = agents["history"].shape[2]
    place = torch.cat((agents["history"], agents["future"]), 2).flip(2)
    known = torch.cat((agents["valid"], agents["future_valid"]), 2).all(2) & agents["mask"]
    history, future = place[:, :, :observed], place[:, :, observed:]
    changed = {
        "history": history,
        "future": future,
        "valid": known.unsqueeze(2).expand(history.shape[:3]),
        "future_valid": known.unsqueeze(2).expand(future.shape[:3]),
        "velocity": (history[:, :, -1] - history[:, :, -2]) / STEP_SECONDS,
        "mask": known,
    }
    if goal == "window_end":
        to_goal = functional.normalize(future[:, :, -1] - history[:, :, -1], dim=-1)
        changed |= {"goal": future[:, :, -1], "desired_velocity": agents["pref_speed"] * to_goal}
    result = batch.clone(recurse=False)
    result["agents"] = agents.clone(recurse=False).update(changed)
    return result
