"""Walls as people see them, each from their scene on its map: rough bounds, and exact distances."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pedzoo.maps.contenders import CONTENDERS
from pedzoo.maps.walls import Walls


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

    @classmethod
    def on_map(cls, walls: Walls, row: Tensor) -> LocalWalls:
        """Return the walls as they lie on the maps ``row`` (N,) long, -1 for none, in single precision."""
        row = row % walls.place.shape[1]
        xx, xy, yx, yy, x, y = walls.affine
        frame = torch.stack((xx, yx, xy, yy, x, y, walls.side)).float()
        return cls(walls, frame.index_select(1, row), Quarters(walls, walls.place.index_select(1, row)))

    @classmethod
    def around(cls, walls: Walls, row: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries see them, to be asked any number of times.

        Args:
            walls: Those of all maps.
            row: Which map (N,) long, -1 for none.
            pose: Scene poses (N, 4).
        """
        row = row % walls.place.shape[1]
        xx, xy, yx, yy, shift_x, shift_y = walls.affine.index_select(1, row)
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
            walls.side.index_select(0, row),
        )
        return cls(walls, torch.stack(frame), Quarters(walls, walls.place.index_select(1, row)))

    def rows(self, index: Tensor) -> LocalWalls:
        """Return the walls as some of the entries see them."""
        return LocalWalls(self.walls, self.frame.index_select(1, index), self.quarters.rows(index))

    def each(self, times: int) -> LocalWalls:
        """Return the walls with so many entries, one after the other, for each of the N."""
        count = self.frame.shape[1]
        return self.rows(torch.arange(count, device=self.frame.device).repeat_interleave(times))

    def least(self, points: Tensor) -> Tensor:
        """Return how far from the nearest wall positions are at least (K, N), for a tenth of the price.

        That is the exact distance less up to 0.71 cells, 1.06 in walls, float32; anything where a position is
        not a number.

        Args:
            points: Scene positions (2, K, N), metres.
        """
        return self.quarters.least(self.cells(points))

    def cells(self, points: Tensor) -> Tensor:
        """Return where on their maps scene positions (2, K, N), metres, are: the same in half cells."""
        x_axis, y_axis, shift = self._single if points.dtype == torch.float32 else self._parts
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
    def _parts(self) -> tuple[Tensor, ...]:
        """The x axis, the y axis and the shift, (2, 1, N) each."""
        return self.frame[:6].view(3, 2, 1, -1).unbind()

    @cached_property
    def _single(self) -> tuple[Tensor, ...]:
        return self.frame[:6].float().view(3, 2, 1, -1).unbind()

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
