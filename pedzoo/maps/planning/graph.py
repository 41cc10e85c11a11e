"""The open cells of a floor plan: lines of sight between them, their corners, and shortest paths."""

import contextlib
import hashlib
import io
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt, label, map_coordinates
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.paths import cache_home, write_atomically
from pedzoo.maps.grid import OccupancyGrid, Unknown

_AT_ONCE = 250_000
"""Lines of sight that are followed together: bounds the memory that it takes."""

_KEPT, _FORM = 1000, 1
"""Corners from which on lines of sight between them are kept on disk, and the version of such files."""

HOP = 1e-9
"""Metres that each bend adds: rounding must not choose between paths that are equally long."""

_SAME = 0.05
"""Metres: who is moved by less is not moved."""

POCKET = 0.5
"""Square metres: smaller parts of the open cells are left out, unless nothing is larger.

Scanned maps have many, between pieces of furniture. No path leads out of them, and the planner must not
send a person who is pushed near one into it.
"""


class Sight:
    """Which open cells see one another.

    They do if the line between their centres stays where walkers may be: in squares between four open cells,
    or on edges between two. Each step to a neighbour is such a line, so that the shortest lines of sight
    between two cells bend only at corners of the open cells; and as distances to walls are read bilinearly
    between centres, every point of a line keeps the clearance that the open cells have.

    Attributes:
        leap: How far free squares reach from every square, int16, 0 where it is not free: the side of the
            largest block of them that begins there. First of blocks towards growing columns and rows, then
            towards growing columns and falling rows, then of blocks of open cells as the first. A line that
            enters a block leaves it one column before its end at the earliest.
    """

    def __init__(self, is_open: NDArray[np.bool_]) -> None:
        """Take which cells are open (H, W)."""
        square = np.zeros_like(is_open)
        square[:-1, :-1] = is_open[:-1, :-1] & is_open[1:, :-1] & is_open[:-1, 1:] & is_open[1:, 1:]
        tables = _largest_squares(square), _largest_squares(square[::-1])[::-1], _largest_squares(is_open)
        self._width = is_open.shape[1]
        self._cells = is_open.size
        self.leap = np.concatenate([table.ravel() for table in tables])

    def clear(self, origin: NDArray[np.int32], target: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which lines (M,) are clear, from and to columns and rows of open cells (M, 2)."""
        from pedzoo.maps.planning.planner_numba import clear_lines

        seen = np.empty(len(origin), dtype=bool)
        ends = (np.ascontiguousarray(end, dtype=np.int32) for end in (origin, target))
        clear_lines(self.leap, self._width, self._cells, *ends, seen)
        return seen


def _largest_squares(free: NDArray[np.bool_]) -> NDArray[np.int16]:
    """Return the side of the largest free square that begins at each place (H, W), towards larger indices."""
    height, width = free.shape
    sides = np.zeros((height + 1, width + 1), dtype=np.int16)
    place = np.arange(width + 1)
    for row in reversed(range(height)):
        # one more than the least of the three neighbours; along the row all at once
        least = np.zeros(width + 1, dtype=np.int64)
        least[:-1] = (1 + np.minimum(sides[row + 1, :-1], sides[row + 1, 1:])) * free[row]
        sides[row] = np.minimum.accumulate((least + place)[::-1])[::-1] - place
    return sides[:-1, :-1]


class OpenGraph:
    """The N cells of a floor plan that are open to walkers: their centres keep a clearance from walls.

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
        component: Which open cells have paths to one another (N,): equal numbers.
        sight: Lines of sight between open cells.
    """

    def __init__(self, grid: OccupancyGrid, unknown: Unknown, clearance: float) -> None:
        """Find the open cells; a floor plan may have none."""
        self.grid = grid
        self.clearance = clearance
        self.distance = grid.signed_distance(unknown)
        self.shape = self.distance.shape
        # connected through their sides, as a diagonal step must not cut a corner; part 0 is everything else
        parts = np.asarray(cast("Any", label(self.distance >= clearance - 1e-6))[0])
        area = np.bincount(parts.ravel())[1:] * grid.resolution**2
        self.open = np.append(False, area >= min(POCKET, area.max(initial=0)))[parts]
        self.cells = np.flatnonzero(self.open)
        self.component = parts.ravel()[self.cells] - 1
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


class CornerGraph:
    """The K corners of the open cells, joined where they see one another: a visibility graph.

    A shortest path between two points bends only at corners of obstacles. So a search of these few cells
    finds any-angle paths that are never longer than the best 8-connected one. Edges that no shortest path
    takes (it would not bend around the corner at their end) are left out (taut edges: Oh and Leong, SoCS
    2017). Of equally long paths the one with fewer bends is taken.

    Attributes:
        graph: The open cells.
        cells: Numbers of the corners among them (K,): the cell diagonally beside a corner is not open, the
            two between are.
        place: Their columns and rows (K, 2) int32.
        bends: Whether paths may bend around them as they fall, and as they rise (2, K).
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
        # obstacles lie along the rising (or falling) diagonal: paths bend around them only if they
        # leave falling (or rising), or straight along an axis
        self.bends = np.stack((rising.ravel(), falling.ravel()))[:, graph.cells[self.cells]]
        self.place = graph.place[self.cells]

    @cached_property
    def matrix(self) -> csr_array:
        """The graph (K, K): entry (i, j) is the metres from corner i to j, and `HOP`."""
        one, other = self._edges()
        length = np.linalg.norm(self.place[one] - self.place[other], axis=1) * self.graph.grid.resolution
        both = np.concatenate((one, other)), np.concatenate((other, one))
        count = len(self.cells)
        return coo_array((np.tile(length + HOP, 2), both), shape=(count, count)).tocsr()

    def _edges(self) -> NDArray[np.int64]:
        """Return the pairs of corners (2, E) that see each other; many are kept in the user's cache."""
        count = len(self.cells)
        if count < _KEPT:
            return self.seen_from(self.cells, only_edges=True)
        content = repr((_FORM, self.graph.shape)).encode() + np.packbits(self.graph.open).tobytes()
        file = cache_home() / "planner" / f"{hashlib.sha256(content).hexdigest()[:32]}.npy"
        with contextlib.suppress(OSError, ValueError, EOFError):
            edges = np.load(file, allow_pickle=False)
            if edges.dtype == np.int64 and edges.shape[:-1] == (2,) and (edges // count == 0).all():
                return edges
        edges, encoded = self.seen_from(self.cells, only_edges=True), io.BytesIO()
        np.save(encoded, edges, allow_pickle=False)
        with contextlib.suppress(UserError):  # a folder that cannot be written, or a full disk
            write_atomically(file, encoded.getvalue())
        return edges

    def _turns(self, place: NDArray[np.int32], bends: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which lines (S, K) from columns and rows (S, 2) to the corners fall or rise as ``bends``."""
        slope = np.prod(place[:, None] - self.place, axis=2)
        return (bends[0] & (slope <= 0)) | (bends[1] & (slope >= 0))

    def seen_from(self, cells: NDArray[np.int32], only_edges: bool = False) -> NDArray[np.int64]:
        """Return which open cell (S,) sees which corner that a path may bend around (2, E).

        With ``only_edges`` the cells are the corners; pairs are those that paths bend around at both ends,
        each in one order.
        """
        chunks = [np.empty((2, 0), dtype=np.int64)]
        rows = max(1, _AT_ONCE // max(len(self.cells), 1))
        for first in range(0, len(cells), rows):
            some = cells[first : first + rows]
            place = self.graph.place[some]
            pairs = self._turns(place, self.bends)
            if only_edges:
                pairs &= self._turns(place, self.bends[:, first : first + rows, None])
                pairs = np.triu(pairs, first + 1)
            one, other = np.nonzero(pairs & (some[:, None] != self.cells))
            seen = self.graph.sight.clear(place[one], self.place[other])
            chunks.append(np.stack((one[seen] + first, other[seen])))
        return np.concatenate(chunks, axis=1)

    def search(self, cell: int, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return the metres from all corners (K,) to a goal, and the next corner on the way there (K,).

        The goal is in an open cell, at column and row ``place`` (2,). The next corner is -1 for the goal
        itself; where no path leads to it the metres are infinite.
        """
        seen, edges, count = self.seen_from(np.array([cell], dtype=np.int32))[1], self.matrix, len(self.cells)
        there = np.hypot(*(self.place[seen] - place).T) * self.graph.grid.resolution
        joined = csr_array(
            (
                np.concatenate((edges.data, there + HOP)),
                np.concatenate((edges.indices, seen.astype(edges.indices.dtype))),
                np.append(edges.indptr, edges.indptr[-1] + len(seen)).astype(edges.indptr.dtype),
            ),
            shape=(count + 1, count + 1),
        )
        far, before = dijkstra(joined, indices=count, return_predecessors=True)
        return far[:-1], np.where(before == count, -1, before)[:-1].astype(np.int32)


_STEPS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0), (0, 1), (-1, 0), (0, -1)])
"""Columns and rows to the neighbours of a cell. Of equally short paths those are taken that go along the
first ones first: they bend least often."""


class CellGraph:
    """The N open cells of a floor plan, joined with their eight neighbours; edges are metres between centres.

    A* on them is the planner of "Interactive Pedestrian Simulation in iGibson" (section III.A). It answers
    as `CornerGraph` does, with every cell as a corner: paths may bend anywhere.

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


def _ends(onward: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where chains of cells end (N,) that go from each to the next one (N,), or stay."""
    while ((further := onward[onward]) != onward).any():
        onward = further
    return onward


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
