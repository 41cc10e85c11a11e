"""The goal, the way to it, and the robot's own body, in its own frame."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


class Goal(Sensor):
    """``goal`` (B, R, 2) and ``waypoint`` (B, R, 2) in metres, and ``remaining_path`` (B, R, 1), metres.

    The waypoint is the planner's short-term goal: a point ahead on the way around walls, in sight.
    """

    readings: Mapping[str, Reading] = {
        "goal": Reading((2,)),
        "waypoint": Reading((2,)),
        "remaining_path": Reading((1,), low=0.0),
    }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        last = slice(-view.robots, None)
        return {
            "goal": view.own_places(view.state.goal_point[:, last]),
            "waypoint": view.own_places(view.guidance.goal[:, last]),
            "remaining_path": view.state.remaining_path[:, last].unsqueeze(-1),
        }
