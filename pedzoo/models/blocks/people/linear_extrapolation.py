"""The trivial continuations: baselines of forecasters, and the start of residual models.

Notation: p8 last observed position, v last displacement, g goal, k = 1..T.
"""

import torch
from torch import Tensor


def constant_velocity(last_step: Tensor, steps: int) -> Tensor:
    """Return displacements (..., T, 2) that repeat the last one (..., 2): p8 + k v."""
    return last_step.unsqueeze(-2).expand(*last_step.shape[:-1], steps, 2)


def straight_line(last_step: Tensor, to_goal: Tensor, steps: int, timed: bool) -> Tensor:
    """Return displacements (..., T, 2) of a straight walk to a goal at ``to_goal`` (..., 2) from p8."""
    if timed:
        return (to_goal / steps).unsqueeze(-2).expand(*to_goal.shape[:-1], steps, 2)
    distance = to_goal.norm(dim=-1, keepdim=True)
    k = torch.arange(steps + 1, device=to_goal.device)
    walked = torch.minimum(last_step.norm(dim=-1, keepdim=True) * k, distance).diff(dim=-1)
    return walked.unsqueeze(-1) * (to_goal / distance.clamp(min=1e-9)).unsqueeze(-2)


def bent_line(last_step: Tensor, to_goal: Tensor, steps: int, timed: bool) -> Tensor:
    """Return displacements (..., T, 2) that start with v and bend to the straight walk's end e.

    The quadratic p8 + k v + (k / T)^2 (e - p8 - T v). A timed goal is reached exactly at the last step. To
    any other people walk at their last speed and stop there: e - p8 is min(T |v|, |g - p8|) long.
    """
    end = to_goal
    if not timed:
        distance = to_goal.norm(dim=-1, keepdim=True)
        reach = torch.minimum(last_step.norm(dim=-1, keepdim=True) * steps, distance)
        end = to_goal * (reach / distance.clamp(min=1e-9))
    k = torch.arange(1, steps + 1, device=to_goal.device, dtype=to_goal.dtype)
    weight = (2 * k - 1) / steps**2
    return last_step.unsqueeze(-2) + weight.unsqueeze(-1) * (end - steps * last_step).unsqueeze(-2)
