"""Outlines of walls: occupied cells as simplified polygons along cell edges."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.walls.simplified import simplified

# directions of unit steps along cell edges: right, up, left, down; a left turn adds one
_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def outlines(occupied: NDArray[np.bool_], tolerance: float = 0.5) -> list[NDArray[np.float64]]:
    """Return the borders between occupied and free cells (H, W) as polygons (V, 2), x and y in cells.

    Walls lie to the left of every edge: solids run counter-clockwise, free spaces inside them clockwise. The
    world outside the map is free, so walls that touch its border are closed there. Solids that touch at a
    corner only are polygons of their own. A simplified border departs from the exact one by ``tolerance``
    cells at most, unless it would lose its area.
    """
    return [_simplified(polygon, tolerance) for polygon in _trace(occupied)]


def without_hollows(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.bool_]:
    """Return the walls (H, W) of a floor plan, filled up where no body fits between walls.

    Scanned walls are often two thin lines with nothing between; the far one would push through the near one.
    """
    from scipy.ndimage import label, maximum

    # the world around the map is free and wide
    distance = np.pad(grid.signed_distance(unknown), 1, constant_values=np.inf)
    parts, count = cast("tuple[NDArray[np.int32], int]", label(distance > 0))
    widest = np.asarray(maximum(distance, parts, np.arange(count + 1)))
    return grid.occupied(unknown) | (widest < BODY_RADIUS)[parts][1:-1, 1:-1]


def _trace(occupied: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Return the exact borders as corners between straight runs (V, 2)."""
    solid = np.pad(occupied, 1).astype(np.int8)
    up, right = np.diff(solid, axis=0)[:, 1:-1], np.diff(solid, axis=1)[1:-1]
    width = occupied.shape[1] + 1

    # The edge that leaves each lattice point (row, column) in each direction, with the wall on its left.
    leaves = np.zeros((occupied.shape[0] + 1, width, 4), dtype=bool)
    leaves[:, :-1, 0] = up == 1
    leaves[:, 1:, 2] = up == -1
    leaves[:-1, :, 1] = right == -1
    leaves[1:, :, 3] = right == 1
    leaves = leaves.reshape(-1, 4)
    point, heading = np.nonzero(leaves)
    number = np.full(leaves.shape, -1)
    number[leaves] = np.arange(len(point))

    # Left first where two edges go on: solids that touch at a corner stay apart.
    end = point + _STEPS[heading, 0] + width * _STEPS[heading, 1]
    options = np.stack([number[end, (heading + turn) % 4] for turn in (1, 0, -1)])
    following = np.take_along_axis(options, (options >= 0).argmax(0)[None], axis=0)[0]
    corner = np.empty(len(end), dtype=bool)  # does an edge start where the border turns?
    corner[following] = heading[following] != heading

    places = np.column_stack((point % width, point // width))
    polygons, seen, successors = [], np.zeros(len(point), dtype=bool), following.tolist()
    for first in corner.nonzero()[0].tolist():
        if seen[first]:
            continue
        cycle, edge = [first], successors[first]
        while edge != first:
            cycle.append(edge)
            edge = successors[edge]
        seen[cycle] = True
        polygons.append(places[[edge for edge in cycle if corner[edge]]])
    return polygons


def _simplified(polygon: NDArray[np.int64], tolerance: float = 0.5) -> NDArray[np.float64]:
    exact = polygon.astype(np.float64)
    if tolerance <= 0:
        return exact
    short = simplified(exact, tolerance)
    # thin and tiny walls may collapse or turn inside out
    return short if len(short) > 2 and signed_area(short) * signed_area(exact) > 0 else exact


def signed_area(polygon: NDArray[np.float64]) -> float:
    """Return the area inside a polygon (V, 2), positive if it runs counter-clockwise."""
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
