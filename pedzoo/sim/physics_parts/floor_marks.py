"""What pictures mark on the floor: the ways that agents went, and the goals that they go to."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.types import GOAL_RADIUS
from pedzoo.sim.physics_parts.camera import Camera

_FINE = 4
"""cv2 draws at sixteenths of pixels with this shift."""

_CORNERS = 32
"""Of the circle around a goal."""

Image = NDArray[np.uint8]


def draw_way(
    image: Image,
    way: Tensor,
    camera: Camera,
    size: tuple[int, int],
    color: tuple[int, int, int],
    width: int = 1,
) -> None:
    """Draw an agent's way (T, 2), metres, as a line on the floor, so many pixels broad.

    ``size`` is the width and height in pixels of the picture that ``camera`` took.
    """
    _line(image, way, camera, size, color, width, closed=False)


def draw_goal(
    image: Image,
    goal: Tensor,
    camera: Camera,
    size: tuple[int, int],
    color: tuple[int, int, int],
    width: int = 1,
) -> None:
    """Draw the circle around a goal (2,), metres, within which it is reached; nothing if it is not finite."""
    angle = torch.linspace(0, 2 * torch.pi, _CORNERS + 1)[:-1]
    circle = goal.detach().cpu() + GOAL_RADIUS * torch.stack((angle.cos(), angle.sin()), dim=-1)
    _line(image, circle, camera, size, color, width, closed=True)


def _line(
    image: Image,
    points: Tensor,
    camera: Camera,
    size: tuple[int, int],
    color: tuple[int, int, int],
    width: int,
    closed: bool,
) -> None:
    import cv2

    pixels = camera.floor_pixels(points.detach().cpu().double().numpy(), size)
    if np.isfinite(pixels).all():
        corners = np.round(pixels * 2**_FINE).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(image, [corners], closed, color, width, cv2.LINE_AA, _FINE)
