"""Walls as agents see them, each from their scene on its map: lower bounds, and exact distances."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.geometry import turn_matrix
from pedzoo.core.machine import compiles
from pedzoo.maps.walls.constants import INTO, WALL
from pedzoo.maps.walls.nearest_boxes import CANDIDATES
from pedzoo.maps.walls.walls import Walls

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
            from pedzoo.maps.walls.compiled_walls import look

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
            from pedzoo.maps.walls.compiled_walls import cast

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
