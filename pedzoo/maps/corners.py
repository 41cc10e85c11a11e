"""Shortest ways through a floor plan by way of the corners of its open cells."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from pedzoo.maps.graph import OpenGraph

_AT_ONCE = 250_000
"""Lines of sight that are followed together: bounds the memory that building takes."""


_ALL_PAIRS = 500
"""Corners up to which the ways between all of them are kept: 3 MB, and queries need no search."""


class CornerGraph:
    """The K corners of the open cells, joined where they see one another: a visibility graph.

    A shortest way between two points bends only at corners of what is in the way, so that searching these
    few cells finds any-angle ways that are never longer than the best 8-connected one, without the search
    over all open cells. Edges that no shortest way takes (it would not bend around the corner at their end)
    are left out (taut edges: Oh and Leong, SoCS 2017).

    Attributes:
        graph: The open cells.
        cells: Numbers of the corners among them (K,): the cell diagonally beside them is not open, the two
            between are.
    """

    def __init__(self, graph: OpenGraph) -> None:
        """Find the corners; their lines of sight are followed at the first search."""
        self.graph = graph
        around = np.pad(graph.open, 1, constant_values=True)
        height, width = graph.shape

        def shifted(down: int, right: int) -> NDArray[np.bool_]:
            return around[1 + down : 1 + down + height, 1 + right : 1 + right + width]

        rising, falling = (
            graph.open
            & np.logical_or.reduce(
                [~shifted(a, b) & shifted(a, 0) & shifted(0, b) for a, b in ((1, slope), (-1, -slope))]
            )
            for slope in (1, -1)
        )
        self.cells = graph.index[np.flatnonzero(rising | falling)]
        at = graph.cells[self.cells]
        # what is in the way lies along the rising (or falling) diagonal: ways bend around it only if they
        # leave falling (or rising), or straight along an axis
        self._falls, self._rises = rising.ravel()[at], falling.ravel()[at]
        self._place = graph.place[self.cells]

    @cached_property
    def matrix(self) -> csr_array:
        """The graph (K, K): entry (i, j) is the metres from corner i to j."""
        found = [np.empty((2, 0), dtype=np.int64)]
        count = len(self.cells)
        rows = max(1, _AT_ONCE // max(count, 1))
        for first in range(0, count, rows):
            some = np.arange(first, min(first + rows, count))
            pairs = self._bends(self._place[some, None] - self._place) & (
                np.arange(count) > some[:, None]
            )  # every pair once
            one, other = np.nonzero(pairs & self._bends_at(some, self._place[some, None] - self._place))
            one = some[one]
            seen = self.graph.sight.clear(self._place[one], self._place[other])
            found.append(np.stack((one[seen], other[seen])))
        one, other = np.concatenate(found, axis=1)
        length = np.linalg.norm(self._place[one] - self._place[other], axis=1) * self.graph.grid.resolution
        both = np.concatenate((one, other)), np.concatenate((other, one))
        return coo_array((np.concatenate((length, length)), both), shape=(count, count)).tocsr()

    def _bends(self, way: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return whether shortest ways leave all K corners in the directions ``way`` (..., K, 2)."""
        slope = way[..., 0] * way[..., 1]
        return (self._falls & (slope <= 0)) | (self._rises & (slope >= 0))

    def _bends_at(self, some: NDArray[np.int64], way: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return the same of the corners ``some`` (S,) in the directions ``way`` (S, K, 2)."""
        slope = way[..., 0] * way[..., 1]
        return (self._falls[some, None] & (slope <= 0)) | (self._rises[some, None] & (slope >= 0))

    def way(
        self, start: int, goal: int, start_place: NDArray[np.float64], goal_place: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """Return the open cells (W,) that a shortest way bends at, in their order; empty for a straight one.

        Args:
            start: Number of the open cell where the way begins, in one component with ``goal``.
            goal: Where it ends.
            start_place: Column and row of the start itself (2,), whole at cell centres.
            goal_place: Of the goal itself (2,).
        """
        here, there = self.graph.place[start], self.graph.place[goal]
        leaving = np.flatnonzero(self._bends(self._place - here) & (self.cells != start))
        arriving = np.flatnonzero(self._bends(self._place - there) & (self.cells != goal))
        targets = np.concatenate((there[None], self._place[leaving], self._place[arriving]))
        origins = np.repeat(np.stack((here, there)), (1 + len(leaving), len(arriving)), axis=0)
        seen = self.graph.sight.clear(origins, targets)
        if seen[0]:
            return np.empty(0, dtype=np.int32)
        first = leaving[seen[1 : 1 + len(leaving)]]
        last = arriving[seen[1 + len(leaving) :]]
        begin = self._metres(first, start_place)
        end = self._metres(last, goal_place)
        if len(self.cells) <= _ALL_PAIRS:
            length, before = self._all_pairs
            total = length[first[:, None], last] + begin[:, None] + end
            one, other = divmod(int(total.argmin()), len(last))
            before, chain = before[first[one]], [int(last[other])]
        else:
            length, before = self._search(first, begin)
            chain = [int(last[(length[last] + end).argmin()])]
        while 0 <= (earlier := int(before[chain[-1]])) < len(self.cells):
            chain.append(earlier)
        return self.cells[chain[::-1]]

    @cached_property
    def _all_pairs(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        length, before = dijkstra(self.matrix, return_predecessors=True)
        return length, before

    def _search(
        self, first: NDArray[np.int64], begin: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return lengths and predecessors from a start, the node K, that sees the corners ``first``."""
        edges, count = self.matrix, len(self.cells) + 1
        joined = csr_array(
            (
                np.concatenate((edges.data, begin)),
                np.concatenate((edges.indices, first.astype(edges.indices.dtype))),
                np.append(edges.indptr, edges.indptr[-1] + len(first)).astype(edges.indptr.dtype),
            ),
            shape=(count, count),
        )
        length, before = dijkstra(joined, indices=count - 1, return_predecessors=True)
        return length, before

    def _metres(self, some: NDArray[np.int64], place: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = (self._place[some] - place).T
        return np.hypot(x, y) * self.graph.grid.resolution
