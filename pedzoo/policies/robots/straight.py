"""Baseline: straight to the goal, through all obstacles."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.policies.robots._base import ObservedPeople, Robot


class Straight:
    """Goes to the goal at its preferred speed and sees no people."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        return normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]
