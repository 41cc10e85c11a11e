"""The planner of goals that keep changing: a goal costs one search of corners, not a field of all cells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.planning.waypoint_table import WaypointTable

_GOALS = 64
"""Goals that there is room for at first."""

_TRIED = 4, 32
"""Corners whose sight is tried first: the best one in sight is nearly always among them."""

_BORDER = 1e-3
"""Cells: a person so near to the border of two cells may be looked up in both."""


class OnlinePlanner(Planner):
    """Paths on one floor plan, or on none, whose fields have only the cells that were asked for.

    A field of a new goal takes up to a second on a large plan. Here the corners get their distances to the
    goal (some milliseconds), and the cells under people the best of the corners that they see. These paths
    are shortest ones, those of fields at most a little longer.

    Poses are those of the floor plan: scenes are not turned against it.
    """

    def __init__(self, bank: MapBank, clearance: float = 0.25, origin: ArrayLike = 0.0) -> None:
        """Take the floor plan, and find its corners; ``origin`` is that of its frame in the caller's."""
        super().__init__(bank, clearance)
        self.origin = origin
        if bank.grids:
            _ = self.corners(0).matrix, bank.walls  # at the first step they would come too late
        self._clear()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Let the table of a copy see its own entries: copies of arrays and of their tensors are two."""
        self.__dict__.update(state)
        if self._table is not None and self._table is not self._empty:
            self._table = self._seeing_entries(self._table)

    def _seeing_entries(self, table: WaypointTable) -> WaypointTable:
        """Return the table with the entries that `_write` writes."""
        entries = torch.from_numpy(self._waypoint), torch.from_numpy(self._length)
        return replace(table, waypoint=entries[0], length=entries[1])

    def _clear(self) -> None:
        """Begin a table without goals: what is never asked for is a page of zeros that takes no memory."""
        self._ids, self._goals, self._from_corners = {}, [], []
        self._asked: set[tuple[int, int]] = set()
        self._last_cell: dict[int, int] = {}
        maps = [self.graph(0)] if self.bank.grids else []
        self._empty = WaypointTable.build(maps, self.clearance)
        self._table, self._with_fields = self._empty, 0
        self._reserve(_GOALS)

    def _reserve(self, goals: int) -> None:
        size = 1 + goals * self._entries
        waypoint, length = np.zeros(size, np.int32), np.zeros(size, np.float32)
        if self._with_fields:
            used = 1 + self._with_fields * self._entries
            waypoint[:used], length[:used] = self._waypoint[:used], self._length[:used]
        self._waypoint, self._length, self._room = waypoint, length, goals

    @property
    def _entries(self) -> int:
        """Entries of a field: the open cells, and the goal itself."""
        return (len(self.graph(0)) if self.bank.grids else 0) + 1

    def without_goals(self) -> OnlinePlanner:
        """Return a planner of the same floor plan without goals."""
        result = OnlinePlanner.__new__(OnlinePlanner)
        result.__dict__.update(self.__dict__)
        result._clear()
        return result

    def prepare(self) -> WaypointTable:
        """Return the table of all goals, with the paths from corners."""
        fresh = self._goals[self._with_fields :]
        if not fresh:
            return self._table or self._empty
        if len(self._goals) > self._room:
            self._reserve(2 * len(self._goals))
        for number, goal in enumerate(fresh, start=self._with_fields):
            end = (number + 1) * self._entries
            self._waypoint[end], self._length[end] = self._entries - 1, 0.0
            self._from_corners.append(self._add_corners(number) if goal.row >= 0 else np.empty(0))
        self._with_fields = len(self._goals)
        rows = [
            (1 + k * self._entries, self._entries - 1, goal.row + 1) for k, goal in enumerate(self._goals)
        ]
        places = torch.tensor([goal.point for goal in self._goals]).float().t()
        empty = self._empty
        with_goals = replace(
            empty,
            x=torch.cat((empty.x, places[0])),
            y=torch.cat((empty.y, places[1])),
            goal=torch.cat((empty.goal, torch.tensor(rows).t()), dim=1),
        )
        self._table = self._seeing_entries(with_goals)
        return self._table

    def _visit(self, points: Tensor, goal_id: Tensor) -> None:
        """Give the cells that people stand on their paths first."""
        self.prepare()
        if self.bank.grids:
            here, goals = points.view(-1, 2).double().numpy(), goal_id.view(-1).numpy()
            self._fill(here[goals >= 0], goals[goals >= 0])

    def _fill(self, points: NDArray[np.float64], goals: NDArray[np.int64]) -> None:
        """Write the paths from the open cells nearest to points (P, 2) to their goals (P,)."""
        graph = self.graph(0)
        place, last = graph.to_place(points), np.array([graph.shape[1] - 1, graph.shape[0] - 1])
        low, high = (
            np.ceil(place - 0.5 + side).clip(0, last).astype(np.int64) for side in (-_BORDER, _BORDER)
        )
        wanted: set[tuple[int, int]] = set()
        for column in (low[:, 0], high[:, 0]):
            for line in (low[:, 1], high[:, 1]):
                cells = graph.nearest[line * graph.shape[1] + column]
                wanted |= set(zip(goals.tolist(), cells.tolist(), strict=True))
        # corners have paths around them already, but may see more themselves
        if fresh := sorted(wanted - self._asked):
            self._add_cells(*np.array(fresh).T)
            self._asked |= wanted
            self._last_cell |= fresh

    def _at(self, goal: Any, cell: Any) -> Any:
        return 1 + goal * self._entries + cell

    def _write(self, goal: Any, cell: Any, waypoint: Any, length: Any) -> None:
        at = self._at(goal, cell)
        self._waypoint[at], self._length[at] = waypoint, length

    def _add_corners(self, number: int) -> NDArray[np.float64]:
        """Write the paths from all corners to a goal, and return their lengths (K,), metres."""
        graph, corners, goal = self.graph(0), self.corners(0), self._goals[number]
        seen = corners.seen_by(goal.cell)
        there = corners.metres(seen, graph.to_place(np.array([goal.point]))[0])
        length, before = corners.search(seen, there)
        length, before = length[:-1], before[:-1]
        goes_on = (before >= 0) & (before < len(corners.cells))
        onward = np.where(goes_on, corners.cells[np.where(goes_on, before, 0)], self._entries - 1)
        known = np.isfinite(length)
        self._write(number, corners.cells[known], onward[known], length[known])
        return length

    def _add_cells(self, numbers: NDArray[np.int64], cells: NDArray[np.int64]) -> None:
        """Write the paths from open cells (P,) to goals (P,): straight, or by way of a corner in sight."""
        graph, corners = self.graph(0), self.corners(0)
        goal_cells = np.array([self._goals[number].cell for number in numbers])
        straight = graph.sight.clear(graph.place[cells], graph.place[goal_cells]) | (cells == goal_cells)
        end = graph.to_place(np.array([self._goals[number].point for number in numbers]))[straight]
        metres = np.hypot(*(graph.place[cells[straight]] - end).T) * graph.grid.resolution
        self._write(numbers[straight], cells[straight], self._entries - 1, metres)
        numbers, cells = numbers[~straight], cells[~straight]
        if len(cells) and len(corners.cells):
            total = corners.metres(slice(None), graph.place[cells, None])
            total += np.stack([self._from_corners[number] for number in numbers])
            total[total < self._least(numbers, cells)[:, None]] = np.inf
            for tried in (*_TRIED, len(corners.cells)):
                best, length = self._best_in_sight(cells, total, min(tried, len(corners.cells)))
                sees = np.isfinite(length)
                self._write(numbers[sees], cells[sees], corners.cells[best[sees]], length[sees])
                numbers, cells, total = numbers[~sees], cells[~sees], total[~sees]
        self._write(numbers, cells, cells, np.inf)

    def _least(self, numbers: NDArray[np.int64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the least metres of paths from open cells to goals (P,): shorter ones are not in sight.

        By the triangle inequality, from the path of the cell that was filled last, if they see each other.
        """
        place, metre = self.graph(0).place, self.graph(0).grid.resolution
        last = np.array([self._last_cell.get(number, -1) for number in numbers.tolist()])
        seen = (last >= 0) & self.graph(0).sight.clear(place[cells], place[last])
        length = self._length[self._at(numbers, last)] - metre * np.hypot(*(place[cells] - place[last]).T)
        # goals lie up to a cell beside the centre of theirs
        return np.where(seen, length - metre, 0.0)

    def _best_in_sight(
        self, cells: NDArray[np.int64], total: NDArray[np.float64], tried: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the corner in sight of each open cell (P,) with the least ``total`` (P, K), and that total.

        Only the ``tried`` least ones are looked at. The total is infinite where none of them is in sight.
        """
        graph, corners = self.graph(0), self.corners(0).cells
        some = np.argpartition(total, tried - 1)[:, :tried]
        some = np.take_along_axis(some, np.take_along_axis(total, some, 1).argsort(1), 1)
        total = np.take_along_axis(total, some, 1)
        here = graph.place[cells].repeat(tried, 0)
        seen = graph.sight.clear(here, graph.place[corners[some.ravel()]]).reshape(total.shape)
        first = (seen & np.isfinite(total)).argmax(1)[:, None]
        length = np.where(np.take_along_axis(seen, first, 1), np.take_along_axis(total, first, 1), np.inf)
        return np.take_along_axis(some, first, 1)[:, 0], length[:, 0]
