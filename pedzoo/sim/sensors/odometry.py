"""What a robot knows of its own motion."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


class Odometry(Sensor):
    """``velocity`` (B, R, 2), m/s, in the robot's frame; ``turn_rate``, ``radius`` and ``heading`` (B, R, 1).

    Turning rates are in rad/s, radii in metres, headings in radians from the x axis of the world.
    """

    readings: Mapping[str, Reading] = {
        "velocity": Reading((2,)),
        "turn_rate": Reading((1,)),
        "radius": Reading((1,), low=0.0),
        "heading": Reading((1,)),
    }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        last, state = slice(-view.robots, None), view.state
        return {
            "velocity": view.own(state.velocity[:, last]),
            "turn_rate": state.turn_rate[:, last].unsqueeze(-1),
            "radius": state.radius[:, last].unsqueeze(-1),
            "heading": state.heading[:, last].unsqueeze(-1),
        }
