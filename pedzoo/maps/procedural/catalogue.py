"""Furniture by the use of a room: its kinds, sizes and places."""

from typing import Literal, NamedTuple

from pedzoo.maps.procedural.portable_random import PortableRandom
from pedzoo.maps.procedural.shapes import Rect, units

Place = Literal["corner", "wall", "middle"]


class Kind(NamedTuple):
    """A kind of furniture; lengths in metres.

    Attributes:
        name: What it is.
        along: Least and largest length along the wall.
        deep: Least and largest depth away from the wall.
        place: In a corner, at a wall, or free-standing.
        every: Square metres of room for each one that there may be.
        chance: Probability that it is there.
        front: What stands before it: length, depth and distance.
        chairs: Whether chairs stand along both of its long sides.
    """

    name: str
    along: tuple[float, float]
    deep: tuple[float, float]
    place: Place
    every: float = 30.0
    chance: float = 0.8
    front: tuple[float, float, float] | None = None
    chairs: bool = False

    def draw(self, dice: PortableRandom) -> list[tuple[str, Rect]]:
        """Return the rectangles of one piece, x along the wall and y away from it, and their names."""
        length, depth = units(dice.uniform(*self.along)), units(dice.uniform(*self.deep))
        pieces = [(self.name, Rect(0, 0, length, depth))]
        if self.front:
            wide, deep, gap = (units(value) for value in self.front)
            begin = (length - wide) // 2
            pieces.append(("front", Rect(begin, depth + gap, begin + wide, depth + gap + deep)))
        if self.chairs:
            pieces += _chairs(length, depth)
        return pieces


def desks(count: int) -> list[tuple[str, Rect]]:
    """Return ``count`` desks side by side and as many behind them, with their chairs."""
    length, depth = count * units(1.4), units(1.6)
    return [("desks", Rect(0, 0, length, depth)), *_chairs(length, depth, units(1.4))]


def _chairs(length: int, depth: int, spacing: int = 14) -> list[tuple[str, Rect]]:
    # chairs of 0.45 m, a third of them under the table
    seat, under = units(0.45), units(0.15)
    count = max(length // spacing, 1)
    first = (length - count * spacing + spacing - seat) // 2
    rows = ((under - seat, 0), (depth, depth + seat - under))
    return [
        ("chair", Rect(first + k * spacing, low, first + k * spacing + seat, high))
        for low, high in rows
        for k in range(count)
    ]


_CHAIR = (0.45, 0.45, 0.05)

CATALOGUE: dict[str, tuple[Kind, ...]] = {
    "bedroom": (
        Kind("bed", (0.9, 1.8), (2.0, 2.1), "wall", 18, 1.0),
        Kind("wardrobe", (1.2, 2.4), (0.6, 0.6), "corner", 14, 0.95),
        Kind("desk", (1.1, 1.5), (0.6, 0.75), "wall", 20, 0.6, front=_CHAIR),
        Kind("shelf", (0.8, 1.4), (0.3, 0.4), "wall", 14, 0.6),
    ),
    "living": (
        Kind("sofa", (1.7, 2.4), (0.85, 0.95), "wall", 24, 1.0, front=(1.0, 0.6, 0.4)),
        Kind("table", (1.3, 2.0), (0.8, 0.9), "middle", 24, 0.9, chairs=True),
        Kind("sideboard", (1.4, 2.0), (0.4, 0.45), "wall", 18, 0.9),
        Kind("armchair", (0.8, 0.9), (0.8, 0.9), "corner", 20, 0.6),
        Kind("shelf", (1.0, 2.0), (0.3, 0.4), "wall", 12, 0.7),
    ),
    "kitchen": (
        Kind("counter", (1.8, 3.0), (0.6, 0.6), "corner", 30, 1.0),
        Kind("cupboard", (0.6, 1.4), (0.6, 0.6), "corner", 8, 0.9),
        Kind("table", (0.8, 1.4), (0.7, 0.8), "middle", 14, 0.8, chairs=True),
        Kind("table", (0.8, 1.2), (0.6, 0.7), "wall", 30, 0.3),
    ),
    "bathroom": (
        Kind("bath", (1.6, 1.7), (0.7, 0.75), "corner", 30, 0.8),
        Kind("basin", (0.6, 0.9), (0.45, 0.5), "wall", 12, 1.0),
        Kind("toilet", (0.4, 0.4), (0.6, 0.65), "wall", 30, 1.0),
        Kind("cupboard", (0.4, 0.8), (0.35, 0.4), "corner", 10, 0.6),
    ),
    "study": (
        Kind("desk", (1.4, 1.8), (0.7, 0.8), "wall", 10, 1.0, front=_CHAIR),
        Kind("shelf", (1.0, 2.0), (0.3, 0.4), "wall", 6, 0.8),
    ),
    "storage": (Kind("shelf", (1.0, 2.4), (0.4, 0.6), "corner", 4, 0.9),),
    "hall": (Kind("cupboard", (0.8, 1.2), (0.3, 0.35), "corner", 8, 0.5),),
    "corridor": (
        Kind("printer", (0.7, 1.2), (0.5, 0.6), "wall", 60, 0.5),
        Kind("bench", (1.2, 1.8), (0.4, 0.45), "wall", 60, 0.5),
    ),
    "office": (
        Kind("desk", (1.4, 1.6), (0.7, 0.8), "wall", 9, 1.0, front=_CHAIR),
        Kind("cabinet", (0.8, 1.6), (0.4, 0.45), "corner", 9, 0.9),
        Kind("table", (0.8, 1.2), (0.8, 0.8), "middle", 18, 0.5, chairs=True),
    ),
    "meeting": (
        Kind("table", (2.0, 3.6), (1.0, 1.2), "middle", 24, 1.0, chairs=True),
        Kind("sideboard", (1.2, 2.0), (0.4, 0.45), "wall", 20, 0.7),
    ),
    "open_plan": (
        Kind("cabinet", (0.8, 2.4), (0.4, 0.45), "wall", 14, 0.8),
        Kind("sofa", (1.6, 2.2), (0.8, 0.9), "corner", 50, 0.5, front=(0.8, 0.6, 0.4)),
    ),
    "toilets": (
        Kind("cubicle", (0.9, 0.9), (0.7, 0.7), "corner", 4, 0.9),
        Kind("basins", (0.9, 1.6), (0.45, 0.5), "wall", 14, 1.0),
    ),
}
"""Furniture of a room, in the order in which it is placed."""
