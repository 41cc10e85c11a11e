"""1 for a robot that has reached all its goals."""

from __future__ import annotations

from torch import Tensor

from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.reward import RobotReward
from pedzoo.sim.robot_parts.view import RobotView


class Success(RobotReward):
    """1 for a robot that has reached all its goals."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """1 where a robot has reached all its goals (B, R)."""
        return outcome.success.float()
