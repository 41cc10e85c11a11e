"""Lines of sight between the open cells of a floor plan, exact and for many pairs of cells at once."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from pedzoo.core.errors import installed

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
        if not installed("numba"):
            return self._clear_in_numpy(origin.astype(np.int64), target.astype(np.int64))
        from pedzoo.maps.planning.compiled_sight import clear_lines

        seen = np.empty(len(origin), dtype=bool)
        ends = (np.ascontiguousarray(end, dtype=np.int32) for end in (origin, target))
        clear_lines(self._leap, self._width, self._cells, *ends, seen)
        return seen

    def _clear_in_numpy(self, origin: NDArray[np.int64], target: NDArray[np.int64]) -> NDArray[np.bool_]:
        """See `clear_lines`: all lines at once, a leap of each after the other."""
        from pedzoo.maps.planning.compiled_sight import ROUNDING

        reach = target - origin
        steep = np.abs(reach[:, 1]) > np.abs(reach[:, 0])
        along, across = np.where(steep[:, None], reach[:, ::-1], reach).T
        steps = np.abs(along)
        slope = across / np.maximum(steps, 1)
        forward, sideways = np.where(steep, self._width, 1), np.where(steep, 1, self._width)
        base = origin[:, 1] * self._width + origin[:, 0] + np.where(across == 0, self._cells, 0)
        base -= np.where(along < 0, forward, 0)
        forward = np.where(along < 0, -forward, forward)
        column = np.zeros_like(steps)
        left = steps.nonzero()[0]
        while len(left):
            ends = slope[left] * column[left], slope[left] * (column[left] + 1)
            low = np.floor(np.minimum(*ends) + ROUNDING).astype(np.int64)
            high = np.maximum(np.ceil(np.maximum(*ends) - ROUNDING).astype(np.int64) - 1, low)
            at, side = base[left] + column[left] * forward[left], sideways[left]
            room = np.minimum(self._leap[at + low * side], self._leap[at + high * side])
            column[left] += room
            left = left[(room > 0) & (column[left] < steps[left])]
        return column >= steps


def _room(free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance of every cell to the nearest one that is not free, outside the map included."""
    return np.asarray(distance_transform_edt(np.pad(free, 1)))[1:-1, 1:-1]
