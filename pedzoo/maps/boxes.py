"""Walls as few axis-aligned boxes, and which of them can be the nearest one of a place.

Boxes and places are lattice-aligned: corners of boxes are corners of cells, places are quarters of cells. A
place then lies wholly beside, above or at a corner of every box. The difference of the squared distances to
two boxes is a monotonic function of x plus one of y over it, largest and smallest at the place's corners. So
a box that is no nearer than another at all four corners is no nearer anywhere between.

* The box nearest to all four corners is the nearest of the whole place.
* Otherwise the boxes nearest to one of the sixteen corners of the place and its neighbours compete, less
  those that another beats at all four. A box is missed if its region lies between corners of two places in a
  row without holding any; tests count how rare that is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.maps.constants import CANDIDATES
from pedzoo.maps.grid import OccupancyGrid, Unknown

FAR = 1e9
"""Where, in cells, the walls of a map without walls are."""

_CHUNK = 1 << 16


def boxes(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.float64]:
    """Return the walls of a floor plan as rectangles that do not overlap and leave no wall cell out.

    Boxes (M, 4): x0, y0, x1, y1 in metres from the outer corner of cell (0, 0); the grid's origin and yaw are
    not applied.
    """
    return merge_cells(grid.occupied(unknown)) * np.float64(grid.resolution)


def merge_cells(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return a partition of the true cells (H, W) into rectangles (M, 4): x0, y0, x1, y1, cell borders.

    Runs along one axis that repeat exactly in the next line are joined. Both axes are tried and the one that
    needs fewer boxes is kept; plain walls come out minimal, ragged ones do not.
    """
    rows, columns = _merge_rows(cells), _merge_rows(cells.T)[:, [1, 0, 3, 2]]
    return rows if len(rows) <= len(columns) else columns


def _merge_rows(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    # A run begins where the padded row steps up and ends where it steps down; both come in the same order.
    steps = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(steps == 1)
    end = np.nonzero(steps == -1)[1]

    # Sorted by extent and then by row, the runs of one box stand next to one another.
    order = np.lexsort((row, end, start))
    row, start, end = row[order], start[order], end[order]
    same = (np.diff(start) == 0) & (np.diff(end) == 0) & (np.diff(row) == 1)
    first = np.concatenate(([True], ~same)) if len(row) else np.zeros(0, dtype=bool)
    last = np.concatenate((~same, [True])) if len(row) else first
    return np.stack((start[first], row[first], end[first], row[last] + 1), axis=1)


class NearestBoxes(NamedTuple):
    """What a map's cells (H, W) come to.

    Attributes:
        box: Boxes of wall and of free space (M, 4) float64: x0, y0, x1, y1 in cells.
        sets: Boxes that contend with one another (S, CANDIDATES), repeated where they are fewer.
        choice: For each quarter of a cell (2H, 2W) a box, or M plus a set; boxes are walls for free places
            and free space for walls.
        sign: Plus one for each box of wall and minus one for each of free space (M,).
        least: What any position in a quarter is away from the nearest wall, at least; negative inside walls
            (2H, 2W) float32, in cells.
    """

    box: NDArray[np.float64]
    sets: NDArray[np.int64]
    choice: NDArray[np.int64]
    sign: NDArray[np.float64]
    least: NDArray[np.float32]


def nearest_boxes(walls: NDArray[np.bool_]) -> NearestBoxes:
    """Return the boxes of walls and free space, and which can be the nearest of the other kind where."""
    choices = np.zeros([2 * size for size in walls.shape], dtype=np.int64)
    least, count = np.empty(choices.shape, dtype=np.float32), 0
    parts, sets, mixed_places, signs = [], [], [], []
    for sign, side in ((1, walls), (-1, ~walls)):
        box = merge_cells(side)
        label, gap = _nearest_box(box, side.shape)
        corners, gaps = (
            [each[:-1, :-1], each[:-1, 1:], each[1:, :-1], each[1:, 1:]] for each in (label, gap)
        )
        mine = np.repeat(np.repeat(~side, 2, axis=0), 2, axis=1)
        mixed = mine & np.any([corner != corners[0] for corner in corners[1:]], axis=0)
        choices[mine] = corners[0][mine] + count
        places = np.nonzero(mixed)
        mixed_places.append(places)
        around = np.pad(label, 1, mode="edge")
        for start in range(0, len(places[0]), _CHUNK):
            row, column = (axis[start : start + _CHUNK] for axis in places)
            near = np.stack([around[row + i, column + j] for i in range(4) for j in range(4)], axis=1)
            sets.append(_unbeaten(near, box, row, column) + count)
        parts.append(box if len(box) else np.full((1, 4), FAR))
        signs.append(np.full(len(parts[-1]), float(sign)))
        # distances are least at a corner; inside walls a place is at most half a quarter's diagonal deeper
        deeper = np.float32(math.sqrt(0.125))
        bound = np.min(gaps, axis=0) if sign > 0 else -np.max(gaps, axis=0) - deeper
        least[mine] = bound[mine]
        count += len(parts[-1])
    row, column = (np.concatenate(axis) for axis in zip(*mixed_places, strict=True))
    choices[row, column] = count + np.arange(len(row))
    return NearestBoxes(
        np.concatenate(parts).astype(np.float64),
        np.concatenate([np.zeros((0, CANDIDATES), dtype=np.int64), *sets]),
        choices,
        np.concatenate(signs),
        least,
    )


def _nearest_box(
    box: NDArray[np.int64], shape: tuple[int, ...]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the box nearest to each corner of quarters (2H + 1, 2W + 1), and its distance in cells."""
    from scipy.ndimage import distance_transform_edt

    size = [2 * side + 1 for side in shape]
    if not len(box):
        return np.zeros(size, dtype=np.int32), np.full(size, math.hypot(FAR, FAR), dtype=np.float32)
    label = np.full(size, -1, dtype=np.int32)
    for number, (x0, y0, x1, y1) in enumerate(2 * box):
        label[y0 : y1 + 1, x0 : x1 + 1] = number  # closed boxes: the corners on their edges are theirs
    row, column = np.asarray(distance_transform_edt(label < 0, return_distances=False, return_indices=True))
    y = (row - np.arange(size[0], dtype=np.int32)[:, None]).astype(np.float32)
    x = (column - np.arange(size[1], dtype=np.int32)).astype(np.float32)
    return label[row, column], np.hypot(x, y, out=x) / 2  # a box's nearest point is a corner of a quarter


def _unbeaten(
    near: NDArray[np.int32], box: NDArray[np.int64], row: NDArray[np.int64], column: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the boxes (N, CANDIDATES) among ``near`` (N, 16) that no other beats all over each place."""
    near = np.sort(near, axis=1)
    again = np.diff(near, axis=1, prepend=-1) == 0
    near = np.take_along_axis(near, np.argsort(again, axis=1, kind="stable"), axis=1)
    number = near.shape[1] - again.sum(axis=1)
    result = np.empty((len(near), CANDIDATES), dtype=np.int64)
    done = 0
    for width in (2, 4, 8, 16):  # most places have few different boxes around: no work for sixteen there
        rows = np.nonzero((number > done) & (number <= width))[0]
        done = width
        some = near[rows, :width]
        some = np.where(np.arange(width) < number[rows, None], some, some[:, :1])
        # squared distances to the four corners, in half cells
        edges = (2 * box)[some]
        squared = []
        for low, high, place in ((0, 2, column[rows]), (1, 3, row[rows])):
            at = place[:, None, None] + np.arange(2)
            gap = np.maximum(edges[..., low, None] - at, at - edges[..., high, None])
            squared.append(np.maximum(gap, 0) ** 2)
        corner = (squared[0][..., None] + squared[1][..., None, :]).reshape(len(rows), width, 4)
        keep = np.arange(width) < number[rows, None]
        for best in corner.argmin(axis=1).T:
            rival = corner[np.arange(len(rows)), best][:, None]
            as_near, equal = (rival <= corner).all(axis=2), (rival == corner).all(axis=2)
            # of equal boxes the first stays
            keep &= ~(as_near & (~equal | (best[:, None] < np.arange(width))))
        order = np.argsort(np.where(keep, corner.sum(axis=2), np.iinfo(np.int64).max), axis=1)
        order = order[:, :CANDIDATES]
        stored = np.take_along_axis(keep, order, axis=1)
        chosen = np.take_along_axis(some, order, axis=1)
        chosen = np.where(stored, chosen, chosen[:, :1])
        result[rows] = chosen[:, np.minimum(np.arange(CANDIDATES), width - 1)]
    return result
