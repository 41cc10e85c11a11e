"""Exact distances to walls made of square cells, for everybody on every floor plan in one call.

The distance field of `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of
a cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pedzoo.geometry import move_to_map, turn_to_map
from pedzoo.maps.boxes import merge_cells
from pedzoo.maps.grid import OccupancyGrid, Unknown

FAR = 1e9
"""Where, in cells, the walls of a map without walls are."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each place the few that can be the nearest.

    Places are looked up on a lattice of half cells, the outermost ``max_distance`` beyond the map: the nearest
    box of a lattice point is stored there, and around a position the boxes of the nearest lattice points are
    compared. Lattice points see corners and edges of squares exactly, because those are lattice points, too.

    Attributes:
        box: Boxes of all maps (M, 4) float64, x0, y0, x1, y1 in cells from the outer corner of the padded map.
        nearest: Box nearest to each lattice point, of the walls and then of the free space, one map after
            another (L,) int32.
        wall: Whether each cell of the padded maps is a wall, one map after another (C,) bool.
        linear: Map frame in metres to cells of the padded map (R + 1, 2, 2) float64; row -1 means "no map".
        shift: The same transform's constant part (R + 1, 2) float64.
        size: Columns and rows of each padded map (R + 1, 2) long.
        start: Where the map begins in ``nearest`` and in ``wall`` (R + 1, 2) long.
        resolution: Side of a cell in metres (R + 1,) float64.
        max_distance: Distances are clipped to plus and minus this, metres.
    """

    box: Tensor
    nearest: Tensor
    wall: Tensor
    linear: Tensor
    shift: Tensor
    size: Tensor
    start: Tensor
    resolution: Tensor
    max_distance: float

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, max_distance: float) -> Walls:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        box, nearest, wall, size, start = [], [], [], [], []
        # Whoever is farther out than the padding has no wall within max_distance.
        pads = [math.ceil(max_distance / grid.resolution) for grid in grids]
        # "No map" is a last map of one free cell that every position falls on: index -1 finds it.
        plans = [(grid.occupied(unknown), pad) for grid, pad in zip(grids, pads, strict=True)]
        plans.append((np.zeros((1, 1), dtype=bool), 0))
        for cells, pad in plans:
            cells = np.pad(cells, pad)
            start.append((sum(map(len, nearest)), sum(map(len, wall))))
            for side in (cells, ~cells):
                parts, labels = _nearest_box(side)
                nearest.append(labels.ravel() + sum(map(len, box)))
                box.append(parts)
            wall.append(cells.ravel())
            size.append(cells.shape[::-1])
        affine = [grid.map_to_cell() + [[0, 0, pad + 0.5]] for grid, pad in zip(grids, pads, strict=True)]
        affine = np.stack([*affine, np.zeros((2, 3))])
        return cls(
            box=torch.from_numpy(np.concatenate(box)),
            nearest=torch.from_numpy(np.concatenate(nearest).astype(np.int32)),
            wall=torch.from_numpy(np.concatenate(wall)),
            linear=torch.from_numpy(affine[:, :, :2].copy()),
            shift=torch.from_numpy(affine[:, :, 2].copy()),
            size=torch.tensor(size),
            start=torch.tensor(start),
            resolution=torch.tensor([*(grid.resolution for grid in grids), 1.0], dtype=torch.float64),
            max_distance=max_distance,
        )

    def to(self, device: torch.device | str) -> Walls:
        """Return the walls on a device: themselves where they are there already."""
        if self.box.device == torch.device(device):
            return self
        parts = (self.box, self.nearest, self.wall, self.linear)
        parts += (self.shift, self.size, self.start, self.resolution)
        return Walls(*(part.to(device) for part in parts), max_distance=self.max_distance)

    def closest(self, points: Tensor, row: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance to the nearest wall and the direction in which it grows.

        Computed in float64 and returned in the type of ``points``; the gradient of the distance with respect
        to ``points`` is ``away``. See `MapBank.closest_wall`.

        Args:
            points: Scene positions (N, ..., 2), metres.
            row: Which map (N,) long, -1 for none.
            pose: Scene poses (N, 4).
        """
        with torch.no_grad():
            distance, away = self._look(points.double().view(len(points), -1, 2), row, pose.double())
            distance = distance.view(points.shape[:-1]).to(points.dtype)
            away = away.view(points.shape).to(points.dtype)
        if points.requires_grad:
            distance = distance + ((points - points.detach()) * away).sum(dim=-1)
        return distance, away

    def _look(self, points: Tensor, row: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        # Pose and map together are one affine per entry, from the scene to cells of the padded map.
        turn = turn_to_map(torch.eye(2, dtype=pose.dtype, device=pose.device).expand(len(pose), 2, 2), pose)
        home = move_to_map(pose.new_zeros(len(pose), 2), pose)
        linear = self.linear[row]
        shift = self.shift[row] + (linear @ home.unsqueeze(2)).squeeze(2)
        linear = turn @ linear.transpose(1, 2)  # (N, from scene axis, to cell axis)
        place = (points.unsqueeze(3) * linear.unsqueeze(1)).sum(dim=2) + shift.unsqueeze(1)

        size, start = self.size[row].unsqueeze(1), self.start[row].unsqueeze(1)
        zero = torch.zeros_like(size)
        half = (place * 2).floor().long().clamp(zero, 2 * size - 1)
        column, line = (half // 2).unbind(2)
        inside = self.wall[start[..., 1] + line * size[..., 0] + column]

        # the four lattice points around, each with the box of the other kind that is nearest to it
        stride = 2 * size[..., 0] + 1
        count = stride * (2 * size[..., 1] + 1)
        first = start[..., 0] + inside * count + half[..., 1] * stride + half[..., 0]
        around = torch.stack((first, first + 1, first + stride, first + stride + 1), dim=-1)
        box = F.embedding(self.nearest[around], self.box)
        here = place.unsqueeze(2)
        offset = here - here.clamp(box[..., :2], box[..., 2:])
        squared, best = offset.square().sum(dim=-1).min(dim=-1)
        best = best[..., None, None]
        offset = offset.take_along_dim(best, dim=2).squeeze(2)
        depth = squared.sqrt()

        # On the very edge of a box the direction is that of the edge.
        box = box.take_along_dim(best, dim=2).squeeze(2)
        beyond = torch.maximum(box[..., :2] - place, place - box[..., 2:])
        normal = F.one_hot(beyond.argmax(dim=-1), 2) * (place * 2 - box[..., :2] - box[..., 2:]).sign()
        away = torch.where(depth.unsqueeze(2) > 0, offset / depth.unsqueeze(2), normal)

        sign = torch.where(inside, -1.0, 1.0)
        distance = depth * self.resolution[row].unsqueeze(1)
        reached = (distance < self.max_distance) * sign
        away = (away.unsqueeze(2) * linear.unsqueeze(1)).sum(dim=3) * self.resolution[row].view(-1, 1, 1)
        return distance.clamp_max(self.max_distance) * sign, away * reached.unsqueeze(2)


def _nearest_box(cells: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return boxes (M, 4) of the true cells (H, W) and the nearest of each lattice point (2H + 1, 2W + 1)."""
    from scipy.ndimage import distance_transform_edt

    parts = merge_cells(cells)
    if not len(parts):
        return np.full((1, 4), FAR), np.zeros([2 * n + 1 for n in cells.shape], dtype=np.int64)
    rim = np.full(np.add(cells.shape, 2), -1)
    for number, (x0, y0, x1, y1) in enumerate(parts):
        rim[y0 + 1 : y1 + 1, x0 + 1 : x1 + 1] = number
    # A lattice point belongs to all cells that it touches: one between two of them, a corner of four.
    touched = np.repeat(np.repeat(rim, 2, axis=0), 2, axis=1)
    touched = np.maximum(touched[1:-2], touched[2:-1])
    touched = np.maximum(touched[:, 1:-2], touched[:, 2:-1])
    line, column = np.asarray(
        distance_transform_edt(touched < 0, return_distances=False, return_indices=True)
    )
    return parts.astype(np.float64), touched[line, column]
