"""Exact distances to walls made of square cells, for everybody on every floor plan in one call.

The field behind `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of a
cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pedzoo.maps.contenders import CONTENDERS, contenders
from pedzoo.maps.grid import OccupancyGrid, Unknown

_ROUNDING = 1e-4
"""Cells that single precision may err by."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each quarter of a cell those that may be nearest.

    Each map is padded by ``max_distance`` and cut into quarters of cells; see `pedzoo.maps.contenders` for
    which boxes contend in a quarter. The contending boxes of a position's quarter are compared.

    Attributes:
        option: Sets of contending boxes in columns (4 * CONTENDERS + 1, O) float32: all their x0, then all
            their y0, x1 and y1, in half cells from the padded map's outer corner; last, plus one where they
            are walls and minus one where they are free space.
        choice: Which set contends in each quarter, row by row, one map after another (Q,) int32.
        least: What any position in a quarter is away from the nearest wall, at least (Q,) float32, metres.
        affine: Map frame in metres to half cells of the padded map: column by column a matrix's two rows and
            two shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of quarters of each padded map, and where they begin (3, R + 1) int32.
        side: Of half a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres.
    """

    option: Tensor
    choice: Tensor
    least: Tensor
    affine: Tensor
    place: Tensor
    side: Tensor
    limit: float

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, max_distance: float) -> Walls:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        # Whoever is farther out than the padding has no wall within max_distance. "No map" is a last map of
        # one free cell that every position falls on: index -1 finds it.
        pads = [math.ceil(max_distance / grid.resolution) for grid in grids]
        plans = [np.pad(grid.occupied(unknown), pad) for grid, pad in zip(grids, pads, strict=True)]
        plans.append(np.zeros((1, 1), dtype=bool))
        sides = [*(grid.resolution for grid in grids), 1.0]
        option, choice, least, options = [], [], [], 0
        for cells, side in zip(plans, sides, strict=True):
            found = contenders(cells)
            sets = np.concatenate((np.repeat(np.arange(len(found.box))[:, None], CONTENDERS, 1), found.sets))
            boxes = (2 * found.box)[sets].transpose(2, 1, 0).reshape(4 * CONTENDERS, -1)
            option.append(np.concatenate((boxes, found.sign[sets[:, 0]][None])).astype(np.float32))
            choice.append((found.choice + options).astype(np.int32).ravel())
            bound = (found.least - _ROUNDING) * side
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
        )

    def to(self, device: torch.device | str) -> Walls:
        """Return the walls on a device: themselves where they are there already."""
        if self.choice.device == torch.device(device):
            return self
        parts = {part.name: getattr(self, part.name) for part in fields(self)}
        return Walls(**{key: part if key == "limit" else part.to(device) for key, part in parts.items()})

    def on_map(self, row: Tensor) -> LocalWalls:
        """Return the walls as they lie on the maps ``row`` (N,) long, -1 for none, in single precision."""
        row = row % self.place.shape[1]
        xx, xy, yx, yy, x, y = self.affine
        frame = torch.stack((xx, yx, xy, yy, x, y, self.side)).float()
        return LocalWalls(self, frame.index_select(1, row), self._quarters(row))

    def _quarters(self, row: Tensor) -> Quarters:
        return Quarters(self, self.place.index_select(1, row))

    def around(self, row: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries see them, to be asked any number of times.

        Args:
            row: Which map (N,) long, -1 for none.
            pose: Scene poses (N, 4).
        """
        row = row % self.place.shape[1]
        xx, xy, yx, yy, shift_x, shift_y = self.affine.index_select(1, row)
        angle, mirror, right, up = pose.double().unbind(1)
        # pose and map together are one affine from the scene to cells; see `pedzoo.geometry.move_to_map`
        c, s = angle.cos(), angle.sin()
        d, e = c * mirror, s * mirror
        home_x, home_y = c * right + s * up, d * up - e * right
        frame = (
            xx * c - xy * e,
            yx * c - yy * e,
            xx * s + xy * d,
            yx * s + yy * d,
            shift_x - xx * home_x - xy * home_y,
            shift_y - yx * home_x - yy * home_y,
            self.side.index_select(0, row),
        )
        return LocalWalls(self, torch.stack(frame), self._quarters(row))


@dataclass(frozen=True, eq=False)
class Quarters:
    """The quarters of cells that N entries are in, each on its map.

    Attributes:
        walls: Those of all maps.
        place: Columns and rows of quarters, and where the map's begin (3, N) int32.
    """

    walls: Walls
    place: Tensor

    def rows(self, index: Tensor) -> Quarters:
        """Return the quarters of some of the entries."""
        return Quarters(self.walls, self.place.index_select(1, index))

    def number(self, cells: Tensor) -> Tensor:
        """Return the numbers (K, N) int32 of the quarters of positions (2, K, N) in half cells."""
        column, row = cells.int().clamp(*self._ends)
        return torch.addcmul(column.add_(self.place[2]), row, self.place[0])

    def least(self, cells: Tensor) -> Tensor:
        """Return how far from the nearest wall positions (2, K, N) in half cells are at least (K, N)."""
        number = self.number(cells)
        return self.walls.least.index_select(0, number.view(-1)).view(number.shape)

    @cached_property
    def _ends(self) -> tuple[Tensor, Tensor]:
        """The first and last column and row, (2, 1, N) each."""
        last = self.place[:2].unsqueeze(1) - 1
        return torch.zeros_like(last), last


@dataclass(frozen=True, eq=False)
class LocalWalls:
    """The walls as N entries see them, each on its map and in its scene's frame.

    Coordinates come first and entries last, (2, K, N): on the CPU several times faster than pairs.

    Attributes:
        walls: Those of all maps.
        frame: Scene positions in metres to half cells of the padded map: where the x axis points, where the
            y axis points, and the shift, two rows each; then the side of half a cell in metres (7, N).
        quarters: The map's quarters of cells.
    """

    walls: Walls
    frame: Tensor
    quarters: Quarters

    def rows(self, index: Tensor) -> LocalWalls:
        """Return the walls as some of the entries see them."""
        return LocalWalls(self.walls, self.frame.index_select(1, index), self.quarters.rows(index))

    def each(self, times: int) -> LocalWalls:
        """Return the walls with so many entries, one after the other, for each of the N."""
        count = self.frame.shape[1]
        return self.rows(torch.arange(count, device=self.frame.device).repeat_interleave(times))

    def least(self, points: Tensor) -> Tensor:
        """Return how far from the nearest wall positions are at least (K, N), for a tenth of the price.

        That is the exact distance less up to 0.71 cells, float32; of a position that is not a number,
        anything.

        Args:
            points: Scene positions (2, K, N), metres.
        """
        return self.quarters.least(self.cells(points))

    def cells(self, points: Tensor) -> Tensor:
        """Return where on their maps scene positions (2, K, N), metres, are: the same in half cells."""
        frame = self._single if points.dtype == torch.float32 else self.frame
        x_axis, y_axis, shift = frame[:6].view(3, 2, 1, -1)
        return torch.addcmul(torch.addcmul(shift, x_axis, points[0]), y_axis, points[1])

    @torch.no_grad()
    def within(self, path: Tensor, distance: float) -> Tensor:
        """Return which stretches of paths come closer than ``distance`` to a wall (S, N) bool.

        The point in the middle of a stretch is asked about first, roughly.

        Args:
            path: Scene positions (2, S, M, N), metres: S stretches of M points that are near each other.
            distance: Metres.
        """
        points = path.shape[2]
        middle = path[:, :, points // 2]
        spread = (path - middle.unsqueeze(2)).abs_().amax(2)
        close = self.least(middle) < torch.hypot(*spread) + distance
        stretch, entry = close.nonzero(as_tuple=True)
        if len(stretch):
            point = torch.arange(points, device=path.device).unsqueeze(1)
            index = (stretch * points + point) * close.shape[1] + entry
            asked = path.flatten(1).index_select(1, index.view(-1)).view(2, *index.shape)
            gap, _ = self.rows(entry).look(asked.double())
            close = close.index_put((stretch, entry), (gap < distance).any(0))
        return close

    @cached_property
    def _single(self) -> Tensor:
        return self.frame.float()

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance (N, ...) to the nearest wall and the direction (N, ..., 2) in which it grows.

        Computed in float64, returned in the type of ``points``; the gradient of the distance with respect to
        ``points`` is the direction. See `MapBank.closest_wall`.

        Args:
            points: Scene positions (N, ..., 2), metres.
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
    def look(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return distances (K, N) and directions (2, K, N), as `closest` does.

        Args:
            points: Scene positions (2, K, N) float64, metres.
        """
        walls, side, place = self.walls, self.frame[6], self.cells(points)
        index = self.quarters.number(place)
        shape = index.shape
        choice = walls.choice.index_select(0, index.view(-1))
        option = walls.option.index_select(1, choice).double()
        corners, sign = option[:-1].view(2, 2, CONTENDERS, *shape), option[-1].view(shape)
        apart = place.unsqueeze(1) - place.unsqueeze(1).clamp(corners[0], corners[1])
        squared, best = torch.addcmul(apart[0] * apart[0], apart[1], apart[1]).min(dim=0)
        apart = apart.gather(1, best.expand(2, 1, *shape))[:, 0]
        depth = squared.sqrt()
        distance = depth * side
        toward = sign * (distance < walls.limit)
        edge = depth == 0
        if bool(edge.any()):  # on the very edge of a box the direction is square to that edge
            low, high = corners.gather(2, best.expand(2, 2, 1, *shape))[:, :, 0]
            beyond = torch.maximum(low - place, place - high)
            square = torch.stack((beyond[0] >= beyond[1], beyond[0] < beyond[1]))
            apart = torch.where(edge, square * (2 * place - low - high).sign(), apart)
            depth = torch.where(edge, 1, depth)
        # the way back from cells to the scene is the transposed one
        axes = self.frame[:4].view(2, 2, 1, -1)
        away = (axes * (apart * (toward * side / depth))).sum(1)
        return distance.clamp_max(walls.limit) * sign, away
