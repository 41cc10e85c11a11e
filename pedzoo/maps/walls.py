"""Walls as agents see them: exact distances, what they leave free, rays, and the nearest segments.

The field behind `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of a
cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.geometry import turn_matrix
from pedzoo.core.machine import compiles
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.boxes import nearest_boxes
from pedzoo.maps.constants import CANDIDATES, INTO, NO_WALL, WALL
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.segments import Outlines, SegmentTable

_ROUNDING = 1e-4
"""Cells that single precision may err by."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each quarter of a cell those that may be nearest.

    Each map is padded by ``max_distance`` and cut into quarters of cells. Which boxes contend in a
    quarter says `pedzoo.maps.boxes`. The contending boxes of a position's quarter are compared.

    Attributes:
        option: Sets of contending boxes in columns (4 * CANDIDATES + 1, O) float32: all their x0, then all
            their y0, x1 and y1, in half cells from the padded map's outer corner; last, plus one where they
            are walls and minus one where they are free space.
        choice: Which set contends in each quarter, row by row, one map after another (Q,) int32.
        least: What any position in a quarter is away from the nearest wall, at least (Q,) float32, metres.
        affine: Map frame in metres to half cells of the padded map: column by column a matrix's two rows and
            two shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of quarters of each padded map, and where they begin (3, R + 1) int32.
        side: Of half a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres.
        outlines: The same walls as line segments, on the CPU.
    """

    option: Tensor
    choice: Tensor
    least: Tensor
    affine: Tensor
    place: Tensor
    side: Tensor
    limit: float
    outlines: Outlines

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, max_distance: float) -> Walls:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        # People farther out than the padding have no wall within max_distance. "No map" is a last map of
        # one free cell that every position falls on: index -1 finds it.
        pads = [math.ceil(max_distance / grid.resolution) for grid in grids]
        plans = [np.pad(grid.occupied(unknown), pad) for grid, pad in zip(grids, pads, strict=True)]
        plans.append(np.zeros((1, 1), dtype=bool))
        sides = [*(grid.resolution for grid in grids), 1.0]
        option, choice, least, options = [], [], [], 0
        for cells, side in zip(plans, sides, strict=True):
            nearest = nearest_boxes(cells)
            sets = np.concatenate(
                (np.repeat(np.arange(len(nearest.box))[:, None], CANDIDATES, 1), nearest.sets)
            )
            boxes = (2 * nearest.box)[sets].transpose(2, 1, 0).reshape(4 * CANDIDATES, -1)
            option.append(np.concatenate((boxes, nearest.sign[sets[:, 0]][None])).astype(np.float32))
            choice.append((nearest.choice + options).astype(np.int32).ravel())
            bound = (nearest.least - _ROUNDING) * side
            least.append(np.minimum(bound, max_distance).astype(np.float32).ravel())
            options += len(sets)
        begin = np.cumsum([0, *(4 * cells.size for cells in plans[:-1])])
        height, width = (2 * np.array([cells.shape for cells in plans])).T

        affine = np.zeros((6, len(plans)))
        for row, (grid, pad) in enumerate(zip(grids, pads, strict=True)):
            to_cell = grid.map_to_cell()
            affine[:, row] = 2 * np.array([*to_cell[0, :2], *to_cell[1, :2], *(to_cell[:, 2] + pad + 0.5)])
        return cls(
            option=torch.from_numpy(np.concatenate(option, axis=1)),
            choice=torch.from_numpy(np.concatenate(choice)),
            least=torch.from_numpy(np.concatenate(least)),
            affine=torch.from_numpy(affine),
            place=torch.from_numpy(np.stack((width, height, begin)).astype(np.int32)),
            side=torch.tensor(sides, dtype=torch.float64) / 2,
            limit=max_distance,
            outlines=Outlines(grids, unknown),
        )

    def to(self, device: torch.device | str) -> Walls:
        """Return the walls on a device: themselves where they are there already."""
        if self.choice.device == torch.device(device):
            return self
        tensors = ("option", "choice", "least", "affine", "place", "side")
        return replace(self, **{name: getattr(self, name).to(device) for name in tensors})

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """What compiled loops ask for distances: choices, options, lower bounds, and where distances end.

        Options lie in rows here: one agent's stand together in memory.
        """
        return self.choice.numpy(), self.option.t().contiguous().numpy(), self.least.numpy(), self.limit

    @cached_property
    def map_arrays(self) -> tuple[Any, ...]:
        """What the compiled planner reads: how the maps lie, and where a body has room.

        The latter has a bit for every quarter, and so is in the processor's cache.
        """
        clear = np.packbits(self.least.numpy() >= BODY_RADIUS, bitorder="little")
        return self.affine.numpy(), self.place.numpy(), self.side.numpy(), clear

    def segments(
        self,
        reach: float,
        most: int | None = None,
        hollows: bool = True,
        dtype: torch.dtype = torch.float32,
    ) -> SegmentTable:
        """Return the walls' outlines as segments in buckets, on the device of the walls, made once.

        Args:
            reach: Metres up to which segments are asked for.
            most: How many segments one position gets; None for all.
            hollows: Whether hollows that no body fits in have outlines, too.
            dtype: Of the positions.
        """
        return self.outlines.table(reach, most, hollows, self.choice.device, dtype)


_STEPS = 16
"""Of all rays, before it is asked whether one goes on: that waits for the device."""


@dataclass(frozen=True, eq=False)
class LocalWalls:
    """The walls as entries of any shape E see them, each on its map and in its scene's frame.

    Coordinates come first and entries last, (2, K, *E): on the CPU several times faster than pairs. Frames
    of shape (B, 1) serve the agents of B scenes, (B, A). No look-up but `cast` reads anything
    back to the host.

    Attributes:
        walls: Those of all maps.
        frame: Scene positions in metres to half cells of the padded map (7, *E). Two rows each say where the
            x axis points, where the y axis points, and the shift. The last row is half a cell's side, metres.
        place: Columns and rows of the map's quarters of cells, and where they begin (3, *E) int32.
    """

    walls: Walls
    frame: Tensor
    place: Tensor

    @classmethod
    def on_map(cls, walls: Walls, row: Tensor) -> LocalWalls:
        """Return the walls as they lie on the maps ``row`` (N,) long, -1 for none, in single precision."""
        row = row % walls.place.shape[1]
        xx, xy, yx, yy, x, y = walls.affine
        frame = torch.stack((xx, yx, xy, yy, x, y, walls.side)).float()
        return cls(walls, frame.index_select(1, row), walls.place.index_select(1, row))

    @classmethod
    def around(cls, walls: Walls, row: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries on maps ``row`` (N,) in poses (N, 4) see them."""
        row = row % walls.place.shape[1]
        pose = pose.double()
        # pose and map together are one affine from the scene to cells; see `pedzoo.core.geometry.move_to_map`
        affine = walls.affine.index_select(1, row).t()
        axes = affine[:, :4].view(-1, 2, 2).bmm(turn_matrix(pose))
        shift = torch.baddbmm(affine[:, 4:, None], axes, pose[:, 2:, None], alpha=-1)
        side = walls.side.index_select(0, row)[None]
        frame = torch.cat((axes.permute(2, 1, 0).flatten(0, 1), shift[..., 0].t(), side))
        return cls(walls, frame, walls.place.index_select(1, row))

    def select(self, index: Tensor) -> LocalWalls:
        """Return the walls as some of the N entries see them."""
        return LocalWalls(self.walls, self.frame.index_select(1, index), self.place.index_select(1, index))

    def per_scene(self) -> LocalWalls:
        """Return the walls of B scenes for all of their agents (B, A), in single precision."""
        return LocalWalls(self.walls, self.frame.float().unsqueeze(2), self.place.unsqueeze(2))

    def cells(self, points: Tensor) -> Tensor:
        """Return where on their maps scene positions (2, K, *E), metres, are: the same in half cells."""
        x_axis, y_axis, shift = self._single if points.dtype == torch.float32 else self._parts
        return torch.addcmul(torch.addcmul(shift, x_axis, points[0]), y_axis, points[1])

    def number(self, cells: Tensor) -> Tensor:
        """Return the numbers (K, *E) int32 of the quarters of positions (2, K, *E) in half cells."""
        column, row = cells.int().clamp(*self._ends)
        return torch.addcmul(column + self.place[2], row, self.place[0])

    def least(self, points: Tensor) -> Tensor:
        """Return how far from the nearest wall positions (2, K, *E) are at least (K, *E), quickly.

        That is the exact distance less up to 0.71 cells, 1.06 in walls, float32, at a tenth of the price;
        anything where a position is not a number.
        """
        return self.least_at(self.cells(points))

    def least_at(self, cells: Tensor) -> Tensor:
        """Return the same at positions (2, K, *E) in half cells."""
        number = self.number(cells)
        return self.walls.least.index_select(0, number.reshape(-1)).view(number.shape)

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance (N, ...) to the nearest wall and the direction (N, ..., 2) in which it grows.

        Computed in float64, returned in the type of ``points``; the gradient of the distance with respect to
        ``points`` is the direction. See `MapBank.closest_wall`.
        """
        with torch.no_grad():
            flat = points.double().reshape(len(points), math.prod(points.shape[1:-1]), 2)
            gap, away = self.look(flat.permute(2, 1, 0).contiguous())
            gap = gap.t().reshape(points.shape[:-1]).to(points.dtype)
            away = away.permute(2, 1, 0).reshape(points.shape).to(points.dtype)
        if points.requires_grad:
            gap = gap + ((points - points.detach()) * away).sum(dim=-1)
        return gap, away

    @torch.no_grad()
    def look(self, points: Tensor, edges: bool = True) -> tuple[Tensor, Tensor]:
        """Return distances (K, *E) and directions (2, K, *E) at points (2, K, *E), as `closest` does.

        Without ``edges`` the direction is zero on the very edge of a wall.
        """
        walls, side, place = self.walls, self.frame[6], self.cells(points)
        index = self.number(place)
        shape = index.shape
        choice = walls.choice.index_select(0, index.reshape(-1))
        option = walls.option.index_select(1, choice).to(place.dtype)
        corners, sign = option[:-1].view(2, 2, CANDIDATES, *shape), option[-1].view(shape)
        offset = place.unsqueeze(1) - place.unsqueeze(1).clamp(corners[0], corners[1])
        squared, best = torch.addcmul(offset[0] * offset[0], offset[1], offset[1]).min(dim=0)
        offset = offset.gather(1, best.expand(2, 1, *shape))[:, 0]
        depth = squared.sqrt()
        distance = depth * side.to(place.dtype)
        toward = sign * (distance < walls.limit)
        if edges:  # on the very edge of a box the direction is square to that edge
            edge = depth == 0
            low, high = corners.gather(2, best.expand(2, 2, 1, *shape))[:, :, 0]
            beyond = torch.maximum(low - place, place - high)
            square = torch.stack((beyond[0] >= beyond[1], beyond[0] < beyond[1]))
            offset = torch.where(edge, square * (2 * place - low - high).sign(), offset)
            depth = torch.where(edge, 1, depth)
        else:
            depth = depth.clamp_min(1e-9)
        # the way back from cells to the scene is the transposed one
        axes = (self._single if place.dtype == torch.float32 else self._parts)[:2]
        scaled = offset * (toward * side.to(place.dtype) / depth)
        away = torch.stack([torch.addcmul(axis[0] * scaled[0], axis[1], scaled[1]) for axis in axes])
        return distance.clamp_max(walls.limit) * sign, away

    def half_planes(self, points: Tensor, within: Tensor) -> Tensor:
        """Return distances to walls at points (2, *K, B, A), and what the walls leave free: (4, *K, B, A).

        First comes the distance, then a half-plane. Places p with n p > c are free: c, then x and y of n,
        which is where the distance grows. A wall farther away than ``within`` (B, A), metres, may be any
        distance above that away, with n = 0. That is what the compiled loops for single precision on the CPU
        say. No gradient flows.
        """
        shape = points.shape
        points = points.detach().reshape(2, -1, *shape[-2:])
        if compiles(points, within):
            from pedzoo.maps.walls_numba import look

            result = points.new_empty(4, *points.shape[1:])
            look(points.numpy(), within.numpy(), *self.arrays, result.numpy())
        else:
            gap, away = self.look(points, edges=False)
            result = torch.cat((torch.stack((gap, (points * away).sum(0) - gap)), away))
        return result.view(4, *shape[1:])

    @torch.no_grad()
    def cast(self, origin: Tensor, direction: Tensor, reach: float) -> Tensor:
        """Return how far rays go before they meet a wall (R, N), metres, ``reach`` where there is none.

        Rays begin at finite ``origin`` (2, R, N) along unit vectors (2, R, N). They leap by the lower bounds
        of distances, or go to the next quarter of a cell where that is farther. See Amanatides and Woo, "A
        Fast Voxel Traversal Algorithm for Ray Tracing", 1987.
        """
        origin = self.cells(origin.double())
        x_axis, y_axis, _ = self._parts
        direction = (x_axis * direction[0] + y_axis * direction[1]).double()
        # Along an axis a ray never leaves its line of cells; dividing by almost nothing says just that.
        direction = torch.where(direction.abs() < 1e-12, 1e-12, direction)
        length = torch.full_like(origin[0], reach)
        if length.device.type == "cpu":
            from pedzoo.maps.walls_numba import cast

            given = (origin, direction, self.walls.least, self.place, self.frame[6].double())
            cast(*(part.numpy() for part in given), reach, length.numpy())
            return length
        return self.traverse(origin, direction, reach)

    def traverse(self, origin: Tensor, direction: Tensor, reach: float) -> Tensor:
        """Do what `cast` does in torch; origins and directions (2, R, N) are in half cells."""
        length, side = torch.full_like(origin[0], reach), self.frame[6].double()
        ends = torch.stack((-origin, self.place[:2].unsqueeze(1) - origin)) / direction
        t, end = ends.amin(0).amax(0).clamp_min(0), ends.amax(0).amin(0).clamp_max(reach)
        while bool((t < end).any()):
            for _ in range(_STEPS):
                into = t + INTO * side
                cell = (origin + direction * into).floor().clamp(*self._ends)
                free = self.least_at(cell)
                hit = (t < end) & (free < WALL * side)
                entry = ((cell + (direction < 0) - origin) / direction).amax(0).clamp_min(0)
                length = torch.where(hit, entry, length)
                leaving = ((cell + (direction > 0) - origin) / direction).amin(0)
                t = torch.where(hit, math.inf, torch.maximum(torch.maximum(leaving, into), t + free))
        return length

    @cached_property
    def _parts(self) -> tuple[Tensor, ...]:
        """The x axis, the y axis and the shift, (2, 1, *E) each."""
        return self.frame[:6].view(3, 2, 1, *self.frame.shape[1:]).unbind()

    @cached_property
    def _single(self) -> tuple[Tensor, ...]:
        return self.frame[:6].float().view(3, 2, 1, *self.frame.shape[1:]).unbind()

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """What compiled look-ups read: frames of scenes (7, B, 1), places (3, B, 1), and tables."""
        return self.frame.numpy(), self.place.numpy(), *self.walls.arrays

    @cached_property
    def _ends(self) -> tuple[Tensor, Tensor]:
        """The first and last column and row, (2, 1, *E) each."""
        last = self.place[:2].unsqueeze(1) - 1
        return torch.zeros_like(last), last


@dataclass(frozen=True)
class Keeping:
    """What agents keep from walls.

    Attributes:
        reach: Metres (B, A). An agent that begins nearer to a wall may only move out.
        within: Metres (B, A) up to where walls matter in a stride.
        rounding: Metres by which an agent may be nearer than allowed where a stride ends.
        creep: Metres of a stride of an agent that is inside a wall.
    """

    reach: Tensor
    within: Tensor
    rounding: float
    creep: float


class WallsAhead:
    """The walls around agents (B, A) that go in strides from one place to the next.

    No gradient flows through the walls themselves.
    """

    def __init__(self, walls: LocalWalls, place: Tensor, keeping: Keeping) -> None:
        """Look at the places where agents begin (2, B, A), metres."""
        self._walls, self._keeping = walls, keeping
        # half-planes of the nearest wall and of that which the last stride ran into: see `half_planes`
        self._nearest = walls.half_planes(place, keeping.within)
        self._allowed = self._nearest[0].minimum(keeping.reach)
        self._nearest[1].add_(self._allowed)
        self._no_wall = self._nearest.new_zeros(4, 1, 1)
        self._no_wall[1] = -NO_WALL
        self._blocking = self._no_wall.expand_as(self._nearest)

    def target(self, place: Tensor, step: Tensor, length: Tensor) -> Tensor:
        """Return where agents at a place get by steps (2, B, A) of some lengths (B, A), metres.

        Near a wall a step is shortened, because a straight line must not cut a corner. Then it is projected
        on what the nearest wall leaves, and on what the wall leaves that the last stride ran into.
        """
        most = self._allowed.clamp_min(self._keeping.creep)
        place = torch.addcmul(place, step, (most / length).clamp_max(1))
        for wall in (self._nearest, self._blocking):
            bound, normal = wall[1], wall[2:]
            place = torch.addcmul(place, (bound - (place * normal).sum(0)).relu(), normal)
        return place

    def arrive(self, place: Tensor) -> Tensor:
        """Look around where a stride ends (2, B, A).

        Returns:
            1 for agents that may be there, 0 for those that are too near to a wall and go back (B, A).
        """
        keeping, allowed = self._keeping, self._allowed
        wall = self._walls.half_planes(place, keeping.within)
        gap = wall[0]
        stuck = gap < allowed - keeping.rounding
        self._allowed = gap.clamp(allowed, keeping.reach)
        wall[1].add_(self._allowed)
        self._blocking = torch.where(stuck, wall, self._no_wall)
        self._nearest = torch.where(stuck, self._nearest, wall)
        return (~stuck).to(place.dtype)
