"""Shortest paths through a floor plan by way of the corners of its open cells."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from pedzoo.maps.planning.graph import OpenGraph

_AT_ONCE = 250_000
"""Lines of sight that are followed together: bounds the memory that building takes."""


_SMALL = 1_000_000
"""Open cells times corners up to which everything that a query asks for is computed once: some megabytes."""


class CornerGraph:
    """The K corners of the open cells, joined where they see one another: a visibility graph.

    A shortest path between two points bends only at corners of obstacles. So a search of these few cells
    finds any-angle paths that are never longer than the best 8-connected one. Edges that no shortest path
    takes (it would not bend around the corner at their end) are left out (taut edges: Oh and Leong, SoCS
    2017).

    Attributes:
        graph: The open cells.
        cells: Numbers of the corners among them (K,): the cell diagonally beside a corner is not open, the
            two between are.
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
        # obstacles lie along the rising (or falling) diagonal: paths bend around them only if they
        # leave falling (or rising), or straight along an axis
        self._falls, self._rises = rising.ravel()[at], falling.ravel()[at]
        self._place = graph.place[self.cells]
        self._x, self._y = self._place.T.astype(np.float64)

    @cached_property
    def matrix(self) -> csr_array:
        """The graph (K, K): entry (i, j) is the metres from corner i to j."""
        one, other = self._seen_from(self.cells, only_edges=True)
        length = np.linalg.norm(self._place[one] - self._place[other], axis=1) * self.graph.grid.resolution
        both = np.concatenate((one, other)), np.concatenate((other, one))
        count = len(self.cells)
        return coo_array((np.concatenate((length, length)), both), shape=(count, count)).tocsr()

    def _seen_from(self, cells: NDArray[np.int32], only_edges: bool = False) -> NDArray[np.int64]:
        """Return which of the open cells ``cells`` (S,) sees which corner that a path may bend around (2, E).

        With ``only_edges`` the cells are the corners; pairs are those that paths bend around at both ends,
        each in one order.
        """
        chunks = [np.empty((2, 0), dtype=np.int64)]
        place, count = self.graph.place[cells], len(self.cells)
        rows = max(1, _AT_ONCE // max(count, 1))
        for first in range(0, len(cells), rows):
            some = np.arange(first, min(first + rows, len(cells)))
            slope = np.prod(place[some, None] - self._place, axis=2)
            pairs = (self._falls & (slope <= 0)) | (self._rises & (slope >= 0))
            if only_edges:
                pairs &= (self._falls[some, None] & (slope <= 0)) | (self._rises[some, None] & (slope >= 0))
                pairs &= np.arange(count) > some[:, None]
            else:
                pairs &= cells[some, None] != self.cells
            one, other = np.nonzero(pairs)
            one = some[one]
            seen = self.graph.sight.clear(place[one], self._place[other])
            chunks.append(np.stack((one[seen], other[seen])))
        return np.concatenate(chunks, axis=1)

    def way(
        self, start: int, goal: int, start_place: NDArray[np.float64], goal_place: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """Return the open cells (W,) that a shortest path bends at, in their order; empty for a straight one.

        Start and goal are numbers of open cells of one component; their places (2,) are columns and rows.
        """
        ends = self.graph.place[[start, goal]]
        if self.graph.sight.clear(ends[:1], ends[1:])[0]:
            return np.empty(0, dtype=np.int32)
        first, last = self._views(start, goal)
        begin = self.metres(first, start_place)
        end = self.metres(last, goal_place)
        if self._small:
            length, before = self._all_pairs
            total = length[first[:, None], last] + begin[:, None] + end
            one, other = divmod(int(total.argmin()), len(last))
            before, chain = before[first[one]], [int(last[other])]
        else:
            length, before = self.search(first, begin)
            chain = [int(last[(length[last] + end).argmin()])]
        while 0 <= (earlier := int(before[chain[-1]])) < len(self.cells):
            chain.append(earlier)
        return self.cells[chain[::-1]]

    def prepare(self) -> None:
        """Compute the values kept for all queries; the first query does so, too."""
        if self._small:
            _ = self._all_views, self._all_pairs
        _ = self.matrix

    @property
    def _small(self) -> bool:
        return len(self.graph) * len(self.cells) <= _SMALL

    def _views(self, start: int, goal: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the corners that the two ends of a path see."""
        if self._small:
            begin, corners = self._all_views
            return corners[begin[start] : begin[start + 1]], corners[begin[goal] : begin[goal + 1]]
        one, other = self._seen_from(np.array([start, goal], dtype=np.int32))
        return other[one == 0], other[one == 1]

    @cached_property
    def _all_views(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where each open cell's corners begin (N + 1,), and the corners in sight of all cells."""
        one, other = self._seen_from(np.arange(len(self.graph), dtype=np.int32))
        return np.searchsorted(one, np.arange(len(self.graph) + 1)), other

    @cached_property
    def _all_pairs(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        length, before = dijkstra(self.matrix, return_predecessors=True)
        return length, before

    def search(
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

    def seen_by(self, cell: int) -> NDArray[np.int64]:
        """Return the corners in sight of an open cell that a path may bend around."""
        return self._seen_from(np.array([cell], dtype=np.int32))[1]

    def metres(self, some: NDArray[np.int64] | slice, place: NDArray[Any]) -> NDArray[np.float64]:
        """Return how far corners (S,) are from columns and rows (..., 2): (S,), or (P, S) for (P, 1, 2)."""
        x, y = self._x[some] - place[..., 0], self._y[some] - place[..., 1]
        return np.sqrt(x * x + y * y) * self.graph.grid.resolution
