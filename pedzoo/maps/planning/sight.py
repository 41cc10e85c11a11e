"""Lines of sight between the open cells of a floor plan, exact and for many pairs of cells at once."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

_FEW = 1500
"""Columns left of all lines at which looking at every one of them is cheaper than leaping on."""

_ROUNDING = 1e-6
"""Cells: lines between centres miss other centres by far more, unless they meet them."""

_DIAGONAL = 2**0.5


class Sight:
    """Which open cells see one another.

    They do if the line between their centres stays where walkers may be: in squares between four open cells,
    or on edges between two. Each step to a neighbour is such a line, so that the shortest lines of sight
    between two cells bend only at corners of the open cells; and as distances to walls are read bilinearly
    between centres, every point of a line keeps the clearance that the open cells have.
    """

    def __init__(self, is_open: NDArray[np.bool_]) -> None:
        """Take which cells are open (H, W)."""
        square = np.zeros_like(is_open)
        square[:-1, :-1] = is_open[:-1, :-1] & is_open[1:, :-1] & is_open[:-1, 1:] & is_open[1:, 1:]
        # How many columns on are certain to be clear in every direction; 0 where the line is blocked.
        # Squares are entered anywhere and left diagonally; along an axis only cells' centres matter.
        squares = np.maximum((_room(square) - _DIAGONAL) / _DIAGONAL, 1) * square
        cells = np.maximum(np.ceil(_room(is_open)) - 1, 1) * is_open
        self._width = is_open.shape[1]
        self._cells = is_open.size
        self._leap = np.concatenate((squares.ravel(), cells.ravel())).astype(np.int16)

    def clear(self, origin: NDArray[np.int32], target: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which lines (M,) are clear, from and to columns and rows of open cells (M, 2)."""
        way = (target - origin).astype(np.int64)
        size = np.abs(way)
        steep = size[:, 1] > size[:, 0]
        steps = size.max(axis=1)
        along, across = np.where(steep[:, None], way[:, ::-1], way).T
        slope = across / np.maximum(steps, 1)
        # flat index = base + column * forward + floor(height) * sideways, columns counted along the line
        forward = np.where(steep, self._width, 1)
        sideways = np.where(steep, 1, self._width)
        base = (
            origin[:, 1].astype(np.int64) * self._width + origin[:, 0] + np.where(across == 0, self._cells, 0)
        )
        base -= np.where(along < 0, forward, 0)  # squares are named by their smallest corner
        forward = np.where(along < 0, -forward, forward)

        seen = np.ones(len(way), dtype=bool)
        open_lines = np.flatnonzero(steps)
        at = np.zeros(len(open_lines), dtype=np.int64)
        lines = base, forward, sideways, slope, steps
        while True:
            room = self._look(at, *(part[open_lines] for part in lines[:4]))
            seen[open_lines[room == 0]] = False
            at = at + room
            rest = (room > 0) & (at < steps[open_lines])
            open_lines, at = open_lines[rest], at[rest]
            count = steps[open_lines] - at
            if count.sum() <= _FEW:
                break
        line = np.repeat(open_lines, count)
        column = np.arange(len(line)) + np.repeat(at - (count.cumsum() - count), count)
        seen[line[self._look(column, *(part[line] for part in lines[:4])) == 0]] = False
        return seen

    def _look(
        self,
        column: NDArray[np.int64],
        base: NDArray[np.int64],
        forward: NDArray[np.int64],
        sideways: NDArray[np.int64],
        slope: NDArray[np.float64],
    ) -> NDArray[np.int16]:
        """Return the leaps of lines that are at the beginning of a column of squares, which may be two."""
        begin = slope * column
        end = begin + slope
        low = np.floor(np.minimum(begin, end) + _ROUNDING).astype(np.int64)
        high = np.ceil(np.maximum(begin, end) - _ROUNDING).astype(np.int64) - 1
        at = base + column * forward
        return np.minimum(self._leap[at + low * sideways], self._leap[at + np.maximum(high, low) * sideways])


def _room(free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance of every cell to the nearest one that is not free, outside the map included."""
    return np.asarray(distance_transform_edt(np.pad(free, 1)))[1:-1, 1:-1]
