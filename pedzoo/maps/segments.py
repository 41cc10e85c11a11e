"""Walls as line segments, and the few of them that matter to each person."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.geometry import move_to_map
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.outlines import outlines
from pedzoo.maps.segment_table import NOWHERE, SegmentTable, edges


class Segments(NamedTuple):
    """Up to K segments of walls near each of N people, nearest first, in the frame of everybody's scene.

    Walls lie to the left of a segment, people to its right.

    Attributes:
        start: Where it starts (2, K, N), metres.
        end: Where it ends (2, K, N).
        direction: Unit vector from start to end (2, K, N).
        before: Unit direction of the segment that ends where this one starts (2, K, N).
        after: Unit direction of the segment that starts where this one ends (2, K, N).
        convex: Whether the wall's corners at start and end are convex (2, K, N) bool.
        valid: Which of the K there are (K, N) bool; the others hold any segment.
    """

    start: Tensor
    end: Tensor
    direction: Tensor
    before: Tensor
    after: Tensor
    convex: Tensor
    valid: Tensor

    def select(self, people: Tensor) -> Segments:
        """Return those of some people (M,) long."""
        return Segments(*(part.index_select(-1, people) for part in self))

    def nearest(self, most: int) -> Segments:
        """Return at most so many of each person."""
        return Segments(*(part[..., :most, :] for part in self))


class WallSegments:
    """Outlines of all walls of a bank's floor plans, with a look-up of the nearest.

    Attributes:
        bank: The floor plans; their unknown cells count as it says.
        tolerance: How many cells a simplified outline may depart from the cells' edges. Half of one makes
            staircases straight; with a whole one people of radius 0.2 m touched walls in a scanned apartment.
        most: Segments that are returned for one person at most.
    """

    def __init__(self, bank: MapBank, tolerance: float = 0.5, most: int = 16) -> None:
        """Take the floor plans; nothing is computed before the first look-up."""
        self.bank = bank
        self.tolerance = tolerance
        self.most = most
        self._known: dict[tuple[torch.device, torch.dtype], tuple[MapBank, SegmentTable]] = {}

    def near(self, points: Tensor, map_id: Tensor, pose: Tensor, reach: Tensor | float) -> Segments:
        """Return the nearest segments of each person that they are outside of, nearest first.

        Without a map there are none.

        Args:
            points: Scene positions (N, 2), metres.
            map_id: Floor plan of each (N,) long, -1 for none.
            pose: Scene poses (N, 4).
            reach: Metres (N,) or one number within which a segment has to come.

        Raises:
            UserError: A ``map_id`` is of another bank.
        """
        reach = torch.as_tensor(reach, dtype=points.dtype, device=points.device).expand(len(points))
        bank, table = self._look_up(float(reach.max()) if len(points) else 0.0, points)
        person, segment, distance2 = table.look(move_to_map(points, pose), bank.index(map_id), reach)
        order, rank = _ranked(person, distance2)
        kept = rank < self.most
        order, rank = order[kept], rank[kept]
        slots = int(rank.max()) + 1 if len(rank) else 0
        # the last segment of the table stands for none
        chosen = person.new_full((slots * len(points),), table.none)
        chosen[rank * len(points) + person[order]] = segment[order]
        parts = table.segments.index_select(1, chosen).view(12, slots, len(points))
        valid = (chosen < table.none).view(slots, len(points))
        return _in_scene(parts, pose, valid)

    def polygons(self, grid: OccupancyGrid) -> list[NDArray[np.float64]]:
        """Return the outlines (V, 2) of a floor plan's walls in its frame, metres, walls to the left."""
        found = outlines(grid.occupied(self.bank.unknown), self.tolerance)
        return [grid.cells_to_map(polygon - 0.5) for polygon in found]

    def edges(self, grid: OccupancyGrid) -> NDArray[np.float64]:
        """Return the segments (S, 12) of a floor plan's walls in the form of `SegmentTable`."""
        return np.concatenate([NOWHERE[:0], *(edges(polygon) for polygon in self.polygons(grid))])

    def _look_up(self, reach: float, points: Tensor) -> tuple[MapBank, SegmentTable]:
        """Return bank and table for people like these, computed anew where they do not reach far enough."""
        key = points.device, points.dtype
        bank, table = self._known.get(key) or (self.bank.to(points.device), None)
        if table is None or table.reach < reach:
            whole = math.ceil(reach) or 1  # slightly faster people do not compute it again
            segments = [self.edges(grid) for grid in self.bank.grids]
            table = SegmentTable.build(segments, whole, self.most).to(*key)
            self._known[key] = bank, table
        return bank, table


def _ranked(person: Tensor, distance2: Tensor) -> tuple[Tensor, Tensor]:
    """Return the order (M,) of pairs by person, then distance, and each ordered pair's rank in its person."""
    # Floats that are not negative are ordered as their bits are.
    key = (person << 32) | distance2.float().view(torch.int32)
    order = key.argsort(stable=True)
    number = torch.arange(len(person), device=person.device)
    # people are in order before and after
    fresh = torch.ones_like(person, dtype=torch.bool)
    fresh[1:] = person[1:] != person[:-1]
    first = torch.where(fresh, number, 0).cummax(0).values
    return order, number - first


def _in_scene(parts: Tensor, pose: Tensor, valid: Tensor) -> Segments:
    """Return segments (12, K, N) of the maps' frames in those of the scenes of ``pose`` (N, 4)."""
    (cos, sin), mirror, shift = (pose[:, 0].cos(), pose[:, 0].sin()), pose[:, 1], pose[:, 2:].T[:, None]

    def turned(vector: Tensor) -> Tensor:
        x, y = vector[0], vector[1] * mirror
        return torch.stack((cos * x - sin * y, sin * x + cos * y))

    start, end, direction, before, after = (turned(vector) for vector in parts[:10].split(2))
    there = Segments(start + shift, end + shift, direction, before, after, parts[10:] > 0, valid)
    if (mirror > 0).all():
        return there
    # in a mirror everything runs the other way round, so that walls stay on the left
    back = Segments(there.end, there.start, -direction, -after, -before, there.convex.flip(0), valid)
    return Segments(*(torch.where(mirror > 0, one, other) for one, other in zip(there, back, strict=True)))
