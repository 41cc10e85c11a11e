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
from pedzoo.maps.planning.waypoint_table import Goal, WaypointTable

_KEPT = 20_000, 64
"""Entries that are kept, and more than that for so many per person: older ones are looked for again."""

_PARTS = "keys", "waypoint", "length"
"""Those of a table that grow with what is asked."""

_AT_ONCE = 4_000_000
"""Distances between people and corners that are compared together: bounds the memory that it takes."""

_TRIED = 4, 32
"""Corners whose sight is tried first: the best one in sight is nearly always among them."""

_BORDER = 1e-3, 1e-6
"""Cells, and part of the floor plan: a person so near to the border of two cells may be looked up in both."""


class OnlinePlanner(Planner):
    """Paths on one floor plan, or on none, whose fields have only the cells that were asked for.

    A field of a new goal takes up to a second on a large plan. Here the corners get their distances to the
    goal (some milliseconds), and the cells under people the best of the corners that they see. These paths
    are shortest ones, those of fields at most a little longer. Memory grows with people and corners.
    """

    _table: WaypointTable

    def __init__(self, bank: MapBank, clearance: float = 0.25, origin: ArrayLike = 0.0) -> None:
        """Take the floor plan, and find its corners; ``origin`` is that of its frame in the caller's."""
        super().__init__(bank, clearance)
        self.origin = origin
        if bank.grids:
            _ = self.corners(0).matrix, bank.walls  # at the first step they would come too late
        maps = [self.graph(0)] if bank.grids else []
        self._cells = len(maps[0]) if maps else 0
        self._empty = replace(WaypointTable.build(maps, clearance), keys=torch.zeros(1, dtype=torch.long))
        self._clear()

    def _clear(self) -> None:
        self._ids, self._goals, self._from_corners = {}, [], []
        self._last: dict[int, tuple[int, float]] = {}
        self._table, self._with_fields = self._empty, 0

    def without_goals(self) -> OnlinePlanner:
        """Return a planner of the same floor plan without goals."""
        result = OnlinePlanner.__new__(OnlinePlanner)
        result.__dict__.update(self.__dict__)
        result._clear()
        return result

    def prepare(self) -> WaypointTable:
        """Return the table of all goals, and of the cells that were asked for."""
        first = self._with_fields
        if fresh := self._goals[first:]:
            self._from_corners += [self._search(goal) for goal in fresh]
            counts = np.array([self._cells * (goal.row >= 0) for goal in fresh])
            starts = self._start(np.arange(first, len(self._goals)))
            rows = torch.from_numpy(np.stack((starts, counts, [goal.row + 1 for goal in fresh])))
            ends = torch.tensor([goal.point for goal in fresh]).float().t()
            goals = torch.cat((self._table.goal, rows), 1), torch.cat((self._table.end, ends), 1)
            self._table = replace(self._table, goal=goals[0], end=goals[1])
            self._write(starts + counts, counts, np.zeros(len(fresh)))
            self._with_fields = len(self._goals)
        return self._table

    def _start(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the first entries of goals: those of a goal are the open cells, and the goal itself."""
        return 1 + numbers * (self._cells + 1)

    def _search(self, goal: Goal) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return the metres from all corners to a goal, and which corner comes next (K,): K is the goal."""
        if goal.row < 0:
            return np.empty(0), np.empty(0, np.int32)
        corners = self.corners(0)
        seen = corners.seen_by(goal.cell)
        there = corners.metres(seen, self.graph(0).to_place(np.array([goal.point]))[0])
        length, onward = corners.search(seen, there)
        return length[:-1], onward[:-1]

    def _visit(self, points: Tensor, goal_id: Tensor, pose: Tensor) -> None:
        """Find the paths from the cells that people stand on."""
        table, goals = self.prepare(), goal_id.numpy().ravel()
        walks = table.goal[2].numpy()[goals + 1] > 0
        if not walks.any():
            return
        turn, mirror, *shift = pose.double().numpy().reshape(-1, *[1] * (goal_id.dim() - 1), 4).T
        x, y = points.detach().double().numpy().T - np.stack(shift)
        x, y = np.cos(turn) * x + np.sin(turn) * y, (np.cos(turn) * y - np.sin(turn) * x) * mirror
        wanted = self._entries_at(np.stack((x.T.ravel(), y.T.ravel()), axis=1)[walks], goals[walks])
        fresh = wanted[~self._has(wanted)]
        if len(fresh) and len(table.keys) > max(_KEPT[0], _KEPT[1] * len(wanted)):
            own = torch.isin(table.keys, torch.cat((table.keys[:1], table.goal[:2].sum(0))))
            parts = {name: getattr(table, name)[own] for name in _PARTS}
            self._table, fresh = replace(table, **parts), wanted
        per = max(1, _AT_ONCE // max(1, len(self.corners(0).cells)))
        for i in range(0, len(fresh), per):
            self._add(fresh[i : i + per])

    def _entries_at(self, points: NDArray[np.float64], goals: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the entries, growing, of the open cells under points (P, 2) on the way to goals (P,)."""
        graph = self.graph(0)
        place, border = graph.to_place(points) - 0.5, _BORDER[0] + _BORDER[1] * max(graph.shape)
        low, high = np.ceil(place - border), np.ceil(place + border)
        if (low != high).any():
            sides = [np.stack((one[:, 0], other[:, 1]), 1) for one in (low, high) for other in (low, high)]
            low, goals = np.concatenate(sides), np.tile(goals, 4)
        column, line = np.maximum(np.minimum(low.T, [[graph.shape[1] - 1], [graph.shape[0] - 1]]), 0)
        cells = graph.nearest[(line * graph.shape[1] + column).astype(np.int64)]
        return np.unique(self._start(goals) + cells)

    def _has(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which entries (P,) the table has."""
        mine = self._table.keys.numpy()
        return mine[np.minimum(mine.searchsorted(keys), len(mine) - 1)] == keys

    def _write(self, *parts: NDArray[Any]) -> None:
        """Insert entries (P,) that the table does not have, growing: keys, next waypoints and lengths."""
        table = self._table
        at = table.keys.numpy().searchsorted(parts[0]) + np.arange(len(parts[0]))
        old = np.ones(len(table.keys) + len(at), dtype=bool)
        old[at] = False
        merged = {}
        for name, part in zip(_PARTS, parts, strict=True):
            before = getattr(table, name).numpy()
            values = np.empty(len(old), before.dtype)
            values[old], values[at] = before, part
            merged[name] = torch.from_numpy(values)
        self._table = replace(table, **merged)

    def _add(self, keys: NDArray[np.int64]) -> None:
        """Find the paths of entries (P,) of cells; write them and those of all corners that they lead to."""
        numbers, cells = np.divmod(keys - 1, self._cells + 1)
        corner, length = self._paths(numbers, cells)
        self._last |= zip(numbers.tolist(), zip(cells.tolist(), length.tolist(), strict=True), strict=True)
        corners = self.corners(0).cells
        places = np.append(corners, (self._cells, 0))  # those of corners, and of K, the goal
        found = [(keys, np.where(corner < 0, cells, places[corner]), length)]
        while (bends := (corner >= 0) & (corner < len(corners))).any():
            numbers, corner = numbers[bends], corner[bends]
            keys = self._start(numbers) + corners[corner]
            new = ~self._has(keys)
            keys, numbers, corner = keys[new], numbers[new], corner[new]
            ways = [self._from_corners[number] for number in numbers.tolist()]
            here = list(zip(corner.tolist(), ways, strict=True))
            length = np.array([metres[one] for one, (metres, _) in here])
            corner = np.array([onward[one] for one, (_, onward) in here], dtype=np.int64)
            found.append((keys, places[corner], length))
        keys, waypoint, length = (np.concatenate(part) for part in zip(*found, strict=True))
        keys, first = np.unique(keys, return_index=True)
        self._write(keys, waypoint[first], length[first])

    def _paths(
        self, numbers: NDArray[np.int64], cells: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the corner where paths from open cells (P,) to goals (P,) bend first, and their metres.

        The corner is K for a straight path, and -1 where none leads to the goal.
        """
        graph, corners = self.graph(0), self.corners(0)
        goals = [self._goals[number] for number in numbers.tolist()]
        straight = graph.sight.clear(graph.place[cells], graph.place[[goal.cell for goal in goals]])
        away = graph.place[cells] - graph.to_place(np.array([goal.point for goal in goals]))
        length = np.where(straight, np.hypot(*away.T) * graph.grid.resolution, np.inf)
        corner = np.where(straight, len(corners.cells), -1)
        rest = np.flatnonzero(~straight)
        if len(rest) and len(corners.cells):
            total = corners.metres(slice(None), graph.place[cells[rest], None])
            total += np.stack([self._from_corners[number][0] for number in numbers[rest]])
            total[total < self._least(numbers[rest], cells[rest])[:, None]] = np.inf
            total[cells[rest, None] == corners.cells] = np.inf  # nobody's next waypoint is where they are
            for tried in (*_TRIED, len(corners.cells)):
                best, metres = self._best_in_sight(cells[rest], total, min(tried, len(corners.cells)))
                sees = np.isfinite(metres)
                corner[rest[sees]], length[rest[sees]] = best[sees], metres[sees]
                rest, total = rest[~sees], total[~sees]
        return corner, length

    def _least(self, numbers: NDArray[np.int64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the least metres of paths from open cells to goals (P,): shorter ones are not in sight.

        By the triangle inequality, from the path of the cell that was filled last, if they see each other.
        """
        place, metre = self.graph(0).place, self.graph(0).grid.resolution
        known = [self._last.get(number, (-1, 0.0)) for number in numbers.tolist()]
        last, length = np.array([cell for cell, _ in known]), np.array([metres for _, metres in known])
        seen = (last >= 0) & self.graph(0).sight.clear(place[cells], place[last])
        # goals lie up to 0.71 cells beside the centre of theirs, at both ends of the inequality
        bound = length - metre * (np.hypot(*(place[cells] - place[last]).T) + 1.5)
        return np.where(seen, bound, 0.0)

    def _best_in_sight(
        self, cells: NDArray[np.int64], total: NDArray[np.float64], tried: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the corner in sight of each open cell (P,) with the least ``total`` (P, K), and that total.

        Only the ``tried`` least ones are looked at. The total is infinite where none of them is in sight.
        """
        graph, corners = self.graph(0), self.corners(0).cells
        # of corners that are as near the first one counts, whatever was looked for before
        some = np.sort(np.argpartition(total, tried - 1)[:, :tried], 1)
        order = np.take_along_axis(total, some, 1).argsort(1, kind="stable")
        some = np.take_along_axis(some, order, 1)
        total = np.take_along_axis(total, some, 1)
        here = graph.place[cells].repeat(tried, 0)
        seen = graph.sight.clear(here, graph.place[corners[some.ravel()]]).reshape(total.shape)
        first = (seen & np.isfinite(total)).argmax(1)[:, None]
        length = np.where(np.take_along_axis(seen, first, 1), np.take_along_axis(total, first, 1), np.inf)
        return np.take_along_axis(some, first, 1)[:, 0], length[:, 0]
