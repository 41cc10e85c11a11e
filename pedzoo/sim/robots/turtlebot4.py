"""TurtleBot 4 on a Create 3 base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Turtlebot4(RobotBody):
    """TurtleBot 4 on a Create 3 base."""

    drive: ClassVar[str] = "diff_drive"
    source: ClassVar[str] = (
        "iRobot Create 3 documentation: 0.46 m/s, 1.9 rad/s, wheels 0.9 m/s^2 and 0.233 m apart, 342 mm wide"
    )

    radius: float = 0.171
    top_speed: float = 0.46
    top_turn: float = 1.9
    acceleration: float = 0.9
    turn_acceleration: float = 7.725
    track: float = 0.233
