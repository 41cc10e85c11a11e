"""-1 for every second."""

from __future__ import annotations

from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.reward import RobotReward
from pedzoo.sim.robot_parts.view import RobotView


class Time(RobotReward):
    """-1 for every second."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Less the seconds that a decision took (B, R)."""
        return -TRACE_SECONDS * trace.shape[2] * outcome.active
