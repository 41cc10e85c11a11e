"""Affine maps (2, 3) of the plane, for the few places where scenes are handled one by one."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.geometry import move_to_scene
from pedzoo.maps.grid import OccupancyGrid

Affine = NDArray[np.float64]


def after(second: Affine, first: Affine) -> Affine:
    """Return the map that does ``first`` and then ``second``."""
    return np.column_stack((second[:, :2] @ first[:, :2], second[:, :2] @ first[:, 2] + second[:, 2]))


def inverse(affine: Affine) -> Affine:
    """Return the map that undoes one."""
    return np.linalg.inv(np.vstack((affine, [0, 0, 1])))[:2]


def map_to_scene(pose: Tensor) -> Affine:
    """Return the map of a pose (4,)."""
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    zero, x, y = move_to_scene(corners[None], pose.detach().cpu().double()[None])[0].numpy()
    return np.column_stack((x - zero, y - zero, zero))


def scene_to_grid(pose: Tensor, grid: OccupancyGrid | None) -> Affine:
    """Return the map from a scene to metres along a grid's axes, from the outer corner of its cell (0, 0).

    It turns, mirrors and shifts, but does not stretch. Without a floor plan, scenes stay where they are.
    """
    if grid is None:
        return np.eye(2, 3)
    to_grid = (grid.map_to_cell() + np.array([[0, 0, 0.5], [0, 0, 0.5]])) * grid.resolution
    return after(to_grid, inverse(map_to_scene(pose)))
