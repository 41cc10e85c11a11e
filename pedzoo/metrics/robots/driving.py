"""How robots drive: turning, standing, distance to the goal. See `pedzoo.metrics.robots` for E, R, T.

Paths (E, R, 1 + T, 2), metres, and headings (E, R, 1 + T), radians, are from where the episode begins;
``there`` (E, R, T): the robot is on its way.
"""

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS

STANDS, STANDS_TURN = 0.01, 0.02
"""m/s and rad/s: a robot that is slower in both does not move (HuNav's)."""


def heading_changes(heading: Tensor, there: Tensor) -> Tensor:
    """Return by how much each robot turned (E, R), radians, left and right added up (HuNav)."""
    return _turns(heading).abs().where(there, 0.0).sum(-1)


def seconds_standing(path: Tensor, heading: Tensor, there: Tensor) -> Tensor:
    """Return how long each robot was slower than 0.01 m/s and 0.02 rad/s (E, R), seconds (HuNav)."""
    slow = path.diff(dim=2).norm(dim=-1) < STANDS * TRACE_SECONDS
    steady = _turns(heading).abs() < STANDS_TURN * TRACE_SECONDS
    return (slow & steady & there).sum(-1) * TRACE_SECONDS


def goal_distances(trace: Tensor, goal: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
    """Return the least and the final distance to the goal (E, R), metres (HuNav, SEAN 2.0)."""
    away = (trace - goal).norm(dim=-1)
    least = away.masked_fill(~there, torch.inf).amin(-1)
    last = (there.sum(-1, keepdim=True) - 1).clamp_min(0)
    return least, away.gather(-1, last).squeeze(-1)


def _turns(heading: Tensor) -> Tensor:
    """Return the turns between two points (E, R, T), -pi to pi."""
    turned = heading.diff(dim=-1)
    return torch.atan2(turned.sin(), turned.cos())
