"""TurtleBot 3 Burger: slow and small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Turtlebot3(RobotBody):
    """TurtleBot 3 Burger: slow and small."""

    drive: ClassVar[str] = "diff_drive"

    radius: float = 0.105
    top_speed: float = 0.22
    top_turn: float = 2.84
    acceleration: float = 2.5
    turn_acceleration: float = 3.2
    track: float = 0.16
