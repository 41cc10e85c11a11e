"""-1 for a robot that touched a person, a robot or a wall."""

from __future__ import annotations

from torch import Tensor

from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.reward import RobotReward
from pedzoo.sim.robot_parts.view import RobotView


class Collision(RobotReward):
    """-1 for a robot that touched a person, a robot or a wall."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """-1 where a robot touched anything (B, R)."""
        return -outcome.collision.float()
