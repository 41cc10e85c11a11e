"""The scenes that benchmarks measure in: how many, how many people, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from torch import Tensor

from pedzoo.maps.grid import OCCUPIED, OccupancyGrid, spread_points
from pedzoo.maps.plans import load_plan, rectangles, room, wall
from pedzoo.maps.walls.segments import WallSegments
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.sim.make import CLEARANCE
from pedzoo.sim.scenario_parts.scenario import PreparedScenario
from pedzoo.sim.scenarios.goals import SPACING, Goals
from tools.bench.peer import Scenes
from tools.bench.section import Settings

POOL = 32
"""Places among which goals are drawn: the planner's tables grow with it."""

FEW = 20
"""So many people fit into the four rooms of ``flat``."""


class Size(NamedTuple):
    """How much is simulated at once.

    Attributes:
        scenes: B.
        people: A, in every scene.
    """

    scenes: int
    people: int

    @property
    def total(self) -> int:
        """Agent-steps of one step."""
        return self.scenes * self.people

    def __str__(self) -> str:
        """Return it as people write it."""
        return f"{self.scenes} x {self.people}"


SIZES = (Size(1, 5), Size(64, 5), Size(1024, 5), Size(1, 100), Size(1, 500))
QUICK = (Size(1, 5), Size(64, 5))
LARGEST = Size(1024, 5)
"""The size that most bars are about."""


def sizes(settings: Settings, usual: Sequence[Size]) -> list[Size]:
    """Return the sizes that were asked for, or the usual ones."""
    return [Size(*size) for size in settings.sizes] or list(usual)


class Hall(Goals):
    """Nine rooms in 30 x 30 m with two doors in each wall, for crowds that fit on no given floor plan."""

    def plans(self) -> list[OccupancyGrid]:
        """Return the rooms."""
        walls = room((0.0, 0.0), (30.0, 30.0), 0.1)
        doors = [(5.0 * at, 1.4) for at in (0.6, 1.4, 2.6, 3.4, 4.6, 5.4)]
        for at in (10.0, 20.0):
            walls += wall((at, 0.0), (at, 30.0), 0.2, doors) + wall((0.0, at), (30.0, at), 0.2, doors)
        return [rectangles(walls, 0.1, name="hall")]


def scenario(people: int, maps: Sequence[str]) -> PreparedScenario:
    """Return people who walk from goal to goal on the first of the floor plans that has room for them.

    Without one that has, small groups walk in the four rooms of ``flat`` and crowds in a `Hall`.

    Raises:
        UserError: One of them is no floor plan.
    """
    for file in maps:
        starts = spread_points(load_plan(file), Goals.unknown, CLEARANCE, SPACING, seed=0)
        if len(starts) >= people:
            return Goals(file, people, pool=POOL).prepare(CLEARANCE)
    made = Goals("flat", people, pool=POOL) if people <= FEW else Hall(people=people, pool=POOL)
    return made.prepare(CLEARANCE)


def plan(side: int, boxes: int, seed: int) -> OccupancyGrid:
    """Return a square room of ``side`` cells of 0.1 m with boxes in it."""
    cells, random = np.zeros((side, side), dtype=np.uint8), np.random.default_rng(seed)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    for _ in range(boxes):
        (x, y), (width, height) = random.integers(2, side - 12, 2), random.integers(1, 15, 2)
        cells[y : y + height, x : x + width] = OCCUPIED
    return OccupancyGrid(cells, 0.1, name=f"plan {side} {boxes} {seed}")


def for_peers(
    section: str,
    size: Size,
    settings: OrcaSettings,
    walls: WallSegments | None,
    position: Tensor,
    velocity: Tensor,
    preferred: Tensor,
    top_speed: Tensor,
) -> Scenes:
    """Return scenes in the form that peers read; people (B, A, 2), top speeds (B, A), one floor plan."""
    polygons = walls.bank.walls.outlines.polygons()[0] if walls else []
    return Scenes(
        section,
        *size,
        {key: value for key, value in asdict(settings).items() if key != "max_obstacles"},
        [polygon.tolist() for polygon in polygons],
        *(part.tolist() for part in (position, velocity, preferred, top_speed)),
    )
