"""Floor plans from a seed: apartments around a hall and offices along corridors; all is within reach."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pedzoo.core.errors import UserError, unknown
from pedzoo.maps.furniture import CLEARANCE, Piece, furnish, is_one_piece
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.maps.shapes import (
    UNIT,
    WALL,
    Door,
    PortableRandom,
    Rect,
    Room,
    draw_doors,
    placed,
    units,
)

FEWEST, MOST = 4, 7  # rooms besides the hall
_SHORTEST = units(2.0)  # a side that every room has at least
_LONGEST = 2.6  # longer side of a room by its shorter one, at most


def apartment_size(dice: PortableRandom) -> tuple[float, float]:
    """Return the outer width and height in metres."""
    width = dice.uniform(8.0, 14.0)
    return width, dice.uniform(8.0, min(14.0, 150.0 / width))


def apartment_rooms(dice: PortableRandom, inside: Rect) -> list[Room] | None:
    """Return the hall and the rooms inside the outer walls, the longer side along x; None for a bad draw.

    The hall runs along the middle, and it may end at a room that is as deep as the apartment, or bend. What
    is left is split again and again, the largest room first.
    """
    hall, rooms = _hall(dice, inside)
    area = inside.area
    wanted = min(max(round(area / dice.uniform(13.0, 22.0)), FEWEST), MOST)
    while len(rooms) < wanted:
        rooms.sort(key=lambda room: room.area * (1 + max(room.long / room.short - 1.5, 0)))
        halves = _split(dice, rooms.pop())
        if halves is None:
            return None
        rooms += halves
    if len(rooms) > MOST or any(
        room.long > _LONGEST * room.short or room.short < _SHORTEST for room in rooms
    ):
        return None
    return [Room("hall", hall), *_uses(dice, rooms)]


def _hall(dice: PortableRandom, inside: Rect) -> tuple[tuple[Rect, ...], list[Rect]]:
    """Return the hall's parts and the remaining inside."""
    x0, _, x1, _ = inside
    width = dice.integer(units(1.2), units(1.7))
    room = inside.height - width - 2 * WALL
    low = inside.y0 + max(_SHORTEST + units(0.4), round(room * dice.uniform(0.36, 0.64)))
    low = min(low, inside.y1 - width - 2 * WALL - _SHORTEST - units(0.4))
    below, above = inside.cut(1, low)
    hall, above = above.cut(1, low + WALL + width)
    form = dice.choice(("end", "end", "bend", "through"))
    if form == "end":
        end = x1 - dice.integer(units(3.2), min(units(4.8), inside.width - units(4.0)))
        return (
            (hall._replace(x1=end - WALL),),
            [part._replace(x1=end - WALL) for part in (below, above)] + [inside._replace(x0=end)],
        )
    if form == "bend":
        turn = x0 + round(inside.width * dice.uniform(0.4, 0.6))
        end = turn + width
        return (
            (hall._replace(x1=end), hall._replace(x0=turn, x1=end, y1=inside.y1)),
            [below, above._replace(x1=turn - WALL), Rect(end + WALL, hall.y0, x1, inside.y1)],
        )
    return (hall,), [below, above]


def _split(dice: PortableRandom, room: Rect) -> tuple[Rect, Rect] | None:
    """Return two rooms of unequal size made of one, None where it is too small."""
    across = 0 if room.width >= room.height else 1
    if room.long < 1.25 * room.short and dice.chance(0.5):
        across = 1 - across
    for axis in (across, 1 - across):
        begin, length = room[axis], room.along(axis)
        if length >= 2 * _SHORTEST + WALL:
            at = round(length * dice.choice((dice.uniform(0.3, 0.45), dice.uniform(0.55, 0.7))))
            return room.cut(axis, begin + min(max(at, _SHORTEST), length - WALL - _SHORTEST))
    return None


def _uses(dice: PortableRandom, rooms: list[Rect]) -> list[Room]:
    """Return the use of each room: the largest to live in, the smallest a bathroom."""
    rooms = sorted(rooms, key=lambda room: room.area)
    uses = ["bathroom", "kitchen", *["bedroom"] * (len(rooms) - 3), "living"]
    if len(rooms) > 5:
        uses[1:3] = [dice.choice(("bathroom", "storage", "study")), "kitchen"]
    return [Room(use, (room,)) for use, room in zip(uses, rooms, strict=True)]


_NARROWEST = units(2.2)  # shortest front that a room may have

_WIDTHS = {
    "office": (2.4, 4.4),
    "meeting": (3.6, 6.5),
    "open_plan": (7.0, 14.0),
    "kitchen": (2.8, 4.5),
    "toilets": (2.4, 3.6),
    "storage": (2.2, 3.2),
}
"""Metres of a room's front on the corridor."""

_MIX = ["office"] * 9 + ["meeting"] * 3 + ["open_plan"] * 3 + ["kitchen", "toilets", "storage"]

_SMALL, _SMALL_AREA = ("kitchen", "toilets", "storage"), 20.0
"""Square metres that such rooms have at most."""


def office_size(dice: PortableRandom) -> tuple[float, float]:
    """Return the outer width and height in metres."""
    return dice.uniform(20.0, 40.0), dice.uniform(12.0, 25.0)


def office_rooms(dice: PortableRandom, inside: Rect) -> list[Room] | None:
    """Return the corridor and the rooms inside the outer walls, the longer side along x; None for a bad draw.

    One corridor or more run along the whole length, rows of rooms on both of their sides. Rooms between two
    corridors are one row or two, back to back, and short corridors lead through them.
    """
    count = 1 if inside.height < units(17) else 2 if inside.height < units(28) else 3
    count += (inside.height > units(40)) + (inside.height > units(52))
    widths = [dice.integer(units(1.5), units(2.4)) for _ in range(count)]
    depth = inside.height - sum(widths) - 2 * count * WALL
    if count == 1:
        below = round(depth * dice.uniform(0.38, 0.62))
        depths = [below, depth - below]
    else:
        deepest = min(units(5.8), (depth - (count - 1) * units(3)) // 2)
        outer = [dice.integer(units(3.8), deepest) for _ in range(2)]
        core = depth - sum(outer)
        borders = [round(core * i / (count - 1)) for i in range(count)]
        depths = [outer[0], *(high - low for low, high in pairwise(borders)), outer[1]]
    if min(depths) < units(2.8):
        return None

    corridor: list[Rect] = []
    rows: list[Rect] = []
    y = inside.y0
    for i, deep in enumerate(depths):
        band = inside._replace(y0=y, y1=y + deep)
        y += deep + WALL
        if i < count:
            corridor.append(inside._replace(y0=y, y1=y + widths[i]))
            y += widths[i] + WALL
        inner = 0 < i < count
        links, blocks = _links(dice, band, inner)
        # a link reaches into the corridors beside it
        reach = (0 if i == 0 else WALL, 0 if i == count else WALL)
        corridor += [link._replace(y0=link.y0 - reach[0], y1=link.y1 + reach[1]) for link in links]
        for block in blocks:
            if inner and deep > units(7.2):
                rows += block.cut(1, block.y0 + round((deep - WALL) * dice.uniform(0.42, 0.58)))
            else:
                rows.append(block)
    long = [row for row in rows if row.width >= units(8)]
    if not long:
        return None
    first = dice.choice(long)
    rooms = [room for row in rows for room in _row(dice, row, "open_plan" if row is first else None)]
    if any(room.box.short < _NARROWEST - units(0.2) for room in rooms):
        return None
    return [Room("corridor", tuple(corridor)), *rooms]


def _links(dice: PortableRandom, band: Rect, inner: bool) -> tuple[list[Rect], list[Rect]]:
    """Return corridors across a row (inner ones have two or three, others one at times), and its blocks."""
    length = band.width
    if inner:
        places = [dice.choice((0.0, dice.uniform(0.15, 0.3))), dice.choice((1.0, dice.uniform(0.7, 0.85)))]
        if length > units(30) and dice.chance(0.6):
            places.insert(1, dice.uniform(0.42, 0.58))
    else:
        places = [dice.uniform(0.25, 0.75)] if dice.chance(0.3) else []
    links, blocks, begin = [], [], band.x0
    for place in places:
        width = dice.integer(units(1.5), units(2.0))
        low = band.x0 + round((length - width) * place)
        links.append(band._replace(x0=low, x1=low + width))
        if low > begin:
            blocks.append(band._replace(x0=begin, x1=low - WALL))
        begin = low + width + WALL
    if begin < band.x1:
        blocks.append(band._replace(x0=begin))
    return links, blocks


def _row(dice: PortableRandom, row: Rect, first: str | None) -> list[Room]:
    """Return rooms side by side that fill a row; ``first`` is one of them where it is given."""
    least = max(_NARROWEST, round(0.42 * row.height))
    uses: list[str] = []
    fronts: list[int] = []
    while True:
        use = first if first and not uses else dice.choice(_MIX)
        front = max(units(dice.uniform(*_WIDTHS[use])), least)
        if use == "open_plan" and row.height < units(3.6):
            use = "meeting"
        if fronts and sum(fronts) + (front + WALL) * 0.5 > row.width:
            break
        uses.append(use)
        fronts.append(front + WALL)
    order = dice.shuffled(range(len(uses)))
    # all fronts are stretched a little, so that they fill the row
    scale = (row.width + WALL) / sum(fronts)
    rooms, done = [], 0
    for i in order:
        low, done = done, done + fronts[i]
        room = row._replace(x0=row.x0 + round(low * scale), x1=row.x0 + round(done * scale) - WALL)
        large = uses[i] in _SMALL and room.area > _SMALL_AREA
        rooms.append(Room("meeting" if large else uses[i], (room,)))
    return rooms


class Kind(NamedTuple):
    """A kind of floor plan."""

    sides: tuple[float, float]  # least and largest outer width and height, metres
    draw_size: Callable[[PortableRandom], tuple[float, float]]  # outer width and height, metres
    # rooms inside the outer walls, the longer side along x; None for a bad draw
    draw_rooms: Callable[[PortableRandom, Rect], list[Room] | None]


KINDS = {
    "apartment": Kind((7.0, 16.0), apartment_size, apartment_rooms),
    "office": Kind((12.0, 60.0), office_size, office_rooms),
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
    refine, seed = round(refine), int(seed)
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
    return is_one_piece(grid.signed_distance("wall") >= clearance - 1e-6)


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
