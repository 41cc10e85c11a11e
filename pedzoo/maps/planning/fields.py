"""Fields of next waypoints: for every open cell of a floor plan the path to a goal, one look-up away."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from pedzoo.maps.planning.graph import STEPS, OpenGraph

_AT_ONCE = 8_000_000
"""Cells of the floor plans of all fields that are built together: bounds the memory that building takes."""

_STEP_LENGTHS = np.array([[np.hypot(*step)] for step in STEPS], dtype=np.float32)
"""Cells (8, 1)."""

_TRIES = 3
"""Different waypoints that a cell looks for before it goes by way of a neighbour."""


@dataclass(frozen=True)
class Fields:
    """Ways from all N open cells of a floor plan to G goals.

    Attributes:
        waypoint: Number of the open cell that is the next waypoint (G, N) int32: the farthest one of the path
            in sight; N is the goal itself. Where no path leads to the goal it is the cell's own number.
        length: Metres of the path from the cell's centre to the goal (G, N) float32; ``inf`` for none.
    """

    waypoint: Tensor
    length: Tensor


def build_fields(graph: OpenGraph, cells: NDArray[np.int64], points: NDArray[np.float64]) -> Fields:
    """Return the fields of goals in the open cells ``cells`` (G,) at columns and rows ``points`` (G, 2).

    Dijkstra's distances on the graph give an order in which cells come after their path to the goal. In this
    order every cell takes the best of its neighbours' waypoints that is in sight, as in Theta* (Nash et al.,
    AAAI 2007), and goes by way of the best neighbour if none is. All goals are swept together, so a step of
    the sweep is as wide as all their wave fronts.
    """
    per = max(1, _AT_ONCE // graph.open.size)
    parts = [_sweep(graph, cells[i : i + per], points[i : i + per]) for i in range(0, len(cells), per)]
    return Fields(torch.cat([part.waypoint for part in parts]), torch.cat([part.length for part in parts]))


def _sweep(graph: OpenGraph, cells: NDArray[np.int64], points: NDArray[np.float64]) -> Fields:
    from tqdm import tqdm

    reach = dijkstra(graph.matrix, indices=cells).ravel()
    order, ends = _bands(reach / graph.grid.resolution)
    front = _Front(graph, cells, points)
    bands, what = pairwise(ends.tolist()), f"ways on {graph.grid.name}"
    for first, last in tqdm(bands, what, len(ends) - 1, delay=2.0, leave=False, disable=None):
        front.advance(*np.divmod(order[first:last], len(graph)))
    return front.fields()


class _Front:
    """Waypoints and lengths of all cells that the sweep has come to.

    Cells are counted over the floor plan with a border one cell wide around it, so that neighbours are always
    equally far apart: a wave front is spread over memory, and what is read beside it is what takes time.

    Attributes:
        waypoint: Cell of every goal's and cell's waypoint (G, P) int32, flat: 0, a cell of the border, is the
            goal itself; -1 where the sweep has not been.
        length: Cells of path (G, P) float32, flat.
    """

    def __init__(self, graph: OpenGraph, cells: NDArray[np.int64], points: NDArray[np.float64]) -> None:
        height, width = graph.shape
        self.graph, self.points = graph, points.astype(np.float32)
        self.size = (height + 2) * (width + 2)
        self.at = (graph.place[:, 1] + 1).astype(np.int64) * (width + 2) + graph.place[:, 0] + 1
        self.own = self.at[cells]
        self.steps = np.array([down * (width + 2) + right for down, right in STEPS])[:, None]
        self.place = np.zeros((self.size, 2), dtype=np.int32)
        self.place[self.at] = graph.place
        self.number = np.full(self.size, -1, dtype=np.int32)
        self.number[self.at] = np.arange(len(graph), dtype=np.int32)
        self.waypoint = np.full(len(cells) * self.size, -1, dtype=np.int32)
        self.length = np.full(len(cells) * self.size, np.inf, dtype=np.float32)
        begin = np.arange(len(cells)) * self.size + self.own
        self.waypoint[begin] = 0
        self.length[begin] = _norm(*(graph.place[cells] - self.points).T)
        # which of STEPS each cell can take, one bit each
        self.legal = np.packbits(graph.neighbours < len(graph), axis=1, bitorder="little")[:, 0]
        # a wedge between two lines of sight is free only if obstacles are thicker than a cell
        self.thick = graph.clearance >= 2 * graph.grid.resolution

    def fields(self) -> Fields:
        """Return the results, by numbers of open cells."""
        goals, count = len(self.own), len(self.graph)
        waypoint = self.waypoint.reshape(goals, self.size)[:, self.at]
        numbers = np.where(waypoint == 0, np.int32(count), self.number[waypoint])
        numbers = np.where(waypoint < 0, np.arange(count, dtype=np.int32), numbers)
        length = self.length.reshape(goals, self.size)[:, self.at] * np.float32(self.graph.grid.resolution)
        return Fields(torch.from_numpy(numbers), torch.from_numpy(length))

    def advance(self, goal: NDArray[np.int64], number: NDArray[np.int64]) -> None:
        """Find the waypoints of open cells (M,), after those of all cells that their paths lead through."""
        cell = self.at[number]
        base = goal * self.size
        here = base + cell
        offered = self.waypoint.take(here + self.steps)  # (8, M)
        # Most cells have neighbours that all go to the same waypoint, which they see for certain.
        best = offered.max(axis=0)
        candidate = best.astype(np.int64)
        final = candidate == 0
        way = self._places(np.where(final, self.own[goal], candidate)) - self._places(cell)
        sure = self.thick & (offered.view(np.uint32).min(axis=0) == best)
        sure &= _surely(offered, best, way.T, self.legal.take(number))
        x, y = np.where(final, (self.points[goal] - self._places(cell)).T, way.T.astype(np.float32))
        self.waypoint[here] = best
        self.length[here] = _norm(x, y) + np.where(final, np.float32(0), self.length.take(base + candidate))
        rest = np.flatnonzero(~sure)
        if len(rest):
            self._choose(goal[rest], number[rest], offered[:, rest])

    def _places(self, cell: NDArray[np.signedinteger]) -> NDArray[np.int32]:
        """Return columns and rows (M, 2) of cells (M,): both are read as one number."""
        return self.place.view(np.int64).ravel().take(cell).view(np.int32).reshape(-1, 2)

    def _choose(self, goal: NDArray[np.int64], number: NDArray[np.int64], offered: NDArray[np.int32]) -> None:
        """Find the waypoints of open cells (M,) whose neighbours (8, M) offer different or unseen ones."""
        cell, base = self.at[number], goal * self.size
        here, beside = self.graph.place[number], cell + self.steps
        missing = (self.graph.neighbours[number] == len(self.graph)).T | (offered < 0)
        offered = np.where(missing, -1, offered)
        # where the waypoints are: the goal is a point, not its cell's centre
        places = self._places(offered.ravel()).reshape(*offered.shape, 2)
        final = offered == 0
        x, y = np.where(final[..., None], self.points[goal], places).transpose(2, 0, 1) - here.T[:, None]
        onward = np.where(final, np.float32(0), self.length.take(base + offered))
        total = np.where(
            missing, np.float32(np.inf), _norm(x.astype(np.float32), y.astype(np.float32)) + onward
        )
        via = np.where(missing, np.float32(np.inf), self.length.take(base + beside) + _STEP_LENGTHS)

        every_cell = np.arange(len(cell))
        shortest = via.argmin(axis=0)
        shortest_length, chosen = via[shortest, every_cell], beside[shortest, every_cell]
        remaining = every_cell
        for _ in range(_TRIES):
            best = total.argmin(axis=0)
            least = total[best, np.arange(len(remaining))]
            worth = np.flatnonzero(least <= shortest_length[remaining])
            remaining, total, offered, least = (
                remaining[worth],
                total[:, worth],
                offered[:, worth],
                least[worth],
            )
            candidate = offered[best[worth], np.arange(len(remaining))]
            # a goal is looked for at its cell's centre: only there is the clearance certain
            spot = self._places(np.where(candidate == 0, self.own[goal[remaining]], candidate))
            seen = _surely(offered, candidate, (spot - here[remaining]).T, self.legal[number[remaining]])
            asked = np.flatnonzero(~seen) if self.thick else np.arange(len(remaining))
            seen[asked] = self.graph.sight.clear(here[remaining[asked]], spot[asked])
            chosen[remaining[seen]] = candidate[seen]
            shortest_length[remaining[seen]] = least[seen]
            missed = np.flatnonzero(~seen)
            if not len(missed):
                break
            remaining, offered = remaining[missed], offered[:, missed]
            total = np.where(offered == candidate[missed], np.float32(np.inf), total[:, missed])
        self.waypoint[base + cell] = chosen
        self.length[base + cell] = shortest_length


def _norm(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.sqrt(x * x + y * y)


def _surely(
    offered: NDArray[np.int32],
    candidate: NDArray[np.int32],
    way: NDArray[np.int32],
    legal: NDArray[np.uint8],
) -> NDArray[np.bool_]:
    """Return which cells certainly see their candidates (M,), without following the line.

    The line leaves a cell between two neighbours, one straight and one diagonal. If both see the candidate,
    the cell sees it between them: nothing that keeps two cells' clearance around it fits into the wedge.
    ``offered`` (8, M) are the waypoints of neighbours, -1 for missing ones.
    """
    right, up = np.sign(way)
    level = np.abs(way[0]) >= np.abs(way[1])
    # the order of STEPS, which leaves out the cell itself in the middle
    diagonal, straight = (up + 1) * 3 + right + 1, np.where(level, right + 4, up * 3 + 4)
    diagonal, straight = diagonal - (diagonal > 4), straight - (straight > 4)
    every_cell = np.arange(len(candidate))
    both = (offered[diagonal, every_cell] == candidate) & (offered[straight, every_cell] == candidate)
    return both & ((legal >> diagonal.astype(np.uint8)) & 1).astype(bool)


def _bands(reach: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return reachable entries by growing distance in cells, and where each band of one cell's width ends.

    A step is at least one cell long: what a cell's path leads through is always in an earlier band. The
    goals' own cells, at distance 0, are not in the order.
    """
    band = np.where(np.isfinite(reach), reach, -1.0).round(6).astype(np.int32)
    entries = np.flatnonzero(reach < np.inf)
    entries = entries[reach[entries] > 0]
    bands = band[entries]
    if bands.max(initial=0) < 2**16:
        bands = bands.astype(np.uint16)  # which numpy sorts several times as fast
    order = entries[np.argsort(bands, kind="stable")]
    ends = np.concatenate(([0], np.bincount(bands, minlength=1).cumsum()))
    return order, np.unique(ends)
