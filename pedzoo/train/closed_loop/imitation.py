"""Imitating recorded people while walking by oneself: losses on windows that are unrolled step by step."""

from collections.abc import Mapping
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.models.blocks.discriminator import Discriminator
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.train.closed_loop.distribution_distances import SPREADS, features, tail
from pedzoo.train.closed_loop.segments import Policy
from pedzoo.train.closed_loop.unroll import Unrolled, recorded, unroll


class Imitation(nn.Module):
    """Loss for walking unlike recorded people, each term in a unit of its own.

    All people of recorded windows walk together (see `pedzoo.train.closed_loop.unroll.unroll`), and are
    compared with their recorded tracks. Each person is compared by positions at equal times, the crowd by
    speeds, accelerations, turns and distances between people.
    """

    def __init__(
        self,
        displacement: float = 1.0,
        distribution: float = 1.0,
        features: Mapping[str, float] | None = None,
        tail: float = 0.0,
        samples: int = 1,
        spread: float = 0.5,
        adversarial: float = 0.0,
        discriminator: Discriminator | None = None,
        judged_steps: int = 12,
    ) -> None:
        """Weigh the terms.

        Args:
            displacement: Weight of the mean distance to the recorded positions, metres.
            distribution: Weight of the distances of distributions, in standard deviations of recorded
                people: the mean over features, like ``realism`` of the suite ``replay``.
            features: Weight of each feature within it, 1 if not named; see
                `pedzoo.train.closed_loop.distribution_distances.SPREADS`.
            tail: Weight of the difference of the upper tails of acceleration, a share (see
                `distribution_distances.tail`); a mean distance hardly sees few large values.
            samples: K walks of every window with noise of their own, at K times the cost.
            spread: Share of the distance between two walks of a person that is taken off the displacement,
                with 2 or more samples. At 0.5 it is the energy score, least for the true distribution
                (Gneiting and Raftery, JASA 2007, eq. 21); without it the loss punishes all noise.
            adversarial: Weight of a discriminator's loss; 0 leaves it out. The discriminator learns from the
                same ``loss``: an optimizer must get its parameters, all that this module has, too.
            discriminator: Judges walks, ``signed``; a `Discriminator` of its own defaults if not given.
            judged_steps: Most steps that it judges after the observed ones, of people who walk in all of
                them.

        Raises:
            UserError: There is no such feature, or a setting is out of range.
        """
        super().__init__()
        for name in features or {}:
            if name not in SPREADS:
                raise unknown("feature", name, SPREADS)
        self.features = dict.fromkeys(SPREADS, 1.0) | dict(features or {})
        if min(self.features.values()) < 0 or not any(self.features.values()):
            raise UserError(f"features {features}: expected weights of at least 0, and one above it")
        if min(samples, judged_steps) < 1:
            raise UserError(f"samples {samples}, judged_steps {judged_steps}: expected at least 1")
        self.displacement, self.distribution = displacement, distribution
        self.tail, self.samples, self.spread = tail, samples, spread
        self.adversarial, self.judged_steps = adversarial, judged_steps
        self.discriminator = (discriminator or Discriminator(signed=True)) if adversarial else None

    def walk(self, policy: Policy, batch: TensorDict, random: torch.Generator) -> Unrolled:
        """Return K walks of each of B windows (K x B, A, N, ...), all first walks first.

        The policy's safety layer is a part of the walk. Windows have N future steps and the goal protocol
        ``destination``; ``random`` draws the scenes' keys.
        """
        steps = agents_of(batch)["future"].shape[2]
        many = repeated(batch, self.samples)
        key = torch.randint(2**62, (len(many),), generator=random)

        def displacement(seen: TensorDict) -> Tensor:
            return cast("Tensor", policy(seen)["agents", "action"]) * STEP_SECONDS

        return unroll(displacement, many, steps, key)

    def forward(self, policy: Policy, batch: TensorDict, random: torch.Generator) -> dict[str, Tensor]:
        """Return the ``loss`` and its terms before their weights, scalars; arguments as of `walk`."""
        return self.terms(self.walk(policy, batch, random), batch)

    def terms(self, walk: Unrolled, batch: TensorDict) -> dict[str, Tensor]:
        """Return ``loss`` and its terms before their weights, scalars; terms of weight 0 may be missing.

        ``displacement`` (metres), ``distribution`` and each feature's distance (no unit), ``tail`` (a share),
        ``adversarial`` and ``discriminator`` (nats), of the result of `walk` for ``batch``.
        """
        real = recorded(batch, walk.xy.shape[2])
        result = {"displacement": self._displacement(walk, real)}
        loss = self.displacement * result["displacement"]
        if self.distribution or self.tail:
            made = features(walk, repeated(batch, self.samples))
            with torch.no_grad():
                true = features(real, batch)
            apart = {name: wasserstein(made[name], true[name]) / SPREADS[name] for name in SPREADS}
            weighted = torch.stack([self.features[name] * apart[name] for name in SPREADS])
            result["distribution"] = weighted.sum() / sum(self.features.values())
            loss = loss + self.distribution * result["distribution"]
            result |= apart
            if self.tail:
                result["tail"] = tail(made["acceleration"], true["acceleration"])
                loss = loss + self.tail * result["tail"]
        if self.discriminator is not None:
            adversarial = self._adversarial(self.discriminator, walk, real, batch)
            result["adversarial"], result["discriminator"] = adversarial
            loss = loss + self.adversarial * adversarial[0] + adversarial[1]
        return {"loss": loss, **result}

    def _adversarial(
        self, judge: Discriminator, walk: Unrolled, real: Unrolled, batch: TensorDict
    ) -> tuple[Tensor, Tensor]:
        """Return the cross entropies of walking people, to pass as real, and of the discriminator.

        Each has gradients for its own side alone, so one step of one optimizer trains both.
        """
        judge.requires_grad_(False)
        made, _ = self._scores(judge, walk, real, batch)
        judge.requires_grad_(True)
        passing = functional.softplus(-made).sum() / max(1, len(made))
        made, true = self._scores(judge, walk._replace(xy=walk.xy.detach()), real, batch)
        telling = (functional.softplus(made).sum() + functional.softplus(-true).sum()) / max(1, len(made))
        return passing, telling

    def _scores(
        self, judge: Discriminator, walk: Unrolled, real: Unrolled, batch: TensorDict
    ) -> tuple[Tensor, Tensor]:
        """Return scores of walks and of the real ones (M,), of people who walk in all steps of both."""
        steps = min(self.judged_steps, walk.xy.shape[2])
        agents = agents_of(repeated(batch, self.samples))
        both = Crowd.of(torch.cat((agents["mask"], agents["mask"])))
        crowd, history = Crowd.of(agents["mask"]), agents["history"]
        true = real.xy.repeat(self.samples, 1, 1, 1)
        paths = [torch.cat((history[:, :, -1:], xy[:, :, :steps]), 2).diff(dim=2) for xy in (walk.xy, true)]
        futures = torch.stack([crowd.pack(way) for way in paths])
        observed = crowd.pack(history)
        scores = judge.of_futures(observed.diff(dim=1), futures, observed[:, 0], both)
        walks = walk.walked[..., :steps] & real.walked[..., :steps].repeat(self.samples, 1, 1)
        judged = crowd.pack(agents["valid"].all(2) & walks.all(2))
        made, true = scores.chunk(2)
        return made[judged], true[judged]

    def _displacement(self, walk: Unrolled, real: Unrolled) -> Tensor:
        """Return the mean distance to real positions in steps in which both walk, less that of samples."""
        xy = walk.xy.unflatten(0, (self.samples, -1))
        both = walk.walked.unflatten(0, (self.samples, -1)) & real.walked
        loss = _mean(_distance(xy, real.xy), both)
        if self.samples == 1 or not self.spread:
            return loss
        # neighbours in a ring: as many pairs as samples
        other, together = xy.roll(1, 0), both & both.roll(1, 0)
        return loss - self.spread * _mean(_distance(xy, other), together)


def repeated(batch: TensorDict, times: int) -> TensorDict:
    """Return a batch so many times, one after the other."""
    return batch if times == 1 else cast("TensorDict", TensorDict.cat([batch] * times))


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return (first - second).square().sum(-1).clamp_min(1e-12).sqrt()


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return values[where].sum() / where.sum().clamp_min(1)
