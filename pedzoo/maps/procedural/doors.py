"""Doors: every room within reach of every other one, and some loops."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

from pedzoo.maps.procedural.portable_random import PortableRandom
from pedzoo.maps.procedural.shapes import WALL, Door, Rect, Room, units

JAMB = 2
"""Units of wall on both sides of a door, at least."""


class _Habit(NamedTuple):
    """How a room is entered.

    Attributes:
        private: The higher, the less do ways lead through it to others.
        widths: Of its doors: shares of the range that doors are drawn from.
        loops: Probability that a wall that it shares with another room gets a door that is not needed; that
            of the two rooms multiply.
    """

    private: float
    widths: tuple[float, float]
    loops: float


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


class _Wall(NamedTuple):
    """A straight stretch of inner wall between two rooms; the other axis is its thickness."""

    rooms: tuple[int, int]
    stretch: Rect
    axis: int

    @property
    def length(self) -> int:
        return (self.stretch.width, self.stretch.height)[self.axis]


def draw_doors(dice: PortableRandom, rooms: Sequence[Room], widths: tuple[int, int]) -> list[Door] | None:
    """Return doors that join all rooms: a tree that prefers halls and corridors, and some more.

    Their ``widths`` are in units, least and largest. None where the rooms cannot be joined.
    """
    walls = [wall for wall in _walls(rooms) if wall.length >= widths[0] + 2 * JAMB]

    def weight(wall: _Wall) -> float:
        return sum(_HABITS[rooms[i].use].private for i in wall.rooms) + dice.uniform(0.0, 0.9)

    # Kruskal: the least private walls first, each where it joins what was apart
    ranked = sorted((weight(wall), wall) for wall in walls)
    part = list(range(len(rooms)))
    doors: list[Door] = []
    spare: list[_Wall] = []
    for _, wall in ranked:
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
        if not any(door.ahead(0).grown(units(1), units(1)).overlaps(known.opening) for known in doors):
            doors.append(door)
    return doors


def _walls(rooms: Sequence[Room]) -> list[_Wall]:
    """Return the stretches that two rooms have between them."""
    result = []
    for (i, one), (j, other) in combinations(enumerate(rooms), 2):
        for a in one.parts:
            for b in other.parts:
                for axis in (0, 1):
                    if wall := _between(a, b, axis):
                        result.append(_Wall((i, j), wall, axis))
    return result


def _between(a: Rect, b: Rect, axis: int) -> Rect | None:
    """Return the inner wall between two rectangles that runs along ``axis``, None where there is none."""
    if axis == 1:
        wall = _between(a.swapped(), b.swapped(), 0)
        return wall.swapped() if wall else None
    if a.y0 > b.y0:
        a, b = b, a
    low, high = max(a.x0, b.x0), min(a.x1, b.x1)
    return Rect(low, a.y1, high, b.y0) if b.y0 - a.y1 == WALL and low < high else None


def _door(dice: PortableRandom, rooms: Sequence[Room], wall: _Wall, widths: tuple[int, int]) -> Door:
    """Return a door somewhere in a wall: half of the doors are close to one of its ends."""
    shares = [_HABITS[rooms[i].use].widths for i in wall.rooms]
    # the narrower habit counts: all doors of a bathroom are narrow
    low, high = min(shares, key=lambda share: share[1])
    width = widths[0] + round((widths[1] - widths[0]) * dice.uniform(low, high))
    width = min(width, wall.length - 2 * JAMB)
    room = wall.length - 2 * JAMB - width
    close = min(room, dice.integer(0, units(0.3)))
    at = JAMB + dice.choice((close, room - close, dice.integer(0, room), dice.integer(0, room)))
    if wall.axis == 0:
        x0 = wall.stretch.x0 + at
        opening = wall.stretch._replace(x0=x0, x1=x0 + width)
    else:
        y0 = wall.stretch.y0 + at
        opening = wall.stretch._replace(y0=y0, y1=y0 + width)
    return Door(wall.rooms, opening, wall.axis)
