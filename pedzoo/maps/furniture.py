"""Furniture by the use of a room, put where nothing blocks a door and all free space stays one."""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from pedzoo.maps.shapes import Door, PortableRandom, Rect, Room, units


class Piece(NamedTuple):
    """A piece of furniture."""

    name: str
    rect: Rect


class Kind(NamedTuple):
    """A kind of furniture; lengths in metres."""

    name: str
    along: tuple[float, float]  # least and largest length along the wall
    deep: tuple[float, float]  # least and largest depth away from the wall
    place: Literal["corner", "wall", "middle"]
    every: float = 30.0  # square metres of room for each one that there may be
    chance: float = 0.8  # that it is there
    front: tuple[float, float, float] | None = None  # what stands before it: length, depth and distance
    chairs: bool = False  # along both of its long sides

    def draw(self, dice: PortableRandom) -> list[Piece]:
        """Return one piece and what stands around it, x along the wall and y away from it."""
        length, depth = units(dice.uniform(*self.along)), units(dice.uniform(*self.deep))
        pieces = [Piece(self.name, Rect(0, 0, length, depth))]
        if self.front:
            wide, deep, gap = (units(value) for value in self.front)
            begin = (length - wide) // 2
            pieces.append(Piece("front", Rect(begin, depth + gap, begin + wide, depth + gap + deep)))
        return pieces + _chairs(length, depth, 14) * self.chairs


def _chairs(length: int, depth: int, spacing: int) -> list[Piece]:
    """Return chairs of 0.45 m along both sides of a table, a third of them under it."""
    seat, under = units(0.45), units(0.15)
    count = max(length // spacing, 1)
    first = (length - count * spacing + spacing - seat) // 2
    return [
        Piece("chair", Rect(first + k * spacing, low, first + k * spacing + seat, high))
        for low, high in ((under - seat, 0), (depth, depth + seat - under))
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


CLEARANCE = 0.25  # metres from walls at which the free space of a room is one piece: the planner's

# Grids for this check: cells per unit, and metres from walls. A finer grid has cells with a clearance where
# the coarser one has none: places that might be cut off.
_LAYERS = ((1, CLEARANCE), (1, 0.3), (2, CLEARANCE))

BEFORE_DOORS = units(0.9)  # kept free on both sides of a door
_TRIES = 12
_BEYOND = units(0.5)  # what a room knows of the space behind its doors


class RoomFloor:
    """The free space of a room, on which furniture is put piece by piece."""

    def __init__(self, room: Room, doors: Sequence[Door]) -> None:
        """Take an empty room and its doors."""
        self.room = room
        self.pieces: list[Piece] = []
        self._keep = [door.ahead(BEFORE_DOORS) for door in doors]
        around = room.box.grown(_BEYOND + 4, _BEYOND + 4)
        self._low = around.x0, around.y0
        self._open: list[NDArray[np.uint8]] = []
        for fine, clearance in _LAYERS:
            solid = np.ones((around.height * fine, around.width * fine), dtype=np.uint8)
            for rect in (*room.parts, *(door.ahead(_BEYOND) for door in doors)):
                solid[self._slices(rect, fine)] = 0
            away = distance_transform_edt(1 - np.pad(solid, 1, constant_values=1))
            # squares of distances between centres are whole numbers; see `_outside`
            squares = 4 * np.rint(np.asarray(away)[1:-1, 1:-1] ** 2)
            self._open.append((squares >= (2 * fine * units(clearance) + 1) ** 2).astype(np.uint8))

    def connected(self) -> bool:
        """Whether the open space is one piece, its doors included."""
        return all(map(is_one_piece, self._open))

    def put(self, pieces: Sequence[Piece]) -> bool:
        """Put pieces down together and return true, or leave them where they are not possible."""
        taken = [*self._keep, *(piece.rect for piece in self.pieces)]
        for _, rect in pieces:
            if not any(part.holds(rect) for part in self.room.parts) or any(map(rect.overlaps, taken)):
                return False
        after = [part.copy() for part in self._open]
        for part, (fine, clearance) in zip(after, _LAYERS, strict=True):
            cells = units(clearance)
            for _, rect in pieces:
                # the rectangle grown by the clearance, with rounded corners
                part[self._slices(rect.grown(cells, cells), fine)] &= _outside(
                    rect.width * fine, rect.height * fine, cells * fine
                )
        if not all(map(is_one_piece, after)):
            return False
        self._open = after
        self.pieces += pieces
        return True

    def _slices(self, rect: Rect, fine: int) -> tuple[slice, slice]:
        x, y = self._low
        return (
            slice((rect.y0 - y) * fine, (rect.y1 - y) * fine),
            slice((rect.x0 - x) * fine, (rect.x1 - x) * fine),
        )


def furnish(dice: PortableRandom, room: Room, doors: Sequence[Door], furnished: float) -> list[Piece] | None:
    """Return the furniture of a room; None where even the empty room is not one piece.

    ``furnished`` goes from 0, nothing, to 1, everything that belongs there and fits.
    """
    floor = RoomFloor(room, doors)
    if not floor.connected():
        return None
    if room.use == "open_plan":
        for group in _clusters(dice, room.box):
            if dice.chance(furnished):
                floor.put(group)
    area = sum(part.area for part in room.parts)
    for kind in CATALOGUE[room.use]:
        for _ in range(max(1, round(area / kind.every))):
            if not dice.chance(kind.chance * furnished):
                continue
            for group in _places(dice, room, kind):
                if floor.put(group):
                    break
    return floor.pieces


def _places(dice: PortableRandom, room: Room, kind: Kind) -> Iterator[list[Piece]]:
    """Yield some places for a piece."""
    pieces = kind.draw(dice)
    low = min(rect.y0 for _, rect in pieces)
    length, depth = max(rect.x1 for _, rect in pieces), max(rect.y1 for _, rect in pieces)
    for _ in range(_TRIES):
        part = dice.choice(room.parts)
        side = dice.integer(0, 3)
        along, away = part.along(side // 2) - length, part.along(1 - side // 2) - depth
        if along < 0 or away < 0:
            continue
        at, off = dice.integer(0, along), 0
        if kind.place == "corner":
            at = dice.choice((0, along))
        elif kind.place == "middle":
            # in the middle third, where the room is wide enough to walk around
            at = round(along * dice.uniform(0.35, 0.65))
            off = round((away + low) * dice.uniform(0.35, 0.65)) - low
        group = _moved(pieces, part, side, at, off)
        # not where a part of the room opens into another one
        if not any(
            other.overlaps(rect.grown(1, 1)) for other in room.parts if other != part for _, rect in group
        ):
            yield group


def _moved(pieces: Sequence[Piece], part: Rect, side: int, at: int, off: int) -> list[Piece]:
    """Return pieces drawn along a wall as they lie at the bottom, top, left or right wall of a part."""
    placed = []
    for name, (a0, d0, a1, d1) in pieces:
        along, away = (at + a0, at + a1), (off + d0, off + d1)
        if side in (1, 3):
            across = part.along(1 - side // 2)
            away = across - away[1], across - away[0]
        (x0, x1), (y0, y1) = (along, away) if side < 2 else (away, along)
        placed.append(Piece(name, Rect(part.x0 + x0, part.y0 + y0, part.x0 + x1, part.y0 + y1)))
    return placed


def _clusters(dice: PortableRandom, box: Rect) -> list[list[Piece]]:
    """Return blocks of desks in rows, as they stand in an open-plan office: as many desks as fit."""
    aisle, gap = units(dice.uniform(1.7, 2.2)), units(dice.uniform(1.2, 1.6))
    deep, most, best = units(1.6), 0, []
    for side, count in dice.shuffled([(side, count) for side in (0, 2) for count in (2, 3, 4)]):
        length, depth = box.along(side // 2), box.along(1 - side // 2)
        block = count * units(1.4)
        across = (length - 2 * units(1.2) + gap) // (block + gap)
        rows = (depth - 2 * units(1.0) + aisle) // (deep + aisle)
        if min(across, rows) < 1 or across * rows * count <= most:
            continue
        most = across * rows * count
        first = (length - across * (block + gap) + gap) // 2
        begin = (depth - rows * (deep + aisle) + aisle) // 2
        # as many desks side by side as behind them
        desks = [Piece("desks", Rect(0, 0, block, deep)), *_chairs(block, deep, units(1.4))]
        best = [
            _moved(desks, box, side, first + i * (block + gap), begin + k * (deep + aisle))
            for k in range(rows)
            for i in range(across)
        ]
    return best


def _outside(width: int, height: int, clearance: int) -> NDArray[np.uint8]:
    """Return which cells around a rectangle keep the clearance: those of it grown by that much."""
    # between centres of cells; the nearest wall begins half a cell before its centre
    x, y = (
        np.maximum(np.maximum(-at, at - (length - 1)), 0)
        for length in (width, height)
        for at in [np.arange(-clearance, length + clearance)]
    )
    return (4 * (x**2 + y[:, None] ** 2) >= (2 * clearance + 1) ** 2).astype(np.uint8)


def is_one_piece(part: NDArray[np.uint8] | NDArray[np.bool_]) -> bool:
    """Return whether cells that are not 0 are connected through their sides, as the planner's are."""
    return cast("tuple[NDArray[np.int32], int]", label(part))[1] == 1
