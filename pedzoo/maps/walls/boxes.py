"""Walls as few axis-aligned boxes, for physics engines and distance queries."""

import numpy as np
from numpy.typing import NDArray

from pedzoo.maps.grid import OccupancyGrid, Unknown


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
