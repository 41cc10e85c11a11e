"""Floor plans by name, by file, and from rectangles, rooms and walls with doors."""

import math
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.maps.formats import ENDINGS, read_plan
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid

Point = tuple[float, float]
Rectangle = tuple[float, float, float, float]  # x0, y0, x1, y1 in metres, low corner first
RESOLUTIONS = (0.05, 0.04, 0.025, 0.02, 0.01)  # metres of cells: the first that all walls fit into is taken
_TOLERANCE = 1e-3  # of a cell: what an edge may lie off a cell's border by rounding


def wall(
    start: Point, end: Point, thickness: float, doors: Iterable[tuple[float, float]] = ()
) -> list[Rectangle]:
    """Return a straight wall along x or y, without its doors.

    Args:
        start: Where its centre line begins; walls end flush with their centre line.
        end: Where its centre line ends.
        thickness: Metres, half of it on each side of the centre line.
        doors: Openings: how far their middle is from ``start`` along the wall, and their width, metres.

    Raises:
        UserError: The wall is slanted, has no length or thickness, or the doors overlap or reach out of it.
    """
    along = 0 if start[1] == end[1] else 1
    length = abs(end[along] - start[along])
    if start[1 - along] != end[1 - along] or length == 0 or not thickness > 0:
        raise UserError(
            f"wall from {start} to {end}, {thickness} m thick: expected a length along x or along y "
            "and a thickness above 0"
        )
    sign = 1 if end[along] > start[along] else -1
    pieces, solid_from = [], 0.0
    for at, width in sorted(doors):
        if not width > 0 or at - width / 2 < solid_from or at + width / 2 > length:
            raise UserError(
                f"door {width} m wide at {at} m of a wall of {length:g} m: expected a width above 0 "
                f"and its sides between {solid_from:g} and {length:g} m"
            )
        pieces.append((solid_from, at - width / 2))
        solid_from = at + width / 2
    pieces.append((solid_from, length))

    result: list[Rectangle] = []
    left, right = start[1 - along] - thickness / 2, start[1 - along] + thickness / 2
    for ends in pieces:
        low, high = sorted(start[along] + sign * value for value in ends)
        if low < high:  # a door may begin at the wall's end
            result.append((low, left, high, right) if along == 0 else (left, low, right, high))
    return result


def room(low: Point, high: Point, thickness: float) -> list[Rectangle]:
    """Return the four walls around the free space between two corners, all of it left free.

    Raises:
        UserError: The room or its walls have no extent.
    """
    (x0, y0), (x1, y1) = low, high
    if not (x0 < x1 and y0 < y1 and thickness > 0):
        raise UserError(
            f"room from {low} to {high} with walls of {thickness} m: expected the low corner first "
            "and a thickness above 0"
        )
    left, right = x0 - thickness, x1 + thickness
    across = [(left, y0 - thickness, right, y0), (left, y1, right, y1 + thickness)]
    return [*across, (left, y0, x0, y1), (x1, y0, right, y1)]


def rectangles(
    walls: Sequence[Rectangle],
    resolution: float | None = None,
    *,
    around: Rectangle | None = None,
    name: str = "plan",
) -> OccupancyGrid:
    """Return the floor plan in which exactly ``walls`` are occupied and all else is free.

    Nothing is rounded: all edges must lie on borders of cells, counted from the plan's low corner.

    Args:
        walls: Rectangles in the map's frame, metres; they may overlap.
        resolution: Side of a cell in metres; None takes the largest of ``RESOLUTIONS`` that fits.
        around: Area that the plan covers besides the walls' bounding box.
        name: The map's name in messages.

    Raises:
        UserError: There is no wall, one has no extent, or an edge lies on no border of a cell.
    """
    every = [*walls, around] if around is not None else [*walls]
    edges = np.array(every, dtype=np.float64).reshape(-1, 4)
    if not len(edges) or not np.isfinite(edges).all() or (edges[:, :2] >= edges[:, 2:]).any():
        raise UserError(f"plan {name!r}: expected rectangles (x0, y0, x1, y1) with x0 < x1 and y0 < y1")
    low = edges[:, :2].min(axis=0)
    lengths = edges - np.tile(low, 2)
    if resolution is None:
        resolution = next((size for size in RESOLUTIONS if _misfit(lengths, size) is None), RESOLUTIONS[-1])
    if not resolution > 0:
        raise UserError(f"plan {name!r}: resolution {resolution} must be metres per cell, above 0")
    if (worst := _misfit(lengths, resolution)) is not None:
        axis, below = worst[1] % 2, np.floor(lengths[worst] / resolution) * resolution + low[worst[1] % 2]
        fitting = [f"{size:g}" for size in RESOLUTIONS if _misfit(lengths, size) is None]
        raise UserError(
            f"plan {name!r}: a wall's edge at {'xy'[axis]} = {edges[worst]:g} is not between cells of "
            f"{resolution:g} m that begin at {low[axis]:g}: the nearest are {below:g} and "
            f"{below + resolution:g}" + (f"; resolution {fitting[0]} would fit" if fitting else "")
        )
    borders = np.rint(lengths / resolution).astype(int)
    cells = np.full(borders[:, [3, 2]].max(axis=0), FREE, dtype=np.uint8)
    for x0, y0, x1, y1 in borders[: len(walls)]:
        cells[y0:y1, x0:x1] = OCCUPIED
    return OccupancyGrid(cells, resolution, (float(low[0]), float(low[1]), 0.0), name=name)


def check_lengths(what: str, resolution: float, *, instead: str = "", **lengths: float) -> None:
    """Check that ``lengths`` of ``what`` are whole cells; ``instead`` is another fix for the message.

    Raises:
        UserError: A length or the resolution is not above 0, or a length is no multiple of it.
    """
    if not resolution > 0 or not all(length > 0 for length in lengths.values()):
        given = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise UserError(f"{what}: {given}, resolution {resolution}: expected above 0")
    for name, length in lengths.items():
        cells = length / resolution
        if abs(cells - round(cells)) > _TOLERANCE:
            near = [f"{math.floor(cells + more) * resolution:g}" for more in (0, 1)]
            raise UserError(
                f"{what}: {name} {length} is no multiple of the resolution {resolution:g}: the nearest are "
                f"{' and '.join(near)}{instead and f'; {instead}'}"
            )


def _misfit(lengths: np.ndarray, resolution: float) -> tuple[int, int] | None:
    """Return which of the lengths (N, 4) is farthest from whole cells, None where all are whole."""
    cells = lengths / resolution
    off = np.abs(cells - np.rint(cells))
    worst = np.unravel_index(off.argmax(), off.shape)
    return (int(worst[0]), int(worst[1])) if off[worst] > _TOLERANCE else None


_DRAWN = re.compile(r"(?P<kind>[a-z_]+)\.(?P<seed>\d{1,18})(?P<bare>\.bare)?")


def load_plan(name: str | Path) -> OccupancyGrid:
    """Return the floor plan of a name or a file.

    Args:
        name: ``flat``; a kind of `pedzoo.maps.procedural` and a seed, ``apartment.7`` or ``office.7``, with
            ``.bare`` behind it without furniture; or a file, as `pedzoo.maps.formats.read_plan` takes it.

    Raises:
        UserError: There is no such plan; or the file is missing or broken.
    """
    text = str(name)
    if Path(text).suffix.lower() in ENDINGS:
        return read_plan(text)
    if text == "flat":
        return flat()
    from pedzoo.maps.procedural import KINDS, generate

    if (drawn := _DRAWN.fullmatch(text)) and drawn["kind"] in KINDS:
        return generate(drawn["kind"], int(drawn["seed"]), furnished=0.0 if drawn["bare"] else 1.0).grid
    if "/" in text or "\\" in text or Path(text).exists():
        return read_plan(text)  # which says what files it takes
    kind, _, rest = text.partition(".")
    near = get_close_matches(kind, ["flat", *KINDS], n=1)
    seed = rest if re.fullmatch(r"\d{1,18}(\.bare)?", rest) else "7"
    hint = f"did you mean '{near[0] if near[0] == 'flat' else f'{near[0]}.{seed}'}'? " if near else ""
    known = ", ".join(["flat", *(f"{kind}.SEED" for kind in KINDS)])
    raise UserError(
        f"unknown floor plan {text!r}: {hint}known: {known} (SEED.bare without furniture), and files: a ROS "
        "map yaml or an image"
    )


def flat() -> OccupancyGrid:
    """Return four rooms of about 4.5 x 3.5 m along a corridor of 1.8 m: a floor plan that needs no file."""
    walls = room((0.0, 0.0), (9.1, 9.0), 0.1)
    for y in (3.65, 5.55):
        walls += wall((0.0, y), (9.1, y), 0.1, doors=[(2.25, 0.9), (6.85, 0.9)])
    for low, high in ((0.0, 3.6), (5.6, 9.0)):
        walls += wall((4.55, low), (4.55, high), 0.1)
    return rectangles(walls, 0.05, name="flat")
