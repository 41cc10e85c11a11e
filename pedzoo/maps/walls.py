"""Exact distances to walls made of square cells, for everybody on every floor plan in one call.

The field behind `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of a
cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.geometry import move_to_map, turn_to_scene
from pedzoo.maps.boxes import merge_cells
from pedzoo.maps.grid import OccupancyGrid, Unknown

FAR = 1e9
"""Where, in cells, the walls of a map without walls are."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each place the few of them that can be the nearest.

    Each map is padded by ``max_distance``. On a lattice of half cells the nearest box of every lattice point
    is known; for a position the boxes of the four lattice points around it are compared. Corners and middles
    of cells are lattice points themselves, which makes this exact beside walls; farther away a fifth box may
    be nearer by a small fraction of a cell.

    Attributes:
        box: Boxes of all maps (4, M) float64: x0, y0, x1, y1 in cells from the padded map's outer corner.
        nearest: Box nearest to each lattice point, of the walls and then of the free space, one map after
            another (L,) int32.
        wall: Whether each cell of the padded maps is a wall, one map after another (C,) bool.
        affine: Map frame in metres to cells of the padded map: column by column a matrix's two rows and two
            shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of each padded map, where it begins in ``nearest`` and in ``wall``
            (4, R + 1) long.
        resolution: Side of a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres () float64.
    """

    box: Tensor
    nearest: Tensor
    wall: Tensor
    affine: Tensor
    place: Tensor
    resolution: Tensor
    limit: Tensor

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, max_distance: float) -> Walls:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        # Whoever is farther out than the padding has no wall within max_distance. "No map" is a last map of
        # one free cell that every position falls on: index -1 finds it.
        pads = [math.ceil(max_distance / grid.resolution) for grid in grids]
        plans = [np.pad(grid.occupied(unknown), pad) for grid, pad in zip(grids, pads, strict=True)]
        plans.append(np.zeros((1, 1), dtype=bool))
        box, nearest, wall, place = [], [], [], []
        for cells in plans:
            place.append((*cells.shape[::-1], sum(map(len, nearest)), sum(map(len, wall))))
            for side in (cells, ~cells):
                parts, labels = _nearest_box(side)
                nearest.append((labels + sum(map(len, box))).astype(np.int32).ravel())
                box.append(parts)
            wall.append(cells.ravel())
        affine = np.zeros((6, len(plans)))
        for row, (grid, pad) in enumerate(zip(grids, pads, strict=True)):
            to_cell = grid.map_to_cell()
            affine[:, row] = [*to_cell[0, :2], *to_cell[1, :2], *(to_cell[:, 2] + pad + 0.5)]
        return cls(
            box=torch.from_numpy(np.concatenate(box).T.copy()),
            nearest=torch.from_numpy(np.concatenate(nearest)),
            wall=torch.from_numpy(np.concatenate(wall)),
            affine=torch.from_numpy(affine),
            place=torch.tensor(place).T.contiguous(),
            resolution=torch.tensor([*(grid.resolution for grid in grids), 1.0], dtype=torch.float64),
            limit=torch.tensor(max_distance, dtype=torch.float64),
        )

    def to(self, device: torch.device | str) -> Walls:
        """Return the walls on a device: themselves where they are there already."""
        if self.box.device == torch.device(device):
            return self
        return Walls(**{part.name: getattr(self, part.name).to(device) for part in fields(self)})

    def closest(self, points: Tensor, row: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance to the nearest wall and the direction in which it grows.

        Computed in float64, returned in the type of ``points``; the gradient of the distance with respect to
        ``points`` is the direction. See `MapBank.closest_wall`.

        Args:
            points: Scene positions (N, ..., 2), metres.
            row: Which map (N,) long, -1 for none.
            pose: Scene poses (N, 4).

        Returns:
            Distance (N, ...) and direction (N, ..., 2).
        """
        with torch.no_grad():
            row, exact = row % self.place.shape[1], pose.double()
            flat = points.double().reshape(len(points), math.prod(points.shape[1:-1]), 2)
            distance, away = self._look(move_to_map(flat, exact), row)
            distance = distance.view(points.shape[:-1]).to(points.dtype)
            away = turn_to_scene(away, exact).view(points.shape).to(points.dtype)
        if points.requires_grad:
            distance = distance + ((points - points.detach()) * away).sum(dim=-1)
        return distance, away

    def _look(self, points: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        # The same for map-frame positions (N, K, 2). Coordinates are handled one by one: on the CPU that is
        # several times faster than pairs of them.
        xx, xy, yx, yy, shift_x, shift_y = self.affine.index_select(1, row).unsqueeze(2)
        x, y = points.unbind(2)
        x, y = xx * x + xy * y + shift_x, yx * x + yy * y + shift_y
        columns, lines, lattice, cells = self.place.index_select(1, row).unsqueeze(2)
        zero = torch.zeros_like(columns)
        column = (x * 2).long().clamp(zero, 2 * columns - 1)
        line = (y * 2).long().clamp(zero, 2 * lines - 1)
        inside = _at(self.wall, cells + (line >> 1) * columns + (column >> 1))

        # the boxes of the other kind that are nearest to the four lattice points around
        stride = 2 * columns + 1
        first = lattice + line * stride + column + inside * (stride * (2 * lines + 1))
        around = _at(self.nearest, torch.stack((first, first + 1, first + stride, first + stride + 1)))
        beyond_x = torch.maximum(_at(self.box[0], around) - x, x - _at(self.box[2], around)).clamp_min(0)
        beyond_y = torch.maximum(_at(self.box[1], around) - y, y - _at(self.box[3], around)).clamp_min(0)
        squared, best = (beyond_x.square() + beyond_y.square()).min(dim=0)
        x0, y0, x1, y1 = self.box.index_select(1, around.gather(0, best[None]).view(-1)).view(4, *x.shape)

        depth = squared.sqrt()
        dx, dy = x - x.clamp(x0, x1), y - y.clamp(y0, y1)
        # On the very edge of a box the direction is square to that edge.
        edge = depth == 0
        along_x = torch.maximum(x0 - x, x - x1) >= torch.maximum(y0 - y, y - y1)
        dx = torch.where(edge, along_x * (2 * x - x0 - x1).sign(), dx / depth)
        dy = torch.where(edge, ~along_x * (2 * y - y0 - y1).sign(), dy / depth)

        resolution = self.resolution.index_select(0, row).unsqueeze(1)
        sign = 1 - 2 * inside.double()
        distance = depth * resolution
        scale = torch.where(distance < self.limit, sign * resolution, 0)
        away = torch.stack(((xx * dx + yx * dy) * scale, (xy * dx + yy * dy) * scale), dim=2)
        return distance.minimum(self.limit) * sign, away


def _at(values: Tensor, index: Tensor) -> Tensor:
    # values[index], several times faster on the CPU
    return values.index_select(0, index.view(-1)).view(index.shape)


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
