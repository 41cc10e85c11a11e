"""The planner of "Interactive Pedestrian Simulation in iGibson" (section III.A): A* on the open cells."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from pedzoo.core.errors import unknown
from pedzoo.maps.planning.graph import OpenGraph
from pedzoo.maps.planning.planner import NO_PATH, STRAIGHT, Planner, Ways

_STEPS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0), (0, 1), (-1, 0), (0, -1)])
"""Columns and rows to the neighbours of a cell. Of equally short paths those are taken that go along the
first ones first: they bend least often."""


class CellGraph:
    """The N open cells of a floor plan, joined with their eight neighbours; edges are metres between centres.

    It answers as `CornerGraph` does, with every cell as a corner: paths may bend anywhere.

    Attributes:
        graph: The open cells.
        cells: Their numbers (N,).
        bends: Not looked at (2, N).
    """

    def __init__(self, graph: OpenGraph) -> None:
        """Take the open cells; they are joined at the first search."""
        self.graph, self.cells = graph, np.arange(len(graph), dtype=np.int32)
        self.bends = np.zeros((2, len(graph)), dtype=bool)

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Neighbours of every cell along `_STEPS` (8, N), -1 for none. Diagonals cut no corner."""
        height, width = self.graph.shape
        number = np.pad(self.graph.index.reshape(height, width), 1, constant_values=-1)
        column, row = self.graph.place.T + 1
        there = np.stack([number[row + up, column + right] for right, up in _STEPS])
        for at, (right, up) in enumerate(_STEPS[:4]):
            beside = np.minimum(number[row, column + right], number[row + up, column])
            there[at, beside < 0] = -1
        return there

    @cached_property
    def matrix(self) -> csr_array:
        """The graph (N, N): entry (i, j) is the metres from cell i to j."""
        step, cell = np.nonzero(self.neighbours >= 0)
        metres = np.hypot(*_STEPS[step].T) * self.graph.grid.resolution
        size = len(self.cells), len(self.cells)
        return coo_array((metres, (cell, self.neighbours[step, cell])), shape=size).tocsr()

    def search(self, cell: int, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return the metres from all cells (N,) to a goal, and where the path bends next (N,).

        One search from the goal finds what A* finds from each cell: the shortest path. Collinear steps are
        joined. The goal is in an open cell, at column and row ``place`` (2,): there the last segment ends.
        A cell from which it leads straight on has -1; where no path leads to the goal metres are infinite.
        """
        far = dijkstra(self.matrix, indices=cell)
        metres = np.hypot(*_STEPS.T) * self.graph.grid.resolution
        # rounding must not choose between paths that are equally long
        after = np.where(self.neighbours >= 0, far[self.neighbours], np.inf) + metres[:, None]
        with np.errstate(invalid="ignore"):
            step = (after - far < 1e-3 * self.graph.grid.resolution).argmax(0)
        onward = np.where(np.isfinite(far), self.neighbours[step, self.cells], self.cells)
        onward[cell] = cell
        last = _ends(np.where((step[onward] == step) & (onward != cell), onward, self.cells))
        bend = onward[last]
        final = _ends(np.where(bend == cell, self.cells, bend))
        rest = np.hypot(*(self.graph.place[final] - place).T) * self.graph.grid.resolution
        # to the goal itself, instead of to the centre of its cell
        far = far + rest - np.where(np.isfinite(far), far[final], 0.0)
        return far, np.where((bend == cell) | np.isinf(far), -1, bend).astype(np.int32)


class AStarPlanner(Planner):
    """Paths along the grid, as in the paper: up to 8.24 % longer than the shortest ones of `Planner`.

    Each goal costs a search of all cells, and each agent a look-up. Memory grows with goals times cells.
    """

    name = "astar"
    searched: ClassVar[type] = CellGraph

    def prepare(self) -> Ways:
        """See `Planner.prepare`: where paths bend first is known of all cells."""
        before, ways = self._ways, super().prepare()
        if ways is not before:
            first = np.where(ways.onward >= 0, ways.onward, np.where(np.isinf(ways.far), NO_PATH, STRAIGHT))
            _, _, opens, _, begin, _ = ways.begin[:, ways.goal[0]]
            goal = np.concatenate((ways.goal[:3], (ways.goal[2] + begin - opens)[None]))
            ways = self._ways = ways._replace(first=first.astype(np.int32), goal=goal)
        return ways

    def _first(self, cells: NDArray[np.int64], goals: NDArray[np.int64]) -> NDArray[np.int64]:
        ways = self.prepare()
        return ways.first[ways.goal[3, goals + 1] + cells].astype(np.int64)


PLANNERS = {one.name: one for one in (Planner, AStarPlanner)}
"""Planners by name."""


def planner_class(name: str) -> type[Planner]:
    """Return a planner by name. Raises UserError: there is no such one."""
    if name not in PLANNERS:
        raise unknown("planner", name, PLANNERS)
    return PLANNERS[name]


def _ends(onward: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where chains of cells end (N,) that go from each to the next one (N,), or stay."""
    while ((further := onward[onward]) != onward).any():
        onward = further
    return onward
