"""What ORCA can be told."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.batch import usual_body
from pedzoo.core.errors import UserError, unknown


@dataclass(frozen=True)
class OrcaSettings:
    """Parameters of ORCA, in RVO2's meaning and mostly with its names.

    Attributes:
        radius: Of the disk of every person that ORCA moves, metres. It is ORCA's own: bodies and planners
            have theirs.
        time_step: Seconds in which people who already overlap are to be apart again: the time for which
            the velocities are held.
        neighbor_dist: Metres between centres from which on others are ignored.
        max_neighbors: So many nearest others are heeded; None: all within ``neighbor_dist``.
        time_horizon: Seconds for which velocities are safe with respect to others.
        time_horizon_obst: Seconds for which they are safe with respect to walls.
        max_obstacles: So many nearest wall segments are heeded (RVO2: all of them).
    """

    radius: float = 0.2
    time_step: float = 0.4
    neighbor_dist: float = 5.0
    max_neighbors: int | None = 10
    time_horizon: float = 2.0
    time_horizon_obst: float = 2.0
    max_obstacles: int = 16

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            UserError: A length or time is not positive, or a count is negative.
        """
        for name, value in asdict(self).items():
            if name in ("max_neighbors", "max_obstacles"):
                if value is not None and value < 0:
                    raise UserError(f"orca: {name} {value} must be 0 or more")
            elif not (math.isfinite(value) and value > 0):
                raise UserError(f"orca: {name} {value} must be a number above 0")

    @classmethod
    def preset(cls, name: str, **changes: Any) -> OrcaSettings:
        """Return a named set of parameters with ``changes``; top speeds (iGibson: 0.5 m/s) are not here.

        Raises:
            UserError: There is no preset of this name, or a value is wrong.
        """
        if name not in PRESETS:
            raise unknown("ORCA preset", name, PRESETS)
        return cls(**(PRESETS[name] | changes))

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
        return torch.where(robot | ~usual_body(body), own, self.radius)

    def wall_reach(self, max_speed: Tensor, radius: Tensor | None = None) -> Tensor:
        """Return the distance (...) within which walls matter, metres.

        Args:
            max_speed: Top speeds (...), m/s.
            radius: Radii of the disks (...), metres; None for ``radius`` of the settings.
        """
        return self.time_horizon_obst * max_speed + (self.radius if radius is None else radius)


PRESETS: dict[str, dict[str, Any]] = {
    "pedzoo": {},
    # iGibson 2.0's social navigation; everybody in the scene is a neighbour there
    "igibson": {"radius": 0.5, "time_step": 0.1, "max_neighbors": None},
}
"""Departures from the defaults, by name."""
