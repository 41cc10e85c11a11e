"""Displacement errors of forecasts, metres.

``error`` is always the distance to the truth (B, K, A, T), ``valid`` (B, A, T) bool says which of the
truth is known. Minima over samples come in two forms that must never share a column: *per scene*, one
sample for all people of a window together (Gupta et al., "Social GAN", CVPR 2018), and *per agent*.
"""

from collections.abc import Callable

import torch
from torch import Tensor

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
    """Return per-agent means over the known steps (B, K, A) and whether there is any (B, A): ADE."""
    known = valid.unsqueeze(1)
    count = known.sum(-1)
    return error.where(known, 0).sum(-1) / count.clamp(min=1), (count > 0).squeeze(1)


def final(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the error (B, K, A) at the last step and whether the truth is known there (B, A): FDE."""
    return error[..., -1], valid[..., -1]


def next_step(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the error (B, K, A) at the first step, the only one that a simulation walks."""
    return error[..., 0], valid[..., 0]


def final_of_best(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the final error (B, 1, A) of the sample that is best by ADE: what minima apart leave out."""
    best = average(error, valid)[0].argmin(1, keepdim=True)
    return error[..., -1].gather(1, best), valid[..., -1]


def missed(error: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return 1 for people of whom no sample ends within `MISS` metres of the truth, else 0 (B, 1, A)."""
    return (error[..., -1].amin(1, keepdim=True) > MISS).to(error.dtype), valid[..., -1]


def min_per_scene(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's error (B, A) in the one sample that is best for their whole scene."""
    best = per_agent.where(there.unsqueeze(1), 0).sum(-1).argmin(1)
    return per_agent[torch.arange(len(best), device=best.device), best]


def min_per_agent(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's smallest error (B, A) over their own samples."""
    return per_agent.amin(1)


def mean_over_samples(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's mean error (B, A) over the samples: what one random sample costs."""
    return per_agent.mean(1)


def scene_sums(
    error: Tensor,
    valid: Tensor,
    of: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]] = average,
    over_samples: Callable[[Tensor, Tensor], Tensor] = mean_over_samples,
) -> tuple[Tensor, Tensor]:
    """Return the sum of an error over the people of each scene (B,) float64, and how many these are (B,).

    ``of`` is the error, such as `average`; ``over_samples`` reduces samples, such as `min_per_agent`.
    """
    per_agent, there = of(error, valid)
    value = over_samples(per_agent, there).where(there, 0)
    return value.sum(1, dtype=torch.float64), there.sum(1)


def sample_distance(prediction: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return the distance between the positions of two samples, metres: a sum and a count, () float64 each.

    Of the same person at the same step, mean over pairs of samples, of displacements (B, K, A, T, 2) and
    people ``mask`` (B, A). It shows whether samples differ: 0 for a deterministic model.
    """
    people = prediction.cumsum(-2).movedim(1, -2)[mask]  # (P, T, K, 2)
    first, second = torch.triu_indices(prediction.shape[1], prediction.shape[1], 1, device=mask.device)
    total, count = torch.zeros(2, dtype=torch.float64, device=mask.device)
    # a few people at a time: all pairs of all people at once would not fit a cache
    for some in people.split(256) if len(first) else ():  # one sample stands for all, at distance 0
        apart = (some[..., first, :] - some[..., second, :]).norm(dim=-1)
        total = total + apart.mean(-1).sum(dtype=torch.float64)
    return total, count + people.shape[0] * people.shape[1]
