"""The planner's look-up tables: fields of all goals on all floor plans as flat tensors, read by gathers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.maps.fields import Fields
from pedzoo.maps.graph import OpenGraph


class Goal(NamedTuple):
    """A registered goal."""

    row: int
    """Row of its map, -1 for none."""
    point: tuple[float, float]
    """Where it is in the map's frame, metres."""
    cell: int
    """Number of the open cell that it is in, -1 without a map."""


class Found(NamedTuple):
    """What the tables say about P people, in the map's frame."""

    waypoint: Tensor
    """The next waypoint (P, 2)."""
    after: Tensor
    """The one after it (P, 2)."""
    goal: Tensor
    """The goal (P, 2)."""
    onward: Tensor
    """Metres of the way from the next waypoint to the goal (P,), ``inf`` where none leads there."""
    last: Tensor
    """Whether the waypoint after the next is the goal (P,) bool."""


@dataclass(frozen=True, eq=False)
class Tables:
    """All fields, goals and cells. Maps are rows 0 to R - 1; the last row, R or -1, is "no map".

    A field is a run of one entry per open cell of its map and a last one of the goal itself; the last field,
    of goal -1, is "no goal".

    Attributes:
        linear: Map frame in metres to cells (R + 1, 2, 2).
        shift: The same transform's constant part (R + 1, 2).
        limit: Last column and row of each map (R + 1, 2).
        width: Cells in a row of each map (R + 1,).
        first: Where each map's cells begin in ``nearest`` (R + 1,).
        nearest: Nearest open cell of every cell of every map.
        base: Where each map's open cells begin in ``center`` (R + 1,).
        center: Centres of the open cells of all maps (., 2).
        start: Where each goal's field begins in ``entry`` (G + 1,).
        entry: Next waypoint and, as bits, metres of the way to the goal (., 2) int32.
        count: Open cells of each goal's map (G + 1,): the number that means the goal itself.
        point: Places of the goals (G + 1, 2).
        row: Their maps (G + 1,).
    """

    linear: Tensor
    shift: Tensor
    limit: Tensor
    width: Tensor
    first: Tensor
    nearest: Tensor
    base: Tensor
    center: Tensor
    start: Tensor
    entry: Tensor
    count: Tensor
    point: Tensor
    row: Tensor

    @classmethod
    def build(
        cls,
        maps: Sequence[OpenGraph | None],
        goals: Sequence[Goal],
        kept: Tables | None,
        new: Sequence[Fields],
    ) -> Tables:
        """Return the tables of all maps and goals.

        Args:
            maps: Open cells of each map of the bank; None where nobody has a goal.
            goals: All goals.
            kept: Tables with the fields of the first goals.
            new: Fields of the others, in their order.
        """
        parts = [_map_part(graph) for graph in (*maps, None)]
        count = np.array([len(maps[goal.row] or ()) if goal.row >= 0 else 0 for goal in goals] + [0])
        entries = [_entries(field) for field in new]
        nothing = torch.zeros(1, 2, dtype=torch.int32)
        if kept is not None:
            entries.insert(0, kept.entry[:-1])
        return cls(
            linear=torch.stack([part[0] for part in parts]),
            shift=torch.stack([part[1] for part in parts]),
            limit=torch.stack([part[2] for part in parts]),
            width=torch.tensor([int(part[2][0]) + 1 for part in parts]),
            first=_starts([len(part[3]) for part in parts]),
            nearest=torch.cat([part[3] for part in parts]),
            base=_starts([len(part[4]) for part in parts]),
            center=torch.cat([part[4] for part in parts]),
            start=_starts(count + 1),
            entry=torch.cat([*(entry.to(nothing.device) for entry in entries), nothing]),
            count=torch.from_numpy(count),
            point=torch.tensor([*(goal.point for goal in goals), (0.0, 0.0)], dtype=torch.float32),
            row=torch.tensor([*(goal.row for goal in goals), -1]),
        )

    @property
    def goals(self) -> int:
        """How many goals have a field."""
        return len(self.start) - 1

    def to(self, device: torch.device) -> Tables:
        """Return the tables on a device: themselves where they are there already."""
        if self.entry.device == device:
            return self
        return Tables(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    def look(self, points: Tensor, goal: Tensor, row: Tensor) -> Found:
        """Return where the ways of people at map-frame ``points`` (P, 2) lead.

        Args:
            points: Positions, metres.
            goal: Ids of their goals (P,), -1 for none.
            row: Rows of their maps (P,), -1 for none.

        Raises:
            UserError: A goal is of another map than the person.
        """
        other = (self.row[goal] != row) & (goal >= 0)
        if other.any():
            i = int(other.nonzero()[0, 0])
            raise UserError(
                f"goal {int(goal[i])} was added for row {int(self.row[goal[i]])} of the bank, but person {i} "
                f"is on row {int(row[i])} (-1: no map)"
            )
        place = torch.baddbmm(self.shift[row, :, None], self.linear[row], points[:, :, None])[:, :, 0]
        # half cells belong to the smaller one, as in OpenGraph.locate
        place = (place - 0.5).ceil().clamp_min(0).minimum(self.limit[row]).long()
        cell = self.nearest[self.first[row] + place[:, 1] * self.width[row] + place[:, 0]]
        cell = torch.where(goal < 0, 0, cell)  # without a goal there is a single entry
        start, count, base = self.start[goal], self.count[goal], self.base[row]

        def read(number: Tensor) -> tuple[Tensor, Tensor]:
            entry = self.entry[start + number]
            return entry[:, 0], entry[:, 1].view(torch.float32)

        def where(number: Tensor) -> Tensor:
            return torch.where((number == count)[:, None], final, self.center[base + number])

        final = self.point[goal]
        first, _ = read(cell)
        second, onward = read(first)
        return Found(where(first), where(second), final, onward, second == count)


def _map_part(graph: OpenGraph | None) -> tuple[Tensor, ...]:
    """Return the affine, the last cell, the nearest open cells and the centres of a map, or of no map."""
    if graph is None:
        single = torch.zeros(1, dtype=torch.int32)
        return torch.zeros(2, 2), torch.zeros(2), torch.zeros(2), single, torch.zeros(1, 2)
    to_cell = torch.from_numpy(graph.grid.map_to_cell()).float()
    limit = torch.tensor([graph.shape[1] - 1.0, graph.shape[0] - 1.0])
    centers = torch.from_numpy(graph.xy).float()
    # one row more: the number of the goal itself, which is no cell, must be readable
    centers = torch.cat((centers, torch.zeros(1, 2)))
    return to_cell[:, :2], to_cell[:, 2], limit, torch.from_numpy(graph.nearest), centers


def _entries(field: Fields) -> Tensor:
    goals = len(field.waypoint)
    waypoint = torch.nn.functional.pad(field.waypoint, (0, 1), value=field.waypoint.shape[1])
    length = torch.nn.functional.pad(field.length, (0, 1))
    return torch.stack((waypoint, length.view(torch.int32)), dim=2).view(goals * waypoint.shape[1], 2)


def _starts(sizes: Sequence[int] | NDArray[np.int64]) -> Tensor:
    return torch.tensor([0, *np.cumsum(sizes)[:-1].tolist()])
