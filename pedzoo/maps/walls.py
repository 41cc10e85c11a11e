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

from pedzoo.geometry import move_to_map, turn_to_map
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

    def around(self, row: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries see them, to be asked any number of times.

        Args:
            row: Which map (N,) long, -1 for none.
            pose: Scene poses (N, 4).
        """
        row, pose = row % self.place.shape[1], pose.double()
        xx, xy, yx, yy, shift_x, shift_y = self.affine.index_select(1, row)
        # pose and map together are one affine from the scene to cells
        axes = torch.eye(2, dtype=pose.dtype, device=pose.device).expand(len(pose), 2, 2)
        (ax, ay), (bx, by) = turn_to_map(axes, pose).permute(1, 2, 0)
        home_x, home_y = move_to_map(pose.new_zeros(len(pose), 2), pose).unbind(1)
        affine = (
            xx * ax + xy * ay,
            xx * bx + xy * by,
            yx * ax + yy * ay,
            yx * bx + yy * by,
            xx * home_x + xy * home_y + shift_x,
            yx * home_x + yy * home_y + shift_y,
        )
        columns, lines, begin = (values.unsqueeze(1) for values in self.place.index_select(1, row))
        resolution = self.resolution.index_select(0, row).unsqueeze(1)
        return LocalWalls(
            self, tuple(part.unsqueeze(1) for part in affine), columns, lines, begin, resolution
        )


@dataclass(frozen=True, eq=False)
class LocalWalls:
    """The walls as N entries see them, each on its map and in its scene's frame.

    Attributes:
        walls: Those of all maps.
        affine: Scene positions in metres to cells of the padded map: two rows and two shifts (6, N, 1).
        columns: Of the padded map (N, 1).
        lines: Its rows (N, 1).
        begin: Where its cells begin (N, 1).
        resolution: Side of a cell in metres (N, 1).
    """

    walls: Walls
    affine: tuple[Tensor, ...]
    columns: Tensor
    lines: Tensor
    begin: Tensor
    resolution: Tensor

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance (N, ...) to the nearest wall and the direction (N, ..., 2) in which it grows.

        Computed in float64, returned in the type of ``points``; the gradient of the distance with respect to
        ``points`` is the direction. See `MapBank.closest_wall`.

        Args:
            points: Scene positions (N, ..., 2), metres.
        """
        with torch.no_grad():
            flat = points.double().reshape(len(points), math.prod(points.shape[1:-1]), 2)
            distance, away = self._look(*flat.unbind(2))
            distance = distance.view(points.shape[:-1]).to(points.dtype)
            away = away.view(points.shape).to(points.dtype)
        if points.requires_grad:
            distance = distance + ((points - points.detach()) * away).sum(dim=-1)
        return distance, away

    def _look(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        # Coordinates (N, K) are handled one by one: on the CPU several times faster than pairs of them.
        walls, columns, lines, begin = self.walls, self.columns, self.lines, self.begin
        xx, xy, yx, yy, shift_x, shift_y = self.affine
        x, y = xx * x + xy * y + shift_x, yx * x + yy * y + shift_y
        column = (x * 2).long().clamp_min(0).minimum(2 * columns - 1)
        line = (y * 2).long().clamp_min(0).minimum(2 * lines - 1)
        inside = _at(walls.wall, begin + (line >> 1) * columns + (column >> 1))
        choice = _at(walls.choice, 4 * begin + line * (2 * columns) + column)
        around = torch.stack([_at(boxes, choice) for boxes in walls.option])
        x0, y0, x1, y1 = (_at(values, around) for values in walls.box)
        dx, dy = x - x.clamp(x0, x1), y - y.clamp(y0, y1)
        squared, best = (dx.square() + dy.square()).min(dim=0)
        best = best.unsqueeze(0)
        dx, dy = dx.gather(0, best)[0], dy.gather(0, best)[0]
        depth = squared.sqrt()
        edge = depth == 0
        if bool(edge.any()):  # on the very edge of a box the direction is square to that edge
            x0, y0, x1, y1 = (values.gather(0, best)[0] for values in (x0, y0, x1, y1))
            along_x = torch.maximum(x0 - x, x - x1) >= torch.maximum(y0 - y, y - y1)
            dx = torch.where(edge, along_x * (2 * x - x0 - x1).sign(), dx)
            dy = torch.where(edge, ~along_x * (2 * y - y0 - y1).sign(), dy)
        distance = depth * self.resolution
        sign = 1 - 2 * inside.double()
        scale = torch.where(distance < walls.limit, sign * self.resolution, 0) / torch.where(edge, 1, depth)
        away = torch.stack(((xx * dx + yx * dy) * scale, (xy * dx + yy * dy) * scale), dim=2)
        return distance.minimum(walls.limit) * sign, away


def _at(values: Tensor, index: Tensor) -> Tensor:
    # values[index], several times faster on the CPU
    return values.index_select(0, index.view(-1)).view(index.shape)
