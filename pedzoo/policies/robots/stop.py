"""Baseline: the robot stands still."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.policies.robots._base import ObservedPeople, Robot


class Stop:
    """Never moves."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return zeros (B, 2)."""
        return torch.zeros_like(robot.position)
