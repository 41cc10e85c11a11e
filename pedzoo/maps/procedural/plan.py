"""Floor plans from a seed: apartments and offices, with everything within reach of everything else."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pedzoo.core.errors import UserError, unknown
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.maps.procedural.furniture import CLEARANCE, Piece, furnish
from pedzoo.maps.procedural.rooms import (
    APARTMENT_SIDES,
    OFFICE_SIDES,
    apartment_rooms,
    apartment_size,
    office_rooms,
    office_size,
)
from pedzoo.maps.procedural.shapes import UNIT, Door, PortableRandom, Rect, Room, draw_doors, placed, units


class Kind(NamedTuple):
    """A kind of floor plan."""

    sides: tuple[float, float]  # least and largest outer width and height, metres
    draw_size: Callable[[PortableRandom], tuple[float, float]]  # outer width and height, metres
    # rooms inside the outer walls, the longer side along x; None for a bad draw
    draw_rooms: Callable[[PortableRandom, Rect], list[Room] | None]


KINDS = {
    "apartment": Kind(APARTMENT_SIDES, apartment_size, apartment_rooms),
    "office": Kind(OFFICE_SIDES, office_size, office_rooms),
}
"""The generators by name."""

DOORS = (0.7, 1.5)  # least and largest width of a door, metres
_ATTEMPTS = 200


@dataclass(frozen=True)
class FloorPlan:
    """A floor plan and its parts. Rectangles are in units of 5 cm from its low corner.

    Attributes:
        kind: One of `KINDS`.
        seed: That it was drawn from.
        grid: Its cells; the low outer corner is the origin.
        rooms: The hall or corridor first.
        doors: Between them.
        pieces: The furniture.
    """

    kind: str
    seed: int
    grid: OccupancyGrid
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    pieces: tuple[Piece, ...]

    @property
    def size(self) -> tuple[float, float]:
        """Outer width and height, metres."""
        height, width = self.grid.cells.shape
        return width * self.grid.resolution, height * self.grid.resolution

    def facts(self) -> dict[str, float]:
        """Return what a table says about the plan: counts, metres and square metres; halls are rooms, too."""
        widths = [door.width for door in self.doors]
        return {
            "rooms": len(self.rooms),
            "doors": len(self.doors),
            "pieces": len(self.pieces),
            "width_m": round(self.size[0], 3),
            "height_m": round(self.size[1], 3),
            "narrowest_door_m": round(min(widths), 3),
            "widest_door_m": round(max(widths), 3),
            "free_m2": round(float((self.grid.cells == FREE).sum() * self.grid.resolution**2), 2),
        }


def generate(
    kind: str,
    seed: int,
    size: tuple[float, float] | None = None,
    resolution: float = UNIT,
    furnished: float = 1.0,
    doors: tuple[float, float] = DOORS,
) -> FloorPlan:
    """Return the floor plan of a seed: the same cells on every machine.

    Walls and furniture lie on a lattice of 5 cm, so that grids of all resolutions show the same plan. Inner
    walls are 0.1 m thick, outer ones 0.1 to 0.2 m. The space at least 0.25 m from walls, the planner's
    clearance, is one connected piece that reaches through every door.

    Args:
        kind: ``apartment`` (a hall and 4 to 7 rooms) or ``office`` (corridors, rooms, open-plan rooms).
        seed: At least 0.
        size: Outer width and height, metres, as ``12,9``; None: 8 to 14 m each for apartments, 20 to 40 m by
            12 to 25 m for offices.
        resolution: Side of a cell, metres: 0.05 or a whole part of it.
        furnished: From 0, bare rooms, to 1; the rooms are the same.
        doors: Least and largest width of a door, metres, as ``0.8,1.2``, within 0.7 to 1.5.

    Raises:
        UserError: A setting is out of range, no plan was found for the size, or some cells are cut off at
            a fine resolution.
    """
    if kind not in KINDS:
        raise unknown("kind of floor plan", kind, KINDS)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise UserError(f"{kind}: seed {seed!r}: expected a whole number of at least 0")
    low, high = KINDS[kind].sides
    if size is not None and (len(size) != 2 or not all(low <= side <= high for side in size)):
        raise UserError(f"{kind}: size {size}: expected width and height from {low:g} to {high:g} m")
    if not 0 <= furnished <= 1:
        raise UserError(f"{kind}: furnished {furnished}: expected 0 (bare) to 1")
    if len(doors) != 2 or not DOORS[0] <= doors[0] <= doors[1] <= DOORS[1]:
        raise UserError(
            f"{kind}: doors {doors}: expected least and largest width from {DOORS[0]:g} to {DOORS[1]:g} m"
        )
    refine = UNIT / resolution if 0 < resolution < math.inf else 0.0
    if refine < 1 - 1e-9 or abs(refine - round(refine)) > 1e-6:
        raise UserError(
            f"{kind}: resolution {resolution}: expected {UNIT} m per cell or a whole part of it, such as "
            f"{UNIT / 2:g} or {UNIT / 5:g}"
        )
    refine = round(refine)
    seed = int(seed)
    width, height = (
        units(side) for side in size or KINDS[kind].draw_size(PortableRandom(seed, kind, "size"))
    )
    for attempt in range(_ATTEMPTS):
        result = _attempt(kind, (seed, kind, attempt), (width, height), furnished, doors)
        if result is None:
            continue
        rooms, openings, pieces = result
        cells = np.full((height, width), OCCUPIED, dtype=np.uint8)
        for rect in (*(part for room in rooms for part in room.parts), *(door.opening for door in openings)):
            cells[rect.y0 : rect.y1, rect.x0 : rect.x1] = FREE
        for _, rect in pieces:
            cells[rect.y0 : rect.y1, rect.x0 : rect.x1] = OCCUPIED
        name = f"{kind}.{seed}" if furnished else f"{kind}.{seed}.bare"
        grid = OccupancyGrid(cells, UNIT, name=name)
        if not is_connected(grid, CLEARANCE):
            continue
        if refine > 1:
            grid = OccupancyGrid(cells.repeat(refine, 0).repeat(refine, 1), resolution, name=name)
            if not is_connected(grid, CLEARANCE):
                raise UserError(
                    f"{name}: at resolution {resolution:g} some cells are cut off from all others: give "
                    f"another seed, or resolution {UNIT:g}"
                )
        return FloorPlan(kind, seed, grid, tuple(rooms), tuple(openings), tuple(pieces))
    raise UserError(
        f"{kind} {seed} of {width * UNIT:g} x {height * UNIT:g} m: no plan found in {_ATTEMPTS} attempts: "
        "give another seed, or another size"
    )


def is_connected(grid: OccupancyGrid, clearance: float) -> bool:
    """Return whether the cells whose centre keeps a clearance (metres) exist and are one piece.

    They are connected through their four sides, as the planner's are.
    """
    from scipy.ndimage import label

    free = grid.signed_distance("wall") >= clearance - 1e-6
    parts = np.empty(free.shape, dtype=np.int32)
    return label(free, output=parts) == 1


def _attempt(
    kind: str,
    key: tuple[int, str, int],
    size: tuple[int, int],
    furnished: float,
    widths: tuple[float, float],
) -> tuple[list[Room], list[Door], list[Piece]] | None:
    """Return rooms, doors and furniture, or None where this draw gives no sound plan."""
    dice = PortableRandom(*key)
    wall = dice.integer(units(0.1), units(0.2))
    long, short = max(size), min(size)
    rooms = KINDS[kind].draw_rooms(dice, Rect(wall, wall, long - wall, short - wall))
    if rooms is None:
        return None
    rooms = placed(rooms, (long, short), size[0] < size[1], dice.chance(0.5), dice.chance(0.5))
    doors = draw_doors(dice, rooms, (units(widths[0]), units(widths[1])))
    if doors is None:
        return None
    pieces: list[Piece] = []
    for number, room in enumerate(rooms):
        mine = [door for door in doors if number in door.rooms]
        result = furnish(PortableRandom(*key, "furniture", number), room, mine, furnished)
        if result is None:
            return None
        pieces += result
    return rooms, doors, pieces
