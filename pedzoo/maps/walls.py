"""Walls as agents see them: exact distances, what they leave free, rays, and the nearest segments.

The field behind `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of a
cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.geometry import turn_matrix
from pedzoo.core.machine import compiles
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.constants import CANDIDATES
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.segments import Floats, Numbers, SegmentTable, borders, edges, outlines, without_hollows

_ROUNDING = 1e-4  # cells that single precision may err by


_NOWHERE = 1e9  # cells: where the walls of a map without walls are
_CHUNK = 1 << 16


def nearest_edges(walls: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int32], NDArray[np.float32]]:
    """Return which edges of the borders can be the nearest one of each quarter of a cell (H, W).

    Edges and quarters lie on one lattice, so a quarter is wholly beside, before or at a corner of every edge.
    The difference of the squared distances to two edges is then a monotonic function of x plus one of y,
    largest and smallest at the quarter's corners. So an edge that is no nearer than another at all four
    corners is no nearer anywhere between.

    * The edge nearest to all four corners is the nearest of the whole quarter.
    * Otherwise those nearest to one of the sixteen corners of the quarter and its neighbours compete, less
      those that another beats at all four. An edge is missed if its region lies between corners of two
      quarters in a row without holding any; tests count how rare that is.

    Returns:
        Sets of edges that compete (S, CANDIDATES, 4), repeated where they are fewer: x0, y0, x1, y1 in cells.
        Then the set of each quarter (2H, 2W), -1 less the set inside walls; and what any place in a quarter
        is away from the border, at least, negative inside walls, in cells.
    """
    from scipy.ndimage import distance_transform_edt

    sides = [np.hstack((border, np.roll(border, -1, axis=0))) for border in borders(walls)]
    edge = np.concatenate([np.zeros((0, 4), dtype=np.int64), *sides])
    edge = np.hstack((np.minimum(edge[:, :2], edge[:, 2:]), np.maximum(edge[:, :2], edge[:, 2:])))
    size = [2 * side + 1 for side in walls.shape]
    if len(edge):
        edge = edge[np.lexsort(edge.T[::-1])]
        label = np.full(size, -1, dtype=np.int32)
        for number, (x0, y0, x1, y1) in enumerate(2 * edge):
            label[y0 : y1 + 1, x0 : x1 + 1] = number
        row, column = np.asarray(
            distance_transform_edt(label < 0, return_distances=False, return_indices=True)
        )
        y = (row - np.arange(size[0], dtype=np.int32)[:, None]).astype(np.float32)
        x = (column - np.arange(size[1], dtype=np.int32)).astype(np.float32)
        label, gap = label[row, column], np.hypot(x, y, out=x) / 2
    else:
        edge, label = np.full((1, 4), int(_NOWHERE)), np.zeros(size, dtype=np.int32)
        gap = np.full(size, math.hypot(_NOWHERE, _NOWHERE), dtype=np.float32)

    corners, gaps = ([part[:-1, :-1], part[:-1, 1:], part[1:, :-1], part[1:, 1:]] for part in (label, gap))
    mixed = np.nonzero(np.any([corner != corners[0] for corner in corners[1:]], axis=0))
    around, sets = np.pad(label, 1, mode="edge"), [np.repeat(np.arange(len(edge))[:, None], CANDIDATES, 1)]
    for start in range(0, len(mixed[0]), _CHUNK):
        row, column = (axis[start : start + _CHUNK] for axis in mixed)
        near = np.stack([around[row + i, column + j] for i in range(4) for j in range(4)], axis=1)
        sets.append(_unbeaten(near, edge, row, column))
    choice = label[:-1, :-1].copy()
    choice[mixed] = len(edge) + np.arange(len(mixed[0]))
    every = np.concatenate(sets)
    order = np.lexsort(every.T)
    differs, number = np.diff(every[order], axis=0, prepend=-1).any(axis=1), np.empty(len(every), np.int32)
    number[order] = differs.cumsum() - 1
    choice = number[choice]
    inside = walls.repeat(2, axis=0).repeat(2, axis=1)
    # distances are least at a corner; inside walls a place is at most half a quarter's diagonal deeper
    deepest = -np.max(gaps, axis=0) - np.float32(math.sqrt(0.125))
    least = np.where(inside, deepest, np.min(gaps, axis=0))
    return edge[every[order[differs]]].astype(np.float64), np.where(inside, -1 - choice, choice), least


def _unbeaten(near: NDArray[np.int32], edge: Numbers, row: Numbers, column: Numbers) -> Numbers:
    """Return the edges (N, CANDIDATES) among ``near`` (N, 16) that no other beats all over each quarter."""
    near = np.sort(near, axis=1)
    again = np.diff(near, axis=1, prepend=-1) == 0
    near = np.take_along_axis(near, np.argsort(again, axis=1, kind="stable"), axis=1)
    number = near.shape[1] - again.sum(axis=1)
    result = np.empty((len(near), CANDIDATES), dtype=np.int64)
    done = 0
    for width in (2, 4, 8, 16):  # most quarters have few different edges around: no work for sixteen there
        rows = np.nonzero((number > done) & (number <= width))[0]
        done = width
        keep = np.arange(width) < number[rows, None]
        some = np.where(keep, near[rows, :width], near[rows, :1])
        # squared distances to the four corners, in half cells
        ends = (2 * edge)[some]
        squared = []
        for low, high, place in ((0, 2, column[rows]), (1, 3, row[rows])):
            at = place[:, None, None] + np.arange(2)
            gap = np.maximum(ends[..., low, None] - at, at - ends[..., high, None])
            squared.append(np.maximum(gap, 0) ** 2)
        corner = (squared[0][..., None] + squared[1][..., None, :]).reshape(len(rows), width, 4)
        for best in corner.argmin(axis=1).T:
            rival = corner[np.arange(len(rows)), best][:, None]
            as_near, equal = (rival <= corner).all(axis=2), (rival == corner).all(axis=2)
            # of equal edges the first stays
            keep &= ~(as_near & (~equal | (best[:, None] < np.arange(width))))
        order = np.argsort(np.where(keep, corner.sum(axis=2), np.iinfo(np.int64).max), axis=1)
        order = order[:, :CANDIDATES]
        chosen = np.take_along_axis(some, order, axis=1)
        chosen = np.where(np.take_along_axis(keep, order, axis=1), chosen, chosen[:, :1])
        result[rows] = chosen[:, np.minimum(np.arange(CANDIDATES), width - 1)]
    return result


@dataclass(frozen=True, eq=False)
class Walls:
    """The borders of the walls of R maps, each padded by ``max_distance`` and cut into quarters of cells.

    `nearest_edges` says which edges compete in a quarter.

    Attributes:
        grids: The maps.
        unknown: Meaning of their unknown cells.
        option: Sets of competing edges in columns (4 * CANDIDATES, O) float32: all their x0, then all their
            y0, x1 and y1, in half cells from the padded map's outer corner.
        choice: The set of each quarter, -1 less the set inside walls, row by row, one map after another (Q,)
            int32.
        least: What any position in a quarter is away from the nearest wall, at least (Q,) float32, metres.
        affine: Map frame in metres to half cells of the padded map: column by column a matrix's two rows and
            two shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of quarters of each padded map, and where they begin (3, R + 1) int32.
        side: Of half a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres.
    """

    grids: Sequence[OccupancyGrid]
    unknown: Unknown
    option: Tensor
    choice: Tensor
    least: Tensor
    affine: Tensor
    place: Tensor
    side: Tensor
    limit: float
    _made: dict[Any, Any] = field(default_factory=dict)

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
            sets, chosen, bound = nearest_edges(cells)
            option.append((2 * sets).transpose(2, 1, 0).reshape(4 * CANDIDATES, -1).astype(np.float32))
            choice.append(np.where(chosen < 0, chosen - options, chosen + options).astype(np.int32).ravel())
            least.append(np.minimum((bound - _ROUNDING) * side, max_distance).astype(np.float32).ravel())
            options += len(sets)
        begin = np.cumsum([0, *(4 * cells.size for cells in plans[:-1])])
        height, width = (2 * np.array([cells.shape for cells in plans])).T

        affine = np.zeros((6, len(plans)))
        for row, (grid, pad) in enumerate(zip(grids, pads, strict=True)):
            to_cell = grid.map_to_cell()
            affine[:, row] = 2 * np.array([*to_cell[0, :2], *to_cell[1, :2], *(to_cell[:, 2] + pad + 0.5)])
        return cls(
            grids,
            unknown,
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
        tensors = ("option", "choice", "least", "affine", "place", "side")
        return replace(self, **{name: getattr(self, name).to(device) for name in tensors})

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """What compiled loops ask for distances: choices, options in rows, lower bounds, and the limit."""
        return self.choice.numpy(), self.option.t().contiguous().numpy(), self.least.numpy(), self.limit

    @cached_property
    def map_arrays(self) -> tuple[Any, ...]:
        """What the compiled planner reads: how maps lie, and a bit for each quarter with room for a body."""
        clear = np.packbits(self.least.numpy() >= BODY_RADIUS, bitorder="little")
        return self.affine.numpy(), self.place.numpy(), self.side.numpy(), clear

    def polygons(self, hollows: bool = True) -> list[list[Floats]]:
        """Return the outlines (V, 2) of each map in its frame, metres, walls to the left; made once.

        They are simplified by half a cell at most. Without ``hollows``, those that no body fits in are walls.
        """
        if hollows not in self._made:
            walls = [grid.occupied(self.unknown) for grid in self.grids]
            if not hollows:
                plain, walls = walls, [without_hollows(grid, self.unknown) for grid in self.grids]
                if all(map(np.array_equal, plain, walls)):
                    return self._made.setdefault(False, self.polygons())
            self._made[hollows] = [
                [grid.cells_to_map(polygon - 0.5) for polygon in outlines(cells)]
                for grid, cells in zip(self.grids, walls, strict=True)
            ]
        return self._made[hollows]

    def segments(
        self,
        reach: float,
        most: int | None = None,
        hollows: bool = True,
        dtype: torch.dtype = torch.float32,
    ) -> SegmentTable:
        """Return the `polygons` as segments in buckets, on the device of the walls, made once.

        Args:
            reach: Metres up to which segments are asked for.
            most: How many segments one position gets; None for all.
            hollows: As of `polygons`.
            dtype: Of the positions.
        """
        polygons = self.polygons(hollows)
        exact = id(polygons), reach, most
        if exact not in self._made:
            maps = [np.concatenate([np.zeros((0, 18)), *map(edges, own)]) for own in polygons]
            self._made[exact] = SegmentTable.build(maps, reach, most)
        key = *exact, self.choice.device, dtype
        if key not in self._made:
            self._made[key] = self._made[exact].to(self.choice.device, dtype)
        return self._made[key]


@dataclass(frozen=True, eq=False)
class LocalWalls:
    """The walls as entries of any shape E see them, each on its map and in its scene's frame.

    Coordinates come first and entries last, (2, K, *E): on the CPU several times faster than pairs. Frames
    of shape (B, 1) serve the agents of B scenes, (B, A). Only `cast` is for the host alone.

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
    def around(cls, walls: Walls, row: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries on maps ``row`` (N,), -1 for none, in poses (N, 4) see them."""
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

    def least_at(self, cells: Tensor) -> Tensor:
        """Return how far from the nearest wall positions (2, K, *E) in half cells are at least (K, *E).

        That is the exact distance in metres less up to 0.71 cells, 1.06 in walls, float32, at a tenth of the
        price; anything where a position is not a number.
        """
        number = self._number(cells)
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
    def look(self, points: Tensor, on_edges: bool = True) -> tuple[Tensor, Tensor]:
        """Return distances (K, *E) and directions (2, K, *E) at points (2, K, *E), as `closest` does.

        Unless asked for ``on_edges``, the direction is zero on the very edge of a wall.
        """
        walls, cells = self.walls, self.cells(points)
        number = self._number(cells)
        choice, shape = walls.choice.index_select(0, number.reshape(-1)), number.shape
        sign = 1 - 2 * (choice < 0).to(cells.dtype).view(shape)
        option = walls.option.index_select(1, choice.maximum(-1 - choice)).to(cells.dtype)
        low, high = option.view(2, 2, CANDIDATES, *shape)
        offset = cells.unsqueeze(1) - cells.unsqueeze(1).clamp(low, high)
        squared, best = torch.addcmul(offset[0] * offset[0], offset[1], offset[1]).min(dim=0)
        best = best.expand(2, 1, *shape)
        offset, depth = offset.gather(1, best)[:, 0], squared.sqrt()
        distance = depth * self.frame[6].to(cells.dtype)
        if on_edges:  # there the direction is square to the edge, from or to the middle of the quarter
            square = (low == high).gather(1, best)[:, 0] * (cells.floor() + 0.5 - cells).sign()
            offset = torch.where(depth == 0, square, offset)
            depth = torch.where(depth == 0, 1, depth)
        else:
            depth = depth.clamp_min(1e-9)
        # the way back from cells to the scene is the transposed one
        axes = (self._single if cells.dtype == torch.float32 else self._parts)[:2]
        scale = sign * (distance < walls.limit) * self.frame[6].to(cells.dtype) / depth
        offset = offset * scale
        away = torch.stack([torch.addcmul(axis[0] * offset[0], axis[1], offset[1]) for axis in axes])
        return distance.clamp_max(walls.limit) * sign, away

    def half_planes(self, points: Tensor, within: Tensor) -> Tensor:
        """Return distances to walls at points (2, *K, B, A), and what the walls leave free: (4, *K, B, A).

        First comes the distance, then a half-plane. Places p with n p > c are free: c, then x and y of n,
        which is where the distance grows. A wall farther away than ``within`` (B, A), metres, may be any
        distance above that away, with n = 0. No gradient flows.
        """
        shape = points.shape
        points = points.detach().reshape(2, -1, *shape[-2:])
        if compiles(points, within):
            from pedzoo.maps.walls_numba import look

            result = points.new_empty(4, *points.shape[1:])
            lies = self.frame.numpy(), self.place.numpy()
            look(points.numpy(), within.numpy(), *lies, *self.walls.arrays, result.numpy())
        else:
            gap, away = self.look(points, on_edges=False)
            result = torch.cat((torch.stack((gap, (points * away).sum(0) - gap)), away))
        return result.view(4, *shape[1:])

    @torch.no_grad()
    def cast(self, origin: Tensor, direction: Tensor, reach: float) -> Tensor:
        """Return how far rays go before they meet a wall (R, N), metres, ``reach`` where there is none.

        They begin at finite ``origin`` (2, R, N) along unit vectors (2, R, N), and leap by lower bounds of
        distances, or to the next quarter of a cell (Amanatides and Woo, "A Fast Voxel Traversal Algorithm for
        Ray Tracing", 1987).
        """
        origin = self.cells(origin.double())
        x_axis, y_axis, _ = self._parts
        direction = (x_axis * direction[0] + y_axis * direction[1]).double()
        # Along an axis a ray never leaves its line of cells; dividing by almost nothing says just that.
        direction = torch.where(direction.abs() < 1e-12, 1e-12, direction)
        from pedzoo.maps.walls_numba import cast

        length = torch.full_like(origin[0], reach)
        given = (origin, direction, self.walls.least, self.place, self.frame[6].double())
        cast(*(part.numpy() for part in given), reach, length.numpy())
        return length

    @cached_property
    def _parts(self) -> tuple[Tensor, ...]:
        """The x axis, the y axis and the shift, (2, 1, *E) each."""
        return self.frame[:6].view(3, 2, 1, *self.frame.shape[1:]).unbind()

    @cached_property
    def _single(self) -> tuple[Tensor, ...]:
        return self.frame[:6].float().view(3, 2, 1, *self.frame.shape[1:]).unbind()

    def _number(self, cells: Tensor) -> Tensor:
        """Return the numbers (K, *E) int32 of the quarters of positions (2, K, *E) in half cells."""
        column, row = cells.int().clamp(*self._ends)
        return torch.addcmul(column + self.place[2], row, self.place[0])

    @cached_property
    def _ends(self) -> tuple[Tensor, Tensor]:
        """The first and last column and row, (2, 1, *E) each."""
        last = self.place[:2].unsqueeze(1) - 1
        return torch.zeros_like(last), last
