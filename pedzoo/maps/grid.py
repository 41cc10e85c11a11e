"""Occupancy grids: floor plans, the identity of their content, distances to walls, and free space."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.errors import unknown as unknown_name

FREE, OCCUPIED, UNKNOWN = 0, 1, 2  # the values of a cell
FINEST, COARSEST = 1e-4, 1e3  # limits of the side of a cell in metres
FARTHEST = 1e8  # limit of an origin in metres; map projections count to 10,000 km
AWAY = 100.0  # metres from the origin: up to here float32 tells 0.01 mm apart

Unknown = Literal["wall", "free"]
"""Meaning of unknown cells: walls indoors, free in recorded scenes (outside the camera's image)."""


def home_of(middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the origin (2,), whole metres, of a frame for scenes around a middle (2,): 0 if it is near."""
    return np.round(middle) if np.abs(middle).max() > AWAY else np.zeros(2)


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A floor plan of H x W square cells.

    Attributes:
        cells: ``FREE``, ``OCCUPIED`` or ``UNKNOWN`` (H, W) uint8, read-only; row 0 has the SMALLEST y (images
            have it at the top and are flipped on reading), column 0 the smallest x.
        resolution: Side of a cell in metres.
        origin: Where the outer corner of cell (0, 0) lies in the map's frame, and how the grid is turned
            about it: x and y in metres, yaw in radians.
        name: Name in messages and ``MapBank.id_of``; not part of its content.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = field(default="map", kw_only=True)

    def __post_init__(self) -> None:
        """Check the values and keep a read-only copy of the cells."""
        cells = np.array(self.cells, dtype=np.uint8, order="C")
        if cells.ndim != 2 or not cells.size or cells.max() > UNKNOWN:
            raise UserError(
                f"map {self.name!r}: got cells {cells.shape} with values up to {cells.max(initial=0)}, "
                f"expected (H, W) of {FREE} (free), {OCCUPIED} (occupied) or {UNKNOWN} (unknown)"
            )
        if not FINEST <= self.resolution <= COARSEST:
            raise UserError(
                f"map {self.name!r}: resolution {self.resolution} must be metres per cell, above 0: from "
                f"{FINEST:g} to {COARSEST:g}"
            )
        if len(self.origin) != 3 or not all(abs(value) <= FARTHEST for value in self.origin):
            raise UserError(
                f"map {self.name!r}: origin {self.origin} must be x, y (metres), yaw (radians), none of them "
                f"beyond {FARTHEST:g}"
            )
        cells.flags.writeable = False
        object.__setattr__(self, "cells", cells)

    @cached_property
    def digest(self) -> str:
        """Hex sha256 of the content: cells, resolution and origin, not the name."""
        content = hashlib.sha256(np.array(self.cells.shape, dtype="<i8").tobytes())
        content.update(self.cells.tobytes())
        content.update(np.array([self.resolution, *self.origin], dtype="<f8").tobytes())
        return content.hexdigest()

    @property
    def map_id(self) -> int:
        """The id in scene batches: the first 62 bits of the content hash, the same in every bank."""
        return int(self.digest[:16], 16) >> 2

    @property
    def home(self) -> NDArray[np.float64]:
        """The origin (2,) of a frame that has the floor plan near its own; see `home_of`."""
        height, width = self.cells.shape
        return home_of(self.cells_to_map(np.array([[width - 1, height - 1]]) / 2)[0])

    def at_home(self) -> OccupancyGrid:
        """Return the floor plan in the frame of its `home`: itself where that is its own."""
        x, y = self.home.tolist()
        if x == y == 0:
            return self
        return replace(self, origin=(self.origin[0] - x, self.origin[1] - y, self.origin[2]))

    def occupied(self, unknown: Unknown) -> NDArray[np.bool_]:
        """Return which cells are walls (H, W), with unknown cells counted as walls or as free."""
        if unknown not in ("wall", "free"):
            raise unknown_name("treatment of unknown cells", unknown, ("wall", "free"))
        walls = self.cells == OCCUPIED
        return walls | (self.cells == UNKNOWN) if unknown == "wall" else walls

    def coarser(self, side: float) -> OccupancyGrid:
        """Return the floor plan in cells of about ``side`` metres, a whole number of its own.

        A cell is occupied where any of its own is, else free where any is: walls only grow, by less than a
        cell. Rows and columns that are missing to a whole cell are unknown.
        """
        times = int(side / self.resolution + 1e-6)
        if times < 2:
            return self
        height, width = self.cells.shape
        padding = (0, -height % times), (0, -width % times)
        cells = np.pad(self.cells, padding, constant_values=UNKNOWN)
        cells = cells.reshape(cells.shape[0] // times, times, cells.shape[1] // times, times)
        has_wall, has_floor = ((cells == value).any(axis=(1, 3)) for value in (OCCUPIED, FREE))
        cells = np.where(has_wall, OCCUPIED, np.where(has_floor, FREE, UNKNOWN))
        return OccupancyGrid(cells, times * self.resolution, self.origin, name=self.name)

    def signed_distance(self, unknown: Unknown) -> NDArray[np.float32]:
        """Return the distance from cell centres to the nearest wall (H, W), metres, negative inside it.

        It is the distance to the nearest centre of the other kind minus half a cell: exact straight in front
        of a wall, up to a fifth of a cell too large beside its corners. Read bilinearly, it is zero at the
        edge between a free cell and a wall. A map without walls is ``inf`` everywhere, a solid one ``-inf``;
        the world outside the map is no wall.
        """
        from scipy.ndimage import distance_transform_edt

        walls = self.occupied(unknown)
        if walls.all() or not walls.any():
            return np.full(walls.shape, -np.inf if walls.all() else np.inf, dtype=np.float32)
        to_wall = np.asarray(distance_transform_edt(~walls))
        to_free = np.asarray(distance_transform_edt(walls))
        cells = np.where(walls, 0.5 - to_free, to_wall - 0.5)
        return (cells * self.resolution).astype(np.float32)

    def map_to_cell(self) -> NDArray[np.float64]:
        """Return the affine (2, 3) from the map's frame (metres) to (column, row), whole at cell centres."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]) / self.resolution
        return np.column_stack((turn, -turn @ (x, y) - 0.5))

    def cells_to_map(
        self, cells: NDArray[np.float64] | NDArray[np.int32] | NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return map-frame positions (N, 2), metres, of columns and rows (N, 2), whole at cell centres."""
        affine = self.map_to_cell()
        return (cells - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T


def free_points(grid: OccupancyGrid, unknown: Unknown, clearance: float) -> NDArray[np.float64]:
    """Return the centres (F, 2) of the cells in the largest connected part of the free space, row by row.

    Cells are free if their centre is at least ``clearance`` from every wall by
    `OccupancyGrid.signed_distance`; they are connected through their four sides. Unreachable places, such as
    closed courtyards, are left out.

    Raises:
        UserError: No cell is that far from all walls.
    """
    from scipy.ndimage import label

    free = ~grid.occupied(unknown) & (grid.signed_distance(unknown) >= clearance)
    parts = np.empty(free.shape, dtype=np.int32)
    if not label(free, output=parts):  # its default structure connects the four sides
        raise UserError(
            f"map {grid.name!r}: no free cell is {clearance:g} m or more from all walls "
            f"(unknown cells count as {unknown}): lower the clearance"
        )
    sizes = np.bincount(parts.ravel())
    row, column = np.nonzero(parts == 1 + sizes[1:].argmax())
    return grid.cells_to_map(np.stack((column, row), axis=1))


def spread_points(
    grid: OccupancyGrid, unknown: Unknown, clearance: float, spacing: float, seed: int
) -> NDArray[np.float64]:
    """Return some of `free_points` (S, 2) in random order, ``spacing`` metres apart and as many as then fit.

    A point is taken unless one taken before it is nearer than ``spacing``: no further one could be added. The
    same seed gives the same points.
    """
    from scipy.spatial import KDTree

    points = free_points(grid, unknown, clearance)
    points = points[np.random.default_rng(seed).permutation(len(points))]
    tree = KDTree(points)
    left, taken = np.ones(len(points), dtype=bool), []
    for number, point in enumerate(points):
        if left[number]:
            taken.append(number)
            # The ball is closed, but points exactly the spacing away may stay.
            left[tree.query_ball_point(point, spacing * (1 - 1e-9))] = False
    return points[taken]


def boxes(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.float64]:
    """Return the walls of a floor plan as rectangles (M, 4) that do not overlap and leave no wall cell out.

    They are x0, y0, x1, y1 in metres from the outer corner of cell (0, 0); origin and yaw are not applied.
    """
    return merge_cells(grid.occupied(unknown)) * np.float64(grid.resolution)


def merge_cells(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return a partition of the true cells (H, W) into rectangles (M, 4): x0, y0, x1, y1, cell borders.

    Runs along the axis that needs fewer boxes are joined where they repeat exactly in the next line.
    """
    rows, columns = _merge_rows(cells), _merge_rows(cells.T)[:, [1, 0, 3, 2]]
    return rows if len(rows) <= len(columns) else columns


def _merge_rows(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    # A run begins where the padded row steps up and ends where it steps down; both come in the same order.
    steps = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, start), end = np.nonzero(steps == 1), np.nonzero(steps == -1)[1]
    # Sorted by extent and then by row, the runs of one box stand next to one another.
    order = np.lexsort((row, end, start))
    row, start, end = row[order], start[order], end[order]
    same = (np.diff(start) == 0) & (np.diff(end) == 0) & (np.diff(row) == 1)
    first = np.concatenate(([True], ~same)) if len(row) else np.zeros(0, dtype=bool)
    last = np.concatenate((~same, [True])) if len(row) else first
    return np.stack((start[first], row[first], end[first], row[last] + 1), axis=1)
