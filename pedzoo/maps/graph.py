"""The open cells of a floor plan as a graph, and shortest ways on it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.sight import Sight

STEPS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""The eight neighbours of a cell: rows and columns away."""


class OpenGraph:
    """The N cells of a floor plan that are open to walkers: their centres keep a clearance from walls.

    Neighbours, diagonal ones too, are joined by edges of their distance in metres, as in iGibson; but a
    diagonal step must not cut a corner: both cells beside it must be open.

    Attributes:
        grid: The floor plan.
        cells: Flat index (row * W + column) of every open cell (N,), growing.
        place: Column and row of every open cell (N, 2) float32.
        xy: Their centres in the map's frame (N, 2) float64, metres.
        index: Number of the open cell at every cell (H * W,) int32, -1 where it is not open.
        sight: Lines of sight at the clearance.
    """

    def __init__(self, grid: OccupancyGrid, unknown: Unknown, clearance: float) -> None:
        """Find the open cells; a floor plan may have none."""
        distance = grid.signed_distance(unknown)
        self.grid = grid
        self.shape = distance.shape
        self._open = distance >= clearance - 1e-6
        self.cells = np.flatnonzero(self._open)
        self.index = np.full(distance.size, -1, dtype=np.int32)
        self.index[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        row, column = np.divmod(self.cells, self.shape[1])
        self.place = np.stack((column, row), axis=1).astype(np.float32)
        to_cell = grid.map_to_cell()
        self.xy = (self.place - to_cell[:, 2]) @ np.linalg.inv(to_cell[:, :2]).T
        self.sight = Sight(distance, grid.resolution, clearance)

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Numbers of the neighbours (N, 8) in the order of `STEPS`; N where no step leads."""
        padded = np.pad(self._open, 1)
        number = np.full(padded.shape, len(self), dtype=np.int32)
        number[1:-1, 1:-1][self._open] = np.arange(len(self), dtype=np.int32)
        width = padded.shape[1]
        here = np.flatnonzero(padded)
        flat, numbers = padded.ravel(), number.ravel()
        found = np.empty((len(self), len(STEPS)), dtype=np.int32)
        for k, (down, right) in enumerate(STEPS):
            beside = flat[here + down * width] & flat[here + right]
            found[:, k] = np.where(
                beside | (down * right == 0), numbers[here + down * width + right], len(self)
            )
        return found

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
        """Which open cells have ways to one another (N,): equal numbers."""
        return np.asarray(connected_components(self.matrix, directed=False)[1])

    @cached_property
    def nearest(self) -> NDArray[np.int32]:
        """Number of the open cell nearest to every cell (H * W,); 0 on a floor plan without any."""
        if not len(self):
            return np.zeros(self.index.shape, dtype=np.int32)
        to = distance_transform_edt(~self._open, return_distances=False, return_indices=True)
        row, column = np.asarray(to)
        return self.index[(row * self.shape[1] + column).ravel()]

    def locate(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the flat cells of map-frame points (M,), nearest inside the map, and who is inside (M,)."""
        to_cell = self.grid.map_to_cell()
        # half cells belong to the smaller one, so that rounding is the same for all of them
        place = np.ceil(points @ to_cell[:, :2].T + to_cell[:, 2] - 0.5 - 1e-9).astype(np.int64)
        limit = np.array([self.shape[1], self.shape[0]]) - 1
        inside = np.all((place >= 0) & (place <= limit), axis=1)
        column, row = np.clip(place, 0, limit).T
        return row * self.shape[1] + column, np.asarray(inside)

    def way(self, start: int, goal: int) -> NDArray[np.int64]:
        """Return the open cells of a shortest way, both ends included; empty where there is none."""
        if self.component[start] != self.component[goal]:
            return np.empty(0, dtype=np.int64)
        straight = float(np.hypot(*(self.xy[start] - self.xy[goal])))
        limit = 1.1 * straight + self.grid.resolution
        while True:
            found = dijkstra(self.matrix, indices=goal, limit=limit, return_predecessors=True)
            length, towards = found[0], found[1]
            if np.isfinite(length[start]):
                break
            limit *= 1.7
        chain = [start]
        while chain[-1] != goal:
            chain.append(int(towards[chain[-1]]))
        return np.array(chain)

    def pull(self, chain: NDArray[np.int64]) -> list[int]:
        """Return the coarse waypoints of a way: each the farthest one in sight, seen from the goal's side.

        A cell keeps its successor's waypoint while it sees it, else its waypoint is the successor: the rule
        of the fields, on one way.
        """
        place = torch.from_numpy(self.place[chain])
        last = len(chain) - 1
        waypoints = [int(chain[last])]
        anchor, reach = last, 16
        while anchor > 0:
            low = max(anchor - reach, 0)
            seen = self.sight.clear(place[low:anchor], place[anchor].expand(anchor - low, 2))
            blocked = torch.nonzero(~seen)
            if not len(blocked):
                if low == 0:
                    break
                reach *= 2
                continue
            anchor = low + int(blocked[-1]) + 1
            waypoints.append(int(chain[anchor]))
            reach = 16
        return waypoints[::-1]
