"""A disc that drives along its heading and turns: speed and turning rate are commanded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Unicycle(RobotBody):
    """A disc that drives along its heading and turns: speed and turning rate are commanded."""

    drive: ClassVar[str] = "unicycle"
