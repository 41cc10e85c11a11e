"""Metres by which the way to the goal got shorter."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.reward import RobotReward
from pedzoo.sim.robot_parts.view import RobotView


class Progress(RobotReward):
    """Metres by which the way to the goal got shorter."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Metres by which the planner's way to the goal got shorter (B, R); 0 where a goal was reached."""
        last = slice(-before.robots, None)
        goes_on = before.state.goal_id[:, last] == after.state.goal_id[:, last]
        left = torch.where(goes_on, after.state.remaining_path[:, last], 0.0)
        return before.state.remaining_path[:, last] - left
