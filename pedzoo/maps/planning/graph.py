"""The open cells of a floor plan as a graph, and shortest paths on it."""

from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt, label, map_coordinates
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.planning.sight import Sight

STEPS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""The eight neighbours of a cell: rows and columns away."""


_SAME = 0.05
"""Metres: who is moved by less is not moved."""

POCKET = 0.5
"""Square metres: smaller parts of the open cells are left out."""


class OpenGraph:
    """The N cells of a floor plan that are open to walkers: their centres keep a clearance from walls.

    Neighbours, diagonal ones too, are joined by edges of their distance in metres, as in iGibson; but a
    diagonal step must not cut a corner: both cells beside it must be open.

    Attributes:
        grid: The floor plan.
        distance: From cell centres to the nearest wall (H, W) float32, metres, negative inside it.
        clearance: Metres that their centres keep from walls.
        shape: Rows and columns of the floor plan.
        open: Which cells are open (H, W).
        cells: Flat index (row * W + column) of every open cell (N,), growing.
        place: Column and row of every open cell (N, 2) int32.
        xy: Their centres in the map's frame (N, 2) float64, metres.
        index: Number of the open cell at every cell (H * W,) int32, -1 where it is not open.
        sight: Lines of sight between open cells.
    """

    def __init__(self, grid: OccupancyGrid, unknown: Unknown, clearance: float) -> None:
        """Find the open cells; a floor plan may have none."""
        self.grid = grid
        self.clearance = clearance
        self.distance = grid.signed_distance(unknown)
        self.shape = self.distance.shape
        self.open = _without_pockets(self.distance >= clearance - 1e-6, grid.resolution)
        self.cells = np.flatnonzero(self.open)
        self.index = np.full(self.distance.size, -1, dtype=np.int32)
        self.index[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        row, column = np.divmod(self.cells, self.shape[1])
        self.place = np.stack((column, row), axis=1).astype(np.int32)
        self._to_cell = grid.map_to_cell()
        self.xy = grid.cells_to_map(self.place)
        self.sight = Sight(self.open)

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Numbers of the neighbours (N, 8) in the order of `STEPS`; N where no step leads."""
        padded = np.pad(self.open, 1)
        number = np.full(padded.shape, len(self), dtype=np.int32)
        number[1:-1, 1:-1][self.open] = np.arange(len(self), dtype=np.int32)
        width = padded.shape[1]
        here = np.flatnonzero(padded)
        flat, numbers = padded.ravel(), number.ravel()
        result = np.empty((len(self), len(STEPS)), dtype=np.int32)
        for k, (down, right) in enumerate(STEPS):
            beside = flat[here + down * width] & flat[here + right]
            result[:, k] = np.where(
                beside | (down * right == 0), numbers[here + down * width + right], len(self)
            )
        return result

    @cached_property
    def matrix(self) -> csr_array:
        """The graph (N, N): entry (i, j) is the metres of the step from i to j."""
        real = self.neighbours < len(self)
        lengths = np.array([np.hypot(*step) for step in STEPS]) * self.grid.resolution
        ends = np.concatenate(([0], real.sum(1).cumsum()))
        data = np.broadcast_to(lengths, real.shape)[real]
        # the order of STEPS is that of the cells' numbers: the columns of each row are sorted
        return csr_array((data, self.neighbours[real], ends), shape=(len(self), len(self)))

    @cached_property
    def component(self) -> NDArray[np.int32]:
        """Which open cells have paths to one another (N,): equal numbers."""
        return np.asarray(connected_components(self.matrix, directed=False)[1])

    @cached_property
    def nearest(self) -> NDArray[np.int32]:
        """Number of the open cell nearest to every cell (H * W,); 0 on a floor plan without any."""
        if not len(self):
            return np.zeros(self.index.shape, dtype=np.int32)
        to = distance_transform_edt(~self.open, return_distances=False, return_indices=True)
        row, column = np.asarray(to)
        return self.index[(row * self.shape[1] + column).ravel()]

    def to_place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return column and row (M, 2) of map-frame points (M, 2), whole at cell centres."""
        return points @ self._to_cell[:, :2].T + self._to_cell[:, 2]

    def locate(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the flat cells of map-frame points (M,), nearest in the map, and which are inside (M,)."""
        # half cells belong to the smaller one, so that rounding is the same for all of them
        place = np.ceil(self.to_place(points) - 0.5 - 1e-9).astype(np.int64)
        limit = np.array([self.shape[1] - 1, self.shape[0] - 1])
        nearest = np.maximum(np.minimum(place, limit), 0)
        column, row = nearest.T
        return row * self.shape[1] + column, np.asarray((place == nearest).all(axis=1))

    def settle(
        self, points: NDArray[np.float64], snap: float, what: str, origin: ArrayLike = 0.0
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the open cells (M,) of map-frame points (M, 2), and the points.

        Those that are not in an open cell are moved to the centre of the nearest one, by ``snap`` at most.
        So are those in a part of a coarse one that keeps less than half of the clearance.

        Raises:
            UserError: A point would have to be moved farther; ``what`` says what it is. Places in the message
                are in the caller's frame, in which the map's own has this ``origin`` (2,).
        """
        if not len(self):
            raise UserError(
                f"map {self.grid.name!r} has no cell with clearance {self.clearance} m: no way through it"
            )
        flat, inside = self.locate(points)
        cell = self.index[flat]
        astray = ~inside | (cell < 0) | self._at_wall(points)
        if not astray.any():
            return cell, points
        cell = self.nearest[flat]
        moved = np.where(astray[:, None], self.xy[cell], points)
        far = np.linalg.norm(moved - points, axis=1) > snap
        if far.any():
            i = int(far.argmax())
            where = "is in a wall or too near to one" if inside[i] else "is outside the map"
            given, free = (format_point(place[i] + origin) for place in (points, moved))
            raise UserError(
                f"{what} {given} {where} on map {self.grid.name!r}: the nearest point with "
                f"clearance {self.clearance} m is {free}, more than {snap} m away"
            )
        return cell, moved

    def _at_wall(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which map-frame points (M,) keep less than half of the clearance, be their cells open."""
        if self.grid.resolution < self.clearance / 2**0.5:
            return np.zeros(len(points), dtype=bool)  # centres keep all of it, and are too near
        place = self.to_place(points)[:, ::-1].T
        return np.asarray(map_coordinates(self.distance, place, order=1, mode="nearest") < self.clearance / 2)

    def moved(
        self,
        what: str,
        asked: NDArray[np.float64],
        place: NDArray[np.float64],
        origin: NDArray[np.float64] | float = 0.0,
    ) -> str | None:
        """Return the warning about a point (2,) that `settle` moved to a place (2,); None if it did not."""
        if (away := float(np.hypot(*(asked - place)))) < _SAME:
            return None
        given, free = format_point(asked + origin), format_point(place + origin)
        return (
            f"{what} {given} is less than {self.clearance} m from a wall of map {self.grid.name!r}, or "
            f"outside it: moved by {away:.2f} m to {free}"
        )


def _without_pockets(cells: NDArray[np.bool_], resolution: float) -> NDArray[np.bool_]:
    """Leave out parts of less than `POCKET` square metres, unless nothing is larger.

    Scanned maps have many, between pieces of furniture. No path leads out of them, and the planner must not
    send a person who is pushed near one into it.
    """
    # connected through their sides, as the graph is; part 0 is everything else
    parts = np.asarray(cast("Any", label(cells))[0])
    area = np.bincount(parts.ravel())[1:] * resolution**2
    large = np.concatenate(([False], area >= min(POCKET, area.max(initial=0))))
    return np.take(large, parts)


def format_point(point: NDArray[np.float64]) -> str:
    """Return a position as messages show it."""
    return f"({point[0]:.2f}, {point[1]:.2f})"


def as_points(points: ArrayLike | Tensor) -> NDArray[np.float64]:
    """Return positions (N, 2), metres.

    Raises:
        UserError: One is not finite.
    """
    given = points.detach().cpu().numpy() if isinstance(points, Tensor) else points
    result = np.array(given, dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(result).all():
        raise UserError(
            f"goals must be finite positions in metres, got {result[~np.isfinite(result).all(1)][0]}"
        )
    return result
