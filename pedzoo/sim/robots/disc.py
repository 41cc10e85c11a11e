"""A disc that moves in any direction at once, as in CrowdNav: 0.3 m, 1 m/s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Disc(RobotBody):
    """A disc that moves in any direction at once, as in CrowdNav: 0.3 m, 1 m/s."""

    drive: ClassVar[str] = "holonomic"
