"""Clearpath Husky: 0.99 m long, 0.67 m wide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Husky(RobotBody):
    """Clearpath Husky: 0.99 m long, 0.67 m wide."""

    drive: ClassVar[str] = "diff_drive"
    source: ClassVar[str] = (
        "Clearpath's data sheet (1 m/s, 990 x 670 mm) and husky_control/config/control.yaml (accelerations)"
    )

    radius: float = 0.598
    top_speed: float = 1.0
    top_turn: float = 2.0
    acceleration: float = 3.0
    turn_acceleration: float = 6.0
    track: float = 0.5708
