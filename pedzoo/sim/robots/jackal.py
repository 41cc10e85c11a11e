"""Clearpath Jackal: fast, four wheels that slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Jackal(RobotBody):
    """Clearpath Jackal: fast, four wheels that slip."""

    drive: ClassVar[str] = "diff_drive"
    source: ClassVar[str] = (
        "jackal_control/config/control.yaml (Clearpath): speeds, accelerations; 508 x 430 mm, 376 mm track"
    )

    radius: float = 0.333
    top_speed: float = 2.0
    top_turn: float = 4.0
    acceleration: float = 20.0
    turn_acceleration: float = 25.0
    track: float = 0.376
