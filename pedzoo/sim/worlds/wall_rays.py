"""Rays against the walls of occupancy grids: a grid traversal that leaps through free space.

Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987, with the distance
transform telling how many cells ahead are free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pedzoo.geometry import move_to_map, turn_to_map
from pedzoo.maps.grid import OccupancyGrid, Unknown

_INTO = 1e-3
"""Cells by which a position is taken to lie beyond the border that a ray has reached: far above rounding."""


@dataclass(frozen=True, eq=False)
class WallRays:
    """The cells of R floor plans, ready for rays; row -1 means "no map".

    Attributes:
        leap: How many cells of length are surely free from anywhere in each cell, -1 in a wall; one map after
            another (C,) float32.
        start: Where each map begins in ``leap`` (R + 1,) long.
        size: Columns and rows of each map (R + 1, 2) long.
        linear: Map frame in metres to cells from the outer corner of cell (0, 0) (R + 1, 2, 2) float64.
        shift: The same transform's constant part (R + 1, 2) float64.
        resolution: Side of a cell in metres (R + 1,) float64.
    """

    leap: Tensor
    start: Tensor
    size: Tensor
    linear: Tensor
    shift: Tensor
    resolution: Tensor

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, device: torch.device) -> WallRays:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        leaps = [_leaps(grid.occupied(unknown)) for grid in grids] + [np.full((1, 1), 1e9, dtype=np.float32)]
        corner = np.array([[0, 0, 0.5], [0, 0, 0.5]])  # whole numbers at the borders of cells, not at centres
        affine = np.stack([*(grid.map_to_cell() + corner for grid in grids), np.eye(2, 3)])
        return cls(
            leap=torch.from_numpy(np.concatenate([leap.ravel() for leap in leaps])).to(device),
            start=torch.tensor(np.cumsum([0, *(leap.size for leap in leaps[:-1])]), device=device),
            size=torch.tensor([leap.shape[::-1] for leap in leaps], device=device),
            linear=torch.tensor(affine[:, :, :2], device=device),
            shift=torch.tensor(affine[:, :, 2], device=device),
            resolution=torch.tensor(
                [*(grid.resolution for grid in grids), 1.0], dtype=torch.float64, device=device
            ),
        )

    def cast(self, origin: Tensor, direction: Tensor, row: Tensor, pose: Tensor, reach: float) -> Tensor:
        """Return how far rays go before they meet a wall (B, R), metres, ``reach`` where there is none.

        Args:
            origin: Where each ray starts (B, R, 2), scene positions.
            direction: Unit vectors (B, R, 2).
            row: Floor plan of each scene (B,) long, -1 for none.
            pose: Scene poses (B, 4).
            reach: Greatest length, metres.
        """
        found = origin.new_full(origin.shape[:2], reach, dtype=torch.float64)
        pose = pose.double()
        origin = (move_to_map(origin.double(), pose) @ self.linear[row].mT) + self.shift[row].unsqueeze(1)
        direction = turn_to_map(direction.double(), pose) @ self.linear[row].mT
        # A direction along an axis never leaves its line of cells; dividing by almost nothing says just that.
        direction = torch.where(direction.abs() < 1e-12, 1e-12, direction)

        # Where the ray is above the floor plan at all: the world outside is no wall.
        sides = torch.stack((-origin, self.size[row].unsqueeze(1) - origin)) / direction
        begin = sides.amin(0).amax(-1).clamp_min(0)
        end = sides.amax(0).amin(-1).clamp_max(reach)
        scene, ray = ((begin < end) & (row >= 0).unsqueeze(1)).nonzero(as_tuple=True)
        o, d, size = origin[scene, ray], direction[scene, ray], self.size[row[scene]]
        t, end, first = begin[scene, ray], end[scene, ray], self.start[row[scene]]
        step = self.resolution[row[scene]]
        while len(t):
            into = t + _INTO * step
            cell = (o + d * into.unsqueeze(1)).floor().long().clamp_min(0).minimum(size - 1)
            leap = self.leap[first + cell[:, 1] * size[:, 0] + cell[:, 0]]
            hit = leap < 0
            found[scene[hit], ray[hit]] = t[hit]
            leaving = ((cell + (d > 0) - o) / d).amin(1)
            t = torch.maximum(torch.maximum(leaving, into), t + leap * step)
            on = (~hit & (t < end)).nonzero(as_tuple=True)[0]
            o, d, size, t, end = o[on], d[on], size[on], t[on], end[on]
            first, step, scene, ray = first[on], step[on], scene[on], ray[on]
        return found


def _leaps(walls: np.ndarray) -> np.ndarray:
    from scipy.ndimage import distance_transform_edt

    if not walls.any():
        return np.full(walls.shape, 1e9, dtype=np.float32)
    # From any point of one square to any of another: at most two half diagonals less than between centres.
    between = np.asarray(distance_transform_edt(~walls)) - math.sqrt(2)
    return np.where(walls, -1, between.clip(min=0)).astype(np.float32)
