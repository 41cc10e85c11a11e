"""The planner's look-up table: fields of all goals on all floor plans as flat tensors, read by gathers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pedzoo.core.errors import UserError
from pedzoo.maps.planning.fields import Fields
from pedzoo.maps.planning.graph import OpenGraph


class Goal(NamedTuple):
    """A registered goal."""

    row: int
    """Row of its map, -1 for none."""
    point: tuple[float, float]
    """Where it is in the map's frame, metres."""
    cell: int
    """Number of the open cell that it is in, -1 without a map."""


class WaypointLookup(NamedTuple):
    """Where the paths of P people lead, in the map's frame; x and y are rows."""

    waypoint: Tensor
    """The next waypoint (2, P)."""
    after: Tensor
    """The one after it (2, P)."""
    goal: Tensor
    """The goal (2, P)."""
    onward: Tensor
    """Metres of the path from the next waypoint to the goal (P,), ``inf`` where none leads there."""
    last: Tensor
    """Whether the waypoint after the next is the goal (P,) bool."""


@dataclass(frozen=True, eq=False)
class WaypointTable:
    """All fields, goals and cells. Maps are rows 1 to R, goals rows 1 to G; row 0 is "none" of both.

    A field is a run of one entry per open cell of its map and a last one of the goal itself. A sparse table
    holds only the entries that are looked up, and their numbers.

    Attributes:
        to_cell: Affine from a map's frame in metres to cells by rows (6), last column and last row (2), and
            the squared distance in metres beyond which people go to the nearest open cell first (9, R + 1).
        begin: Columns, first cell in ``nearest`` and first open cell in ``x`` and ``y`` (3, R + 1).
        nearest: Nearest open cell of every cell of every map.
        x: Centres of the open cells of all maps.
        y: The same.
        goal: First entry of each goal, number of open cells of its map (it stands for the goal itself), and
            row of its map (3, G + 1).
        end: Places of the goals (2, G + 1).
        keys: Numbers of the entries of a sparse table, growing; empty where all entries are here.
        waypoint: Next waypoint of every entry, int32.
        length: Metres of its path to the goal, float32.
    """

    to_cell: Tensor
    begin: Tensor
    nearest: Tensor
    x: Tensor
    y: Tensor
    goal: Tensor
    end: Tensor
    keys: Tensor
    waypoint: Tensor
    length: Tensor

    @classmethod
    def build(cls, maps: Sequence[OpenGraph | None], clearance: float) -> WaypointTable:
        """Return the table of maps without goals; paths keep ``clearance`` metres from walls."""
        # "no map" is a single cell
        to_cell, begin = [np.zeros(9)], [(1, 0, 0)]
        nearest, places, cells, opens = [np.zeros(1, np.int32)], [np.zeros((1, 2))], 1, 1
        for graph in maps:
            begin.append((graph.shape[1] if graph else 1, cells, opens))
            if graph is None:  # without goals: like no map
                to_cell.append(to_cell[0])
                begin[-1] = begin[0]
                continue
            last = graph.shape[1] - 1, graph.shape[0] - 1
            reach = max(clearance, 1.5 * graph.grid.resolution) ** 2
            to_cell.append(np.array([*graph.grid.map_to_cell().ravel(), *last, reach]))
            nearest.append(graph.nearest)
            places.append(graph.xy)
            cells, opens = cells + len(graph.nearest), opens + len(graph)
        x, y = torch.from_numpy(np.concatenate(places)).float().t().contiguous()
        return cls(
            to_cell=torch.from_numpy(np.stack(to_cell, axis=1)).float(),
            begin=torch.tensor(begin).t().contiguous(),
            nearest=torch.from_numpy(np.concatenate(nearest)),
            x=x,
            y=y,
            goal=torch.zeros(3, 1, dtype=torch.long),
            end=torch.zeros(2, 1),
            keys=torch.zeros(0, dtype=torch.long),
            waypoint=torch.zeros(1, dtype=torch.int32),
            length=torch.zeros(1),
        )

    def with_goals(
        self, goals: Sequence[Goal], fields: Sequence[Fields], which: Sequence[int]
    ) -> WaypointTable:
        """Return the table with more goals; goal i has field ``which[i]`` of ``fields`` (1, N) or (1, 0)."""
        counts = np.array([field.waypoint.shape[1] for field in fields])
        starts = len(self.waypoint) + np.cumsum([0, *(counts + 1)[:-1]])
        starts, counts = starts[list(which)], counts[list(which)]
        device = self.waypoint.device
        rows = np.stack((starts, counts, [goal.row + 1 for goal in goals]))
        ends = torch.tensor([goal.point for goal in goals]).to(device, torch.float32).t()
        # the goal's own entry leads to itself
        paths = (F.pad(f.waypoint[0], (0, 1), value=f.waypoint.shape[1]).to(device) for f in fields)
        lengths = (F.pad(f.length[0], (0, 1)).to(device) for f in fields)
        return replace(
            self,
            goal=torch.cat((self.goal, torch.from_numpy(rows).to(device)), dim=1),
            end=torch.cat((self.end, ends), dim=1),
            waypoint=torch.cat((self.waypoint, *paths)),
            length=torch.cat((self.length, *lengths)),
        )

    def with_maps(self, maps: Sequence[OpenGraph | None], clearance: float) -> WaypointTable:
        """Return the table with these maps and the same goals."""
        built = WaypointTable.build(maps, clearance).to(self.waypoint.device)
        return replace(built, goal=self.goal, end=self.end, waypoint=self.waypoint, length=self.length)

    def to(self, device: torch.device) -> WaypointTable:
        """Return the table on a device: itself where it is there already."""
        if self.waypoint.device == device:
            return self
        return WaypointTable(**{part.name: getattr(self, part.name).to(device) for part in fields(self)})

    @cached_property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All parts as arrays, for compiled loops."""
        return tuple(getattr(self, part.name).numpy() for part in fields(self))

    def lookup(self, points: Tensor, goal: Tensor, row: Tensor) -> WaypointLookup:
        """Return where the paths of people lead from points (2, P) to goals (P,) on maps ``row`` (P,)."""
        # index_select is several times faster than indexing with a tensor
        start, count, of_map = self.goal.index_select(1, goal + 1)
        has_goal = goal >= 0
        number = row + 1
        width, cells, opens = self.begin.index_select(1, number)
        a, b, c, d, e, f, last_column, last_row, reach = self.to_cell.index_select(1, number)
        x, y = points
        # half cells belong to the smaller one, as in OpenGraph.locate
        column = (a * x + b * y + (c - 0.5)).ceil().clamp_min(0).minimum(last_column).long()
        line = (d * x + e * y + (f - 0.5)).ceil().clamp_min(0).minimum(last_row).long()
        cell = self.nearest.index_select(0, line * width + column + cells)

        # without a goal all cells share a single entry
        first = self.waypoint.index_select(0, self._at(start + cell * has_goal))
        entry = self._at(start + first)
        second, onward = self.waypoint.index_select(0, entry), self.length.index_select(0, entry)
        is_first, is_last = first == count, second == count
        place = torch.cat((torch.where(is_first, cell, first), torch.where(is_last, cell, second), cell))
        place = place + opens.repeat(3)
        places = torch.stack((self.x.index_select(0, place), self.y.index_select(0, place)))
        waypoint, after, nearest = places.view(2, 3, -1).unbind(1)
        end = self.end.index_select(1, goal + 1)
        waypoint, after = torch.where(is_first, end, waypoint), torch.where(is_last, end, after)

        away = ((points - nearest).square().sum(0) > reach) & (of_map > 0)
        onward = torch.where(away, onward + torch.hypot(*(waypoint - nearest)), onward)
        is_last = torch.where(away, is_first, is_last)
        after = torch.where(away, waypoint, after)
        waypoint = torch.where(away, nearest, waypoint)
        return WaypointLookup(waypoint, after, end, onward, is_last)

    def _at(self, number: Tensor) -> Tensor:
        """Return where the entries of these numbers (P,) are."""
        return torch.searchsorted(self.keys, number) if len(self.keys) else number

    def check(self, goal: Tensor, row: Tensor) -> None:
        """Check that goals (P,) are of the maps ``row`` (P,) of the agents that have them.

        Raises:
            UserError: One is of another map.
        """
        of_map = self.goal[2].index_select(0, goal + 1)
        wrong = (of_map != row + 1) & (goal >= 0)
        if wrong.any():
            i = int(wrong.nonzero()[0, 0])
            raise UserError(
                f"goal {int(goal[i])} was added for row {int(of_map[i]) - 1} of the bank, but person {i} is "
                f"on row {int(row[i])} (-1: no map)"
            )
