"""A disc on two wheels, whose speeds are commanded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class DiffDrive(RobotBody):
    """A disc on two wheels, whose speeds are commanded."""

    drive: ClassVar[str] = "diff_drive"

    radius: float = 0.3
    top_speed: float = 1.0
    top_turn: float = 2.0
    acceleration: float = 1.0
    turn_acceleration: float = 4.0
    track: float = 0.4
