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
from torch import Tensor

from pedzoo.geometry import move_to_map, turn_to_scene
from pedzoo.maps.contenders import CONTENDERS, contenders
from pedzoo.maps.grid import OccupancyGrid, Unknown


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each quarter of a cell those that may be nearest.

    Each map is padded by ``max_distance`` and cut into quarters of cells; see `pedzoo.maps.contenders` for
    which boxes contend in a quarter. The contending boxes of a position's quarter are compared.

    Attributes:
        box: Boxes of all maps (4, M) float64: x0, y0, x1, y1 in cells from the padded map's outer corner.
        option: Sets of contending boxes (CONTENDERS, O) int32; the first M are one box each.
        choice: Which set contends in each quarter, row by row, one map after another (Q,) int32.
        wall: Whether each cell is a wall, one map after another (C,) bool.
        affine: Map frame in metres to cells of the padded map: column by column a matrix's two rows and two
            shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of each padded map, and where it begins in ``wall`` (3, R + 1) long.
        resolution: Side of a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres () float64.
    """

    box: Tensor
    option: Tensor
    choice: Tensor
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
        found = [contenders(cells) for cells in plans]
        boxes = np.concatenate([one.box for one in found])
        first_box = np.cumsum([0, *(len(one.box) for one in found)])
        first_set = len(boxes) + np.cumsum([0, *(len(one.sets) for one in found)])
        sets = [one.sets + start for one, start in zip(found, first_box, strict=False)]
        choice = [
            np.where(one.choice < len(one.box), one.choice + box, one.choice - len(one.box) + rest).ravel()
            for one, box, rest in zip(found, first_box, first_set, strict=False)
        ]
        option = np.concatenate((np.repeat(np.arange(len(boxes))[:, None], CONTENDERS, axis=1), *sets))
        begin = np.cumsum([0, *(cells.size for cells in plans[:-1])])
        place = [(*cells.shape[::-1], start) for cells, start in zip(plans, begin, strict=True)]

        affine = np.zeros((6, len(plans)))
        for row, (grid, pad) in enumerate(zip(grids, pads, strict=True)):
            to_cell = grid.map_to_cell()
            affine[:, row] = [*to_cell[0, :2], *to_cell[1, :2], *(to_cell[:, 2] + pad + 0.5)]
        return cls(
            box=torch.from_numpy(boxes.T.copy()),
            option=torch.from_numpy(option.T.astype(np.int32)),
            choice=torch.from_numpy(np.concatenate(choice).astype(np.int32)),
            wall=torch.from_numpy(np.concatenate([cells.ravel() for cells in plans])),
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
        xx, xy, yx, yy, shift_x, shift_y = (_at(values, row[:, None]) for values in self.affine)
        x, y = points.unbind(2)
        x, y = xx * x + xy * y + shift_x, yx * x + yy * y + shift_y
        columns, lines, begin = (_at(values, row[:, None]) for values in self.place)
        zero = torch.zeros_like(columns)
        column = (x * 2).long().clamp(zero, 2 * columns - 1)
        line = (y * 2).long().clamp(zero, 2 * lines - 1)
        inside = _at(self.wall, begin + (line >> 1) * columns + (column >> 1))
        choice = _at(self.choice, 4 * begin + line * (2 * columns) + column)
        around = torch.stack([_at(boxes, choice) for boxes in self.option])
        beyond_x = torch.maximum(_at(self.box[0], around) - x, x - _at(self.box[2], around)).clamp_min(0)
        beyond_y = torch.maximum(_at(self.box[1], around) - y, y - _at(self.box[3], around)).clamp_min(0)
        squared, best = (beyond_x.square() + beyond_y.square()).min(dim=0)
        nearest = around.gather(0, best[None])[0]
        x0, y0, x1, y1 = (_at(values, nearest) for values in self.box)

        depth = squared.sqrt()
        dx, dy = x - x.clamp(x0, x1), y - y.clamp(y0, y1)
        # On the very edge of a box the direction is square to that edge.
        edge = depth == 0
        along_x = torch.maximum(x0 - x, x - x1) >= torch.maximum(y0 - y, y - y1)
        dx = torch.where(edge, along_x * (2 * x - x0 - x1).sign(), dx / depth)
        dy = torch.where(edge, ~along_x * (2 * y - y0 - y1).sign(), dy / depth)

        resolution = _at(self.resolution, row[:, None])
        sign = 1 - 2 * inside.double()
        distance = depth * resolution
        scale = torch.where(distance < self.limit, sign * resolution, 0)
        away = torch.stack(((xx * dx + yx * dy) * scale, (xy * dx + yy * dy) * scale), dim=2)
        return distance.minimum(self.limit) * sign, away


def _at(values: Tensor, index: Tensor) -> Tensor:
    # values[index], several times faster on the CPU
    return values.index_select(0, index.view(-1)).view(index.shape)
