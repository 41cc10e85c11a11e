"""The planner's look-up tables: fields of all goals on all floor plans as flat tensors, read by gathers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from pedzoo.errors import UserError
from pedzoo.maps.atlas import Atlas
from pedzoo.maps.fields import Fields
from pedzoo.maps.graph import OpenGraph

_FAR = 1.0
"""Metres at which distances to walls are cut off: lines are not asked to keep away farther."""


class Goal(NamedTuple):
    """A registered goal."""

    row: int
    """Row of its map, -1 for none."""
    point: tuple[float, float]
    """Where it is in the map's frame, metres."""
    cell: int
    """Number of the open cell that it is in, -1 without a map."""


class Found(NamedTuple):
    """What the tables say about P people, in the map's frame; x and y are rows."""

    waypoint: Tensor
    """The next waypoint (2, P)."""
    after: Tensor
    """The one after it (2, P)."""
    goal: Tensor
    """The goal (2, P)."""
    onward: Tensor
    """Metres of the way from the next waypoint to the goal (P,), ``inf`` where none leads there."""
    last: Tensor
    """Whether the waypoint after the next is the goal (P,) bool."""


@dataclass(frozen=True, eq=False)
class Tables:
    """All fields, goals and cells. Maps are rows 1 to R, goals rows 1 to G; row 0 is "none" of both.

    A field is a run of one entry per open cell of its map and a last one of the goal itself.

    Attributes:
        distance: Distances to the nearest wall; its row -1 is "no map".
        affine: Map frame in metres to cells (R + 1, 6), by rows.
        last: Last column and row of each map (R + 1, 2).
        cells: Columns, first cell in ``nearest`` and first open cell in ``center`` of each map (R + 1, 3).
        reach: Metres to the centre of the nearest open cell from which on people go there first (R + 1,).
        nearest: Nearest open cell of every cell of every map.
        center: Centres of the open cells of all maps (., 2), each map's followed by a row without meaning.
        point: Places of the goals (G + 1, 2).
        goal: First entry of each goal, open cells of its map (the number that means the goal itself), and
            row of its map (G + 1, 3).
        entry: Next waypoint and, as bits, metres of the way to the goal (., 2) int32.
    """

    distance: Atlas
    affine: Tensor
    last: Tensor
    cells: Tensor
    reach: Tensor
    nearest: Tensor
    center: Tensor
    point: Tensor
    goal: Tensor
    entry: Tensor

    @classmethod
    def build(cls, maps: Sequence[OpenGraph | None], clearance: float) -> Tables:
        """Return the tables of maps without goals.

        Args:
            maps: Open cells of each map of the bank; None where nobody has a goal.
            clearance: Metres that ways keep from walls.
        """
        far = torch.tensor([_FAR])
        parts = [_of_map(graph) for graph in (None, *maps)]
        cells, opens = [len(part[3]) for part in parts], [len(part[4]) for part in parts]
        starts = np.cumsum([[0, 0], *zip(cells, opens, strict=True)], axis=0)[:-1]
        return cls(
            distance=Atlas.stack(
                [part[2].clamp(-_FAR, _FAR)[None] for part in parts[1:]],
                [part[0] for part in parts[1:]],
                nowhere=far,
            ),
            affine=torch.tensor(np.array([part[0].ravel() for part in parts]), dtype=torch.float32),
            last=torch.tensor([part[1] for part in parts], dtype=torch.float32) - 1,
            cells=torch.tensor([(part[1][0], *at) for part, at in zip(parts, starts.tolist(), strict=True)]),
            reach=torch.tensor([max(clearance, 1.5 * part[5]) for part in parts]),
            nearest=torch.cat([part[3] for part in parts]),
            center=torch.cat([part[4] for part in parts]),
            point=torch.zeros(1, 2),
            goal=torch.tensor([[0, 0, 0]]),
            entry=torch.zeros(1, 2, dtype=torch.int32),
        )

    def with_goals(self, goals: Sequence[Goal], fields: Sequence[Fields]) -> Tables:
        """Return the tables with more goals, whose fields are (1, N) each; (1, 0) without a map."""
        counts = np.array([field.waypoint.shape[1] for field in fields])
        starts = len(self.entry) + np.cumsum([0, *(counts + 1)[:-1]])
        device = self.entry.device
        rows = np.stack((starts, counts, [goal.row + 1 for goal in goals]), axis=1)
        return replace(
            self,
            point=torch.cat((self.point, torch.tensor([goal.point for goal in goals]).float().to(device))),
            goal=torch.cat((self.goal, torch.from_numpy(rows).to(device))),
            entry=torch.cat((self.entry, *(_entries(field).to(device) for field in fields))),
        )

    def to(self, device: torch.device) -> Tables:
        """Return the tables on a device: themselves where they are there already."""
        if self.entry.device == device:
            return self
        return Tables(**{name: part.to(device) for name, part in vars(self).items()})

    def look(self, points: Tensor, goal: Tensor, row: Tensor) -> Found:
        """Return where the ways of people at map-frame ``points`` lead.

        Args:
            points: Positions (2, P), metres.
            goal: Ids of their goals (P,), -1 for none.
            row: Rows of their maps (P,), -1 for none.

        Raises:
            UserError: A goal is of another map than the person.
        """
        # index_select is several times faster than indexing with a tensor
        start, count, of_map = self.goal.index_select(0, goal + 1).unbind(1)
        someone = goal >= 0
        wrong = (of_map != row + 1) & someone
        if wrong.any():
            i = int(wrong.nonzero()[0, 0])
            raise UserError(
                f"goal {int(goal[i])} was added for row {int(of_map[i]) - 1} of the bank, but person {i} is "
                f"on row {int(row[i])} (-1: no map)"
            )
        number = row + 1
        width, cells, opens = self.cells.index_select(0, number).unbind(1)
        a, b, c, d, e, f = self.affine.index_select(0, number).unbind(1)
        last_column, last_row = self.last.index_select(0, number).unbind(1)
        x, y = points
        # half cells belong to the smaller one, as in OpenGraph.locate
        column = (a * x + b * y + (c - 0.5)).ceil().clamp_min(0).minimum(last_column).long()
        line = (d * x + e * y + (f - 0.5)).ceil().clamp_min(0).minimum(last_row).long()
        cell = self.nearest.index_select(0, line * width + column + cells)

        # without a goal there is a single entry, whatever the cell
        first = self.entry.index_select(0, start + cell * someone)[:, 0]
        second, onward = self.entry.index_select(0, start + first).unbind(1)
        places = torch.cat((first, second, cell)) + opens.repeat(3)
        place = self.center.index_select(0, places).view(3, -1, 2).permute(0, 2, 1)
        final = self.point.index_select(0, goal + 1).t()
        is_last = second == count
        waypoint = torch.where(first == count, final, place[0])
        after = torch.where(is_last, final, place[1])
        onward = onward.contiguous().view(torch.float32)

        away = (points - place[2]).square().sum(0) > self.reach.index_select(0, number).square()
        away &= of_map > 0
        if away.any():
            onward = torch.where(away, onward + (waypoint - place[2]).norm(dim=0), onward)
            is_last = torch.where(away, first == count, is_last)
            after = torch.where(away, waypoint, after)
            waypoint = torch.where(away, place[2], waypoint)
        return Found(waypoint, after, final, onward, is_last)

    def lowest(self, begin: Tensor, end: Tensor, row: Tensor, spacing: float) -> Tensor:
        """Return the least distance to a wall on lines (P,), metres, 1 m at most.

        Args:
            begin: Where they begin in the map's frame (2, P), metres; this point itself is left out.
            end: Where they end (2, P).
            row: Rows of the maps (P,), -1 for none.
            spacing: Most metres between two of the points that are looked at.
        """
        atlas = self.distance
        linear, shift = atlas.linear[row], atlas.shift[row]
        low, high = atlas.low[row], atlas.high[row]
        ends = torch.stack((begin, end), dim=2).permute(1, 0, 2)  # (P, 2, 2): points are columns
        ends = torch.baddbmm(shift[:, :, None], linear, ends).permute(2, 0, 1)
        ends = ends.clamp(low, high)
        count = int((end - begin).square().sum(0).max().sqrt() / spacing) + 1
        part = torch.arange(1, count + 1, device=row.device)[:, None, None] / count
        line = torch.lerp(ends[0], ends[1], part)
        found = F.grid_sample(atlas.image, line[None], align_corners=True)
        return found[0, 0].amin(dim=0)


def _of_map(graph: OpenGraph | None) -> tuple:
    """Return affine, columns and rows, distances, nearest open cells, their centres, and the cells' side."""
    if graph is None:  # one cell that everybody is in, without walls
        single = torch.zeros(1, dtype=torch.int32)
        return np.zeros((2, 3)), (1, 1), torch.full((1, 1), torch.inf), single, torch.zeros(1, 2), 0.0
    centers = torch.from_numpy(graph.xy).float()
    return (
        graph.grid.map_to_cell(),
        (graph.shape[1], graph.shape[0]),
        torch.from_numpy(graph.distance),
        torch.from_numpy(graph.nearest),
        # the number of the goal itself must be readable
        F.pad(centers, (0, 0, 0, 1)),
        graph.grid.resolution,
    )


def _entries(field: Fields) -> Tensor:
    waypoint = F.pad(field.waypoint[0], (0, 1), value=field.waypoint.shape[1])
    length = F.pad(field.length[0], (0, 1))
    return torch.stack((waypoint, length.view(torch.int32)), dim=1)
