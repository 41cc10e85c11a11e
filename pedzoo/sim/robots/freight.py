"""Fetch Robotics Freight: a round base for warehouses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Freight(RobotBody):
    """Fetch Robotics Freight: a round base for warehouses."""

    drive: ClassVar[str] = "diff_drive"
    source: ClassVar[str] = (
        "fetch_bringup and freight_bringup (Fetch Robotics): 1 m/s, 0.75 m/s^2, track 0.37476 m; 559 mm wide"
    )

    radius: float = 0.28
    top_speed: float = 1.0
    top_turn: float = 4.5
    acceleration: float = 0.75
    turn_acceleration: float = 3.0
    track: float = 0.3748
