"""Displacement errors of forecasts, metres: pure functions and their torchmetrics classes.

``error`` is always the distance to the truth (B, K, A, T), ``valid`` (B, A, T) bool says which of the
truth is known. Minima over samples come in two forms that must never share a column: *per scene*, one
sample for all people of a window together (Gupta et al., "Social GAN", CVPR 2018), and *per agent*.
"""

import torch
from torch import Tensor
from torchmetrics import Metric

from pedzoo.core.errors import UserError

MISS = 2.0
"""Metres: a forecast that ends farther off has missed."""


def positions(prediction: Tensor, history: Tensor) -> Tensor:
    """Return where displacements (B, K, A, T, 2) lead from the last observed positions: (B, K, A, T, 2)."""
    return history[:, None, :, -1:, :] + prediction.cumsum(-2)


def displacement_error(prediction: Tensor, history: Tensor, future: Tensor) -> Tensor:
    """Return distances (B, K, A, T) of predicted displacements (B, K, A, T, 2) from the true future.

    Raises:
        UserError: They have another shape: torch would stretch them silently.
    """
    given = tuple(prediction.shape) if isinstance(prediction, Tensor) else ()
    if given[:1] + given[2:] != future.shape:
        scenes, *rest = future.shape
        raise UserError(
            f"a model returned {given or type(prediction).__name__}: expected displacements (B, K, A, T, 2), "
            f"here {(scenes, 'K', *rest)}; pedzoo.models.base.for_all_samples makes them from one path"
        )
    return (positions(prediction, history) - future.unsqueeze(1)).norm(dim=-1)


def average(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return per-agent means over the known steps (B, K, A) and whether there is any (B, A)."""
    known = valid.unsqueeze(1)
    count = known.sum(-1)
    return error.where(known, 0).sum(-1) / count.clamp(min=1), (count > 0).squeeze(1)


def final(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the error (B, K, A) at the last step and whether the truth is known there (B, A)."""
    return error[..., -1], valid[..., -1]


def next_step(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the error (B, K, A) at the first step, the only one that a simulation walks."""
    return error[..., 0], valid[..., 0]


def min_per_scene(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's error (B, A) in the one sample that is best for their whole scene."""
    total = per_agent.where(there.unsqueeze(1), 0).sum(-1)
    best = total.argmin(1)
    return per_agent[torch.arange(len(best), device=best.device), best]


def min_per_agent(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's smallest error (B, A) over their own samples."""
    return per_agent.amin(1)


def mean_over_samples(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's mean error (B, A) over the samples: what one random sample costs."""
    return per_agent.mean(1)


class SceneMean(Metric):
    """A sum over people with their count; state in float64, summed over processes.

    Attributes:
        latest: Sums and counts (B,) of each scene of the last update, for intervals over scenes.
    """

    higher_is_better: bool | None = False
    full_state_update = False
    total: Tensor
    count: Tensor
    latest: tuple[Tensor, Tensor]

    def __init__(self) -> None:
        """Begin without people."""
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    def add(self, value: Tensor, count: Tensor) -> None:
        """Add a batch: each person's value (B, A), zero where not counted, and each scene's count (B,)."""
        self.latest = value.sum(1, dtype=torch.float64), count
        self.total += value.sum(dtype=torch.float64)
        self.count += count.sum()

    def compute(self) -> Tensor:
        """Return the mean; NaN before the first batch."""
        return self.total / self.count


class AgentMean(SceneMean):
    """Mean over agents of an error, metres, reduced over samples.

    Attributes:
        of: Which error: `average`, `final` or `next_step`.
        over_samples: How samples are reduced.
    """

    of = staticmethod(average)
    over_samples = staticmethod(mean_over_samples)

    def update(self, error: Tensor, valid: Tensor) -> None:
        """Add a batch: ``error`` (B, K, A, T), ``valid`` (B, A, T)."""
        per_agent, there = self.of(error, valid)
        self.add(self.over_samples(per_agent, there).where(there, 0), there.sum(1))


class ADE(AgentMean):
    """Average displacement error: mean over agents and steps (and samples)."""


class FDE(AgentMean):
    """Final displacement error: at the last predicted step."""

    of = staticmethod(final)


class NextStepError(AgentMean):
    """Displacement error of the first predicted step."""

    of = staticmethod(next_step)


class MinADEScene(AgentMean):
    """ADE of the sample that is best for all people of a scene together (Social GAN's best-of-K)."""

    over_samples = staticmethod(min_per_scene)


class MinFDEScene(FDE):
    """FDE likewise; its best sample is chosen by FDE and may be another one."""

    over_samples = staticmethod(min_per_scene)


class MinADEAgent(AgentMean):
    """ADE of each person's own best sample."""

    over_samples = staticmethod(min_per_agent)


class MinFDEAgent(FDE):
    """FDE of each person's own best sample."""

    over_samples = staticmethod(min_per_agent)


class FinalOfBestADE(AgentMean):
    """FDE of the sample that is best by ADE: what minima taken apart leave out."""

    def update(self, error: Tensor, valid: Tensor) -> None:
        """Add a batch: ``error`` (B, K, A, T), ``valid`` (B, A, T)."""
        last, there = final(error, valid)
        best = average(error, valid)[0].argmin(1, keepdim=True)
        self.add(last.gather(1, best).squeeze(1).where(there, 0), there.sum(1))


class MissRate(AgentMean):
    """Share of people of whom no sample ends within `MISS` metres of the truth."""

    def update(self, error: Tensor, valid: Tensor) -> None:
        """Add a batch: ``error`` (B, K, A, T), ``valid`` (B, A, T)."""
        last, there = final(error, valid)
        self.add((last.amin(1) > MISS).where(there, False).to(error.dtype), there.sum(1))


class SampleDistance(SceneMean):
    """Mean distance between the positions of two samples of the same person at the same step, metres.

    It shows whether samples differ: 0 for a deterministic model.
    """

    higher_is_better = None

    def update(self, prediction: Tensor, mask: Tensor) -> None:
        """Add a batch: ``prediction`` displacements (B, K, A, T, 2), ``mask`` (B, A)."""
        samples = prediction.shape[1]
        people = prediction.cumsum(-2).movedim(1, -2)[mask]  # (P, T, K, 2)
        self.count += people.shape[0] * people.shape[1]
        if samples == 1:
            return  # a deterministic model: one sample stands for all, at distance 0
        first, second = torch.triu_indices(samples, samples, 1, device=mask.device)
        # a few people at a time: all pairs of all people at once would not fit a cache
        for some in people.split(256):
            self.total += (
                (some[..., first, :] - some[..., second, :]).norm(dim=-1).mean(-1).sum(dtype=torch.float64)
            )
