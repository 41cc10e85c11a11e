"""Fields of next waypoints: for every open cell of a floor plan the way to a goal, one look-up away."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from pedzoo.maps.graph import OpenGraph

_AT_ONCE = 4_000_000
"""Cells of all fields that are built together: bounds the memory that building takes."""

_TRIES = 3
"""Different waypoints that a cell looks for before it goes by way of a neighbour."""


@dataclass(frozen=True)
class Fields:
    """Ways from all N open cells of a floor plan to G goals.

    Attributes:
        waypoint: Number of the open cell that is the next waypoint (G, N) int32: the farthest one of the way
            in sight; N is the goal itself. Where no way leads to the goal it is the cell's own number.
        length: Metres of the way from the cell's centre to the goal (G, N) float32; ``inf`` where none leads.
    """

    waypoint: Tensor
    length: Tensor


def build_fields(graph: OpenGraph, cells: NDArray[np.int64], points: NDArray[np.float64]) -> Fields:
    """Return the fields of goals in the open cells ``cells`` (G,) at the places ``points`` (G, 2).

    Dijkstra's distances on the graph give an order in which cells come after their way to the goal. In this
    order every cell takes the best of its neighbours' waypoints that is in sight, as in Theta* (Nash et al.,
    AAAI 2007), and goes by way of the best neighbour if none is. All goals are swept together, so a step of
    the sweep is as wide as all their wave fronts.

    Args:
        graph: The open cells.
        cells: Number of the open cell that each goal is in.
        points: Column and row of the goals, whole at cell centres.
    """
    per = max(1, _AT_ONCE // max(len(graph), 1))
    parts = [
        _sweep(graph, cells[i : i + per], torch.from_numpy(points[i : i + per]).float())
        for i in range(0, len(cells), per)
    ]
    return Fields(torch.cat([part.waypoint for part in parts]), torch.cat([part.length for part in parts]))


def _sweep(graph: OpenGraph, cells: NDArray[np.int64], points: Tensor) -> Fields:
    count, goals = len(graph), len(cells)
    reach = dijkstra(graph.matrix, indices=cells).ravel()
    order, ends = _bands(reach / graph.grid.resolution)
    # One column more than cells: of the goal itself, and never better than anything for missing neighbours.
    stride = count + 1
    waypoint = torch.arange(stride, dtype=torch.int32).repeat(goals, 1)
    waypoint[:, count] = -1
    waypoint[torch.arange(goals), torch.from_numpy(cells)] = count
    place = torch.from_numpy(np.concatenate((graph.place, np.zeros((1, 2)))).astype(np.float32))
    length = torch.full((goals, stride), torch.inf)
    own = torch.from_numpy(cells)
    length[torch.arange(goals), own] = (place[own] - points).norm(dim=1)
    neighbours = torch.from_numpy(graph.neighbours)
    waypoint, length = waypoint.view(-1), length.view(-1)

    thick = graph.clearance >= 2 * graph.grid.resolution
    for first, last in pairwise(ends.tolist()):
        pair = torch.from_numpy(order[first:last])
        goal, cell = pair // count, pair % count
        here, base = place[cell], goal * stride
        beside = neighbours[cell].long()  # (M, 8)
        at = base[:, None] + beside
        beside_length = torch.where(beside == count, torch.inf, length[at])
        offered = waypoint[at].long()
        final = offered == count
        # where the waypoints are: the goal is a point, not its cell's centre
        target = torch.where(final[..., None], points[goal][:, None], place[offered])
        onward = torch.where(final, 0.0, length[base[:, None] + offered])
        total = (target - here[:, None]).norm(dim=2) + onward
        total = torch.where(beside_length.isinf(), torch.inf, total)
        via = beside_length + (place[beside] - here[:, None]).norm(dim=2)

        shortest = via.min(dim=1)
        found, chosen = shortest.values, beside.gather(1, shortest.indices[:, None])[:, 0]
        who = torch.arange(len(pair))
        for _ in range(_TRIES):
            best = total.min(dim=1)
            worth = torch.nonzero(best.values <= found[who])[:, 0]
            who, total, offered = who[worth], total[worth], offered[worth]
            candidate = offered.gather(1, best.indices[worth, None])[:, 0]
            # a goal is looked for at its cell's centre: only there is the clearance certain
            spot = torch.where(candidate == count, own[goal[who]], candidate)
            seen = _surely(offered, candidate, place[spot] - here[who])
            asked = torch.nonzero(~seen)[:, 0] if thick else torch.arange(len(who))
            ends = graph.place[cell[who[asked]].numpy()], graph.place[spot[asked].numpy()]
            seen[asked] = torch.from_numpy(graph.sight.clear(*ends))
            chosen[who[seen]] = candidate[seen]
            found[who[seen]] = best.values[worth][seen]
            missed = torch.nonzero(~seen)[:, 0]
            if not len(missed):
                break
            who, offered = who[missed], offered[missed]
            total = torch.where(offered == candidate[missed, None], torch.inf, total[missed])
        waypoint[base + cell] = chosen.int()
        length[base + cell] = found
    return Fields(
        waypoint.view(goals, stride)[:, :count].contiguous(),
        length.view(goals, stride)[:, :count] * graph.grid.resolution,
    )


def _surely(offered: Tensor, candidate: Tensor, way: Tensor) -> Tensor:
    """Return which cells certainly see their candidates (M,), without following the line.

    The line leaves a cell between two neighbours, one straight and one diagonal. If both see the candidate,
    the cell sees it between them: nothing that keeps two cells' clearance around it fits into the wedge.

    Args:
        offered: Waypoints of all neighbours (M, 8), which they see; -1 for missing ones.
        candidate: The waypoints in question (M,).
        way: Columns and rows from the cells to them (M, 2).
    """
    right, up = way.sign().long().unbind(1)
    level = way[:, 0].abs() >= way[:, 1].abs()
    # the order of STEPS, which leaves out the cell itself in the middle
    diagonal = (up + 1) * 3 + right + 1
    straight = torch.where(level, right + 4, up * 3 + 4)
    columns = torch.stack((diagonal, straight), dim=1)
    return (offered.gather(1, columns - (columns > 4).long()) == candidate[:, None]).all(dim=1)


def _bands(reach: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return reachable entries by growing distance in cells, and where each band of one cell's width ends.

    A step is at least one cell long: what a cell's way leads through is always in an earlier band. The
    goals' own cells, at distance 0, are not in the order.
    """
    band = np.where(np.isfinite(reach), reach, -1.0).round(6).astype(np.int32)
    entries = np.flatnonzero(reach < np.inf)
    entries = entries[reach[entries] > 0]
    order = entries[np.argsort(band[entries], kind="stable")]
    ends = np.concatenate(([0], np.bincount(band[order], minlength=1).cumsum()))
    return order, np.unique(ends)
