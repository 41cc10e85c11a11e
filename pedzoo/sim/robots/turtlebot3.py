"""TurtleBot 3 Burger: slow and small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Turtlebot3(RobotBody):
    """TurtleBot 3 Burger: slow and small."""

    drive: ClassVar[str] = "diff_drive"
    source: ClassVar[str] = (
        "ROBOTIS e-manual (0.22 m/s, 2.84 rad/s, 138 x 178 mm); accelerations as in Nav2's parameters for it"
    )

    radius: float = 0.113
    top_speed: float = 0.22
    top_turn: float = 2.84
    acceleration: float = 2.5
    turn_acceleration: float = 3.2
    track: float = 0.16
