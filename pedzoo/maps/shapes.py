"""Rooms and doors of drawn floor plans, and random numbers that are the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple, TypeVar
from zlib import crc32

import numpy as np

Item = TypeVar("Item")


class PortableRandom:
    """Draws from PCG64.

    numpy promises that the bits of PCG64 and SeedSequence stay what they are, but not what `Generator` makes
    of them. Numbers are therefore made from the bits here, by additions and multiplications alone.
    """

    def __init__(self, seed: int, *parts: int | str) -> None:
        """Start the stream of ``seed`` and of its purpose: other parts give independent numbers."""
        entropy = [seed, *(crc32(part.encode()) if isinstance(part, str) else part for part in parts)]
        self._bits = np.random.PCG64(np.random.SeedSequence(entropy))

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Return a number from ``low`` up to ``high``."""
        return low + (high - low) * ((int(self._bits.random_raw()) >> 11) * 2.0**-53)

    def integer(self, low: int, high: int) -> int:
        """Return a whole number from ``low`` to ``high``, both of them possible."""
        return low + min(int(self.uniform() * (high - low + 1)), high - low)

    def chance(self, probability: float) -> bool:
        """Return true with this probability."""
        return self.uniform() < probability

    def choice(self, items: Sequence[Item]) -> Item:
        """Return one of the items."""
        return items[self.integer(0, len(items) - 1)]

    def shuffled(self, items: Sequence[Item]) -> list[Item]:
        """Return the items in random order (Fisher and Yates)."""
        mixed = list(items)
        for last in range(len(mixed) - 1, 0, -1):
            other = self.integer(0, last)
            mixed[last], mixed[other] = mixed[other], mixed[last]
        return mixed


UNIT = 0.05  # metres: walls, doors and pieces of furniture begin and end on a whole number of these
WALL = 2  # units: inner walls are 0.1 m thick
JAMB = 2  # units of wall on both sides of a door, at least


def units(metres: float) -> int:
    """Return the whole number of units that is nearest to a length in metres."""
    return round(metres / UNIT)


class Rect(NamedTuple):
    """A rectangle of units: low corner, high corner."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        """Units along x."""
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        """Units along y."""
        return self.y1 - self.y0

    @property
    def area(self) -> float:
        """Square metres."""
        return self.width * self.height * UNIT**2

    @property
    def short(self) -> int:
        """Units of the shorter side."""
        return min(self.width, self.height)

    @property
    def long(self) -> int:
        """Units of the longer side."""
        return max(self.width, self.height)

    def along(self, axis: int) -> int:
        """Return its units along x (0) or y (1)."""
        return self[2 + axis] - self[axis]

    def overlaps(self, other: Rect) -> bool:
        """Whether they have a unit in common."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def holds(self, other: Rect) -> bool:
        """Whether the other one lies inside."""
        return self.x0 <= other.x0 and self.y0 <= other.y0 and other.x1 <= self.x1 and other.y1 <= self.y1

    def grown(self, along_x: int, along_y: int) -> Rect:
        """Return it with this much more on both sides."""
        return Rect(self.x0 - along_x, self.y0 - along_y, self.x1 + along_x, self.y1 + along_y)

    def cut(self, axis: int, at: int) -> tuple[Rect, Rect]:
        """Return the parts on both sides of an inner wall that begins at ``at`` along x (0) or y (1)."""
        if axis == 0:
            return self._replace(x1=at), self._replace(x0=at + WALL)
        return self._replace(y1=at), self._replace(y0=at + WALL)

    def swapped(self) -> Rect:
        """Return it with x and y exchanged."""
        return Rect(self.y0, self.x0, self.y1, self.x1)


@dataclass(frozen=True)
class Room:
    """Free space between walls.

    Attributes:
        use: Its use: ``hall``, ``bedroom``, ``corridor``, ``open_plan``, ...
        parts: Rectangles that touch or overlap; most rooms are one, halls and corridors may be several.
    """

    use: str
    parts: tuple[Rect, ...]

    @property
    def box(self) -> Rect:
        """The rectangle around all parts."""
        x0, y0, x1, y1 = zip(*self.parts, strict=True)
        return Rect(min(x0), min(y0), max(x1), max(y1))


@dataclass(frozen=True)
class Door:
    """An opening in the wall between two rooms.

    Attributes:
        rooms: Numbers of the rooms that it joins.
        opening: Part left out of the wall.
        axis: Along which its width is measured: 0 for x, 1 for y.
    """

    rooms: tuple[int, int]
    opening: Rect
    axis: int

    @property
    def width(self) -> float:
        """Metres."""
        return self.opening.along(self.axis) * UNIT

    def ahead(self, distance: int) -> Rect:
        """Return the opening with ``distance`` more units on both of its sides, to walk through."""
        return self.opening.grown(0, distance) if self.axis == 0 else self.opening.grown(distance, 0)


def placed(rooms: Sequence[Room], size: tuple[int, int], swap: bool, left: bool, down: bool) -> list[Room]:
    """Return rooms laid out on ``size`` units, with x and y swapped and then mirrored along x or y."""

    def turn(rect: Rect) -> Rect:
        x0, y0, x1, y1 = rect.swapped() if swap else rect
        width, height = size[::-1] if swap else size
        if left:
            x0, x1 = width - x1, width - x0
        if down:
            y0, y1 = height - y1, height - y0
        return Rect(x0, y0, x1, y1)

    return [Room(room.use, tuple(turn(part) for part in room.parts)) for room in rooms]


class _Habit(NamedTuple):
    private: float  # the higher, the less do ways lead through the room to others
    widths: tuple[float, float]  # of its doors: shares of the range that doors are drawn from
    loops: float  # with the other room's: probability that a wall between them gets a door not needed


_HABITS = {
    "hall": _Habit(0, (0.2, 1.0), 0.8),
    "living": _Habit(1, (0.25, 1.0), 0.9),
    "kitchen": _Habit(1.5, (0.1, 0.4), 0.9),
    "bedroom": _Habit(2.5, (0.1, 0.3), 0.35),
    "study": _Habit(2.5, (0.1, 0.3), 0.4),
    "bathroom": _Habit(4, (0.0, 0.15), 0.0),
    "corridor": _Habit(0, (0.1, 1.0), 0.8),
    "open_plan": _Habit(1, (0.3, 1.0), 0.8),
    "office": _Habit(2, (0.15, 0.4), 0.2),
    "meeting": _Habit(2, (0.25, 0.8), 0.3),
    "toilets": _Habit(4, (0.1, 0.3), 0.0),
    "storage": _Habit(4, (0.0, 0.3), 0.0),
}


def draw_doors(dice: PortableRandom, rooms: Sequence[Room], widths: tuple[int, int]) -> list[Door] | None:
    """Return doors that join all rooms: a tree that prefers halls and corridors, and some more.

    Their ``widths`` are in units, least and largest. None where the rooms cannot be joined.
    """
    # each stretch of wall is an opening that is as wide as it can be
    walls = [
        Door((i, j), wall, axis)
        for (i, one), (j, other) in combinations(enumerate(rooms), 2)
        for a, b in product(one.parts, other.parts)
        for axis in (0, 1)
        if (wall := _between(a, b, axis)) and wall.along(axis) >= widths[0] + 2 * JAMB
    ]

    # Kruskal: the least private walls first, each where it joins what was apart
    weights = [
        sum(_HABITS[rooms[i].use].private for i in wall.rooms) + dice.uniform(0.0, 0.9) for wall in walls
    ]
    part = list(range(len(rooms)))
    doors: list[Door] = []
    spare: list[Door] = []
    for _, wall in sorted(zip(weights, walls, strict=True), key=lambda one: one[0]):
        one, other = (part[i] for i in wall.rooms)
        if one == other:
            spare.append(wall)
            continue
        part = [one if number == other else number for number in part]
        doors.append(_door(dice, rooms, wall, widths))
    if len(set(part)) > 1:
        return None
    for wall in spare:
        one, other = (_HABITS[rooms[i].use] for i in wall.rooms)
        if not dice.chance(one.loops * other.loops):
            continue
        door = _door(dice, rooms, wall, widths)
        if not any(door.opening.grown(units(1), units(1)).overlaps(known.opening) for known in doors):
            doors.append(door)
    return doors


def _between(a: Rect, b: Rect, axis: int) -> Rect | None:
    """Return the inner wall between two rectangles that runs along ``axis``, None where there is none."""
    if axis == 1:
        wall = _between(a.swapped(), b.swapped(), 0)
        return wall.swapped() if wall else None
    if a.y0 > b.y0:
        a, b = b, a
    low, high = max(a.x0, b.x0), min(a.x1, b.x1)
    return Rect(low, a.y1, high, b.y0) if b.y0 - a.y1 == WALL and low < high else None


def _door(dice: PortableRandom, rooms: Sequence[Room], wall: Door, widths: tuple[int, int]) -> Door:
    """Return a door somewhere in a wall: half of the doors are close to one of its ends."""
    # the narrower habit counts: all doors of a bathroom are narrow
    low, high = min((_HABITS[rooms[i].use].widths for i in wall.rooms), key=lambda share: share[1])
    width = widths[0] + round((widths[1] - widths[0]) * dice.uniform(low, high))
    length = wall.opening.along(wall.axis) - 2 * JAMB
    width = min(width, length)
    room = length - width
    close = min(room, dice.integer(0, units(0.3)))
    at = JAMB + dice.choice((close, room - close, dice.integer(0, room), dice.integer(0, room)))
    begin, (low, high) = wall.opening[wall.axis] + at, ("x0", "x1") if wall.axis == 0 else ("y0", "y1")
    return Door(wall.rooms, wall.opening._replace(**{low: begin, high: begin + width}), wall.axis)
