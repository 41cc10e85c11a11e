"""TurtleBot 4 on a Create 3 base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Turtlebot4(RobotBody):
    """TurtleBot 4 on a Create 3 base."""

    drive: ClassVar[str] = "diff_drive"

    radius: float = 0.171
    top_speed: float = 0.46
    top_turn: float = 1.9
    acceleration: float = 0.9
    turn_acceleration: float = 7.725
    track: float = 0.233
