"""Whether and when people arrive: pure functions over the 0.1 s trace of closed-loop episodes.

E episodes of A people (padded), T trace points; point t is the end of the t-th 0.1 s after the warm start.
Functions take what `pedzoo.metrics.rollout.Rollout` holds under the same names.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.types import TRACE_SECONDS

STILL_POINTS, STILL_METRES, AWAY = round(5.0 / TRACE_SECONDS), 0.1, 0.5
"""Trace points (5 s), metres in them, and metres to the goal: who moves less, farther away, is deadlocked."""


def success(reached: Tensor, goals: int, late: Tensor, failed: Tensor, mask: Tensor) -> Tensor:
    """Return who has reached all goals in time (E, A) bool; nobody has in an episode that failed.

    Args:
        reached: Goals reached until each point (E, A, T) long.
        goals: That everybody had to reach.
        late: A goal was not reached in time (E, A) bool.
        failed: The policy gave no number (E,) bool.
        mask: Who took part (E, A) bool.
    """
    return (reached[..., -1] >= goals) & ~late & ~failed.unsqueeze(1) & mask


def finish_seconds(reached: Tensor, goals: int) -> Tensor:
    """Return when everybody had reached all goals (E, A), seconds, infinite where they never had.

    Args:
        reached: Goals reached until each point (E, A, T) long.
        goals: That everybody had to reach.
    """
    missing = (reached < goals).sum(-1)
    seconds = (missing + 1).double() * TRACE_SECONDS
    return torch.where(missing < reached.shape[-1], seconds, torch.inf)


def episode_seconds(seconds: Tensor, success: Tensor, mask: Tensor) -> Tensor:
    """Return when the last one had finished (E,), seconds; infinite where not everybody had in time.

    Args:
        seconds: When everybody had finished (E, A).
        success: Whether in time (E, A) bool.
        mask: Who took part (E, A) bool.
    """
    everybody = (success | ~mask).all(1)
    last = seconds.masked_fill(~mask, 0.0).amax(1)
    return torch.where(everybody, last, torch.inf)


def deadlocked(trace: Tensor, goal: Tensor, present: Tensor) -> Tensor:
    """Return who once moved less than 0.1 m in 5 s, more than 0.5 m from the goal (E, A) bool.

    Args:
        trace: Positions (E, A, T, 2), metres.
        goal: Where everybody was going (E, A, T, 2), metres.
        present: Who is there in a running episode (E, A, T) bool.
    """
    if trace.shape[2] <= STILL_POINTS:
        return torch.zeros_like(present[..., 0])
    before, after = trace[:, :, :-STILL_POINTS], trace[:, :, STILL_POINTS:]
    still = (after - before).norm(dim=-1) < STILL_METRES
    away = (after - goal[:, :, STILL_POINTS:]).norm(dim=-1) > AWAY
    return (still & away & present[:, :, STILL_POINTS:]).any(-1)
