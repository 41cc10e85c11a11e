"""Settings of ORCA."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from pedzoo.core.batch import is_person_sized
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS

OF_PRESET: Any = None
"""Default of a setting that has the value of the preset."""


@dataclass(frozen=True)
class OrcaSettings:
    """Settings of ORCA; its parameters are in RVO2's meaning and mostly with its names.

    Attributes:
        radius: Of the disk of every person that ORCA moves, metres; bodies and planners have their own.
        walls: Whether walls are avoided. iGibson's ORCA never sees them.
        dt: Seconds between decisions, in which people who already overlap are to be apart again.
        jitter: Standard deviation of noise on the preferred velocity, m/s.
        preset: ``pedzoo``, or ``igibson`` for the constants of iGibson's social navigation, see `PRESETS`.
        neighbor_dist: Metres between centres beyond which others are ignored.
        max_neighbors: Nearest others that are avoided; the preset ``igibson`` avoids all.
        time_horizon: Seconds for which velocities are safe with respect to others.
        time_horizon_obst: Seconds for which they are safe with respect to walls.
        max_obstacles: Nearest wall segments that are avoided (RVO2: all of them).
        top_speed_ratio: Top speed, divided by the preferred one; iGibson's people have no other.
    """

    radius: float = OF_PRESET
    walls: bool = True
    dt: float = TRACE_SECONDS
    jitter: float = 0.02
    preset: Literal["pedzoo", "igibson"] = "pedzoo"
    neighbor_dist: float = 5.0
    max_neighbors: int | None = OF_PRESET
    time_horizon: float = 2.0
    time_horizon_obst: float = 2.0
    max_obstacles: int = 16
    top_speed_ratio: float = OF_PRESET

    def __post_init__(self) -> None:
        """Take missing values from the preset, and check all.

        Raises:
            UserError: No such preset, a length or time that is not positive, or a count that is negative.
        """
        if self.preset not in PRESETS:
            raise unknown("ORCA preset", self.preset, PRESETS)
        for name, value in PRESETS[self.preset].items():
            if getattr(self, name) is OF_PRESET:
                object.__setattr__(self, name, value)
        if self.jitter < 0 or self.top_speed_ratio <= 0:
            raise UserError(
                f"orca: jitter {self.jitter}, top_speed_ratio {self.top_speed_ratio}: expected >= 0, > 0"
            )
        for name in ("max_neighbors", "max_obstacles"):
            if (count := getattr(self, name)) is not None and count < 0:
                raise UserError(f"orca: {name} {count} must be 0 or more")
        for name in ("radius", "dt", "neighbor_dist", "time_horizon", "time_horizon_obst"):
            if not (math.isfinite(value := getattr(self, name)) and value > 0):
                raise UserError(f"orca: {name} {value} must be a number above 0")

    def radii(self, body: Tensor, robot: Tensor, controlled: Tensor) -> Tensor:
        """Return the radii (...) of the disks that ORCA avoids, metres.

        ``radius`` stands for persons with the usual body. Robots, and agents of another body that ORCA does
        not move, count with their own one, and wider persons with at least that.

        Args:
            body: Radii of the bodies (...), metres.
            robot: Which agents are robots (...) bool.
            controlled: Which agents ORCA moves (...) bool.
        """
        own = torch.where(controlled & ~robot, body.clamp_min(self.radius), body)
        return torch.where(robot | ~is_person_sized(body), own, self.radius)

    def wall_reach(self, max_speed: Tensor, radius: Tensor | None = None) -> Tensor:
        """Return the distance (...) within which walls matter, metres.

        Args:
            max_speed: Top speeds (...), m/s.
            radius: Radii of the disks (...), metres; None for ``radius`` of the settings.
        """
        return self.time_horizon_obst * max_speed + (self.radius if radius is None else radius)


PRESETS: dict[str, dict[str, Any]] = {
    "pedzoo": {"radius": 0.2, "max_neighbors": 10, "top_speed_ratio": TOP_SPEED_RATIO},
    # iGibson 2.0's social navigation, where all people in the scene are neighbours
    "igibson": {"radius": 0.5, "max_neighbors": None, "top_speed_ratio": 1.0},
}
"""Settings of the presets."""
