"""Shapes of floor plans: rectangles, rooms and doors, all of them in whole units of 5 cm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

UNIT = 0.05
"""Metres: every wall, door and piece of furniture begins and ends on a whole number of these."""

WALL = 2
"""Units: inner walls are 0.1 m thick."""


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
        return (self.opening.width, self.opening.height)[self.axis] * UNIT

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
