"""A scene drawn from the top: the floor plan, people with shoulders and a head, robots as discs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.sim.physics_parts.camera import FLOOR, OUTSIDE, WALL, Camera, person_color
from pedzoo.sim.physics_parts.frames import after, inverse, map_to_scene
from pedzoo.sim.physics_parts.stance import (
    FACE,
    FACE_AHEAD,
    HAIR,
    HEAD,
    SKIN,
    Stance,
    shoulders,
)

EDGE = (40, 40, 40)
"""RGB around bodies."""

_FINE = 4
"""cv2 draws at whole pixels, or at sixteenths of them with this shift."""


def draw_top_view(
    grid: OccupancyGrid | None,
    unknown: Unknown,
    pose: Tensor,
    position: Tensor,
    present: Tensor,
    radius: Tensor,
    size: tuple[int, int],
    camera: Camera,
    stance: Stance | None = None,
) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3) uint8 RGB of floor and people.

    Args:
        grid: The floor plan, None for open floor.
        unknown: Meaning of its unknown cells.
        pose: Pose of the scene on it (4,).
        position: Scene positions (A, 2), metres.
        present: Which agents to draw (A,) bool.
        radius: Of bodies (A,), metres.
        size: Width and height in pixels.
        camera: Its center and width are used; it looks down for every ``view``.
        stance: Of one scene, where people face; None draws discs.
    """
    image = draw_floor(grid, unknown, pose, size, camera)
    to_pixel = camera.to_pixel(size)
    for person in present.nonzero()[:, 0].tolist():
        place, wide, color = position[person], float(radius[person]), person_color(person)
        if stance is None or bool(stance.robot[0, person]):
            draw_disc(image, to_pixel, place, wide, color)
        else:
            draw_person(image, to_pixel, place, float(stance.heading[0, person]), wide, color)
    return image


def draw_floor(
    grid: OccupancyGrid | None, unknown: Unknown, pose: Tensor, size: tuple[int, int], camera: Camera
) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3) uint8 RGB of the floor; arguments as of `draw_top_view`."""
    import cv2

    to_pixel = camera.to_pixel(size)
    image = np.full((size[1], size[0], 3), FLOOR, dtype=np.uint8)
    if grid is not None:
        colors = np.array([FLOOR, WALL], dtype=np.uint8)[grid.occupied(unknown).astype(int)]
        affine = after(to_pixel, after(map_to_scene(pose), inverse(grid.map_to_cell())))
        cv2.warpAffine(
            colors,
            affine,
            size,
            dst=image,
            # Shrunken plans keep their thin walls with areas averaged; enlarged cells keep their edges.
            flags=cv2.INTER_NEAREST if abs(np.linalg.det(affine[:, :2])) >= 1 else cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=OUTSIDE,
        )
    return image


def draw_person(
    image: NDArray[np.uint8],
    to_pixel: NDArray[np.float64],
    place: Tensor,
    heading: float,
    radius: float,
    color: tuple[int, int, int],
) -> None:
    """Draw a person into a picture: shoulders across where it faces, the disc that touches, and a head.

    Args:
        image: See `draw_disc`, as are the others.
        to_pixel: Of its camera.
        place: Scene position (2,), metres.
        heading: Radians.
        radius: Of the disc, metres.
        color: RGB.
    """
    import cv2

    scale, middle = to_pixel[0, 0], place.detach().cpu().double().numpy()
    ahead, wide = np.array([np.cos(heading), np.sin(heading)]), radius / BODY_RADIUS

    def disc(forward: float, across: float, tint: tuple[int, int, int]) -> None:
        pixel = to_pixel[:, :2] @ (middle + wide * forward * ahead) + to_pixel[:, 2]
        x, y = (round(value * 2**_FINE) for value in pixel)
        cv2.circle(image, (x, y), round(across * scale * 2**_FINE), tint, cv2.FILLED, cv2.LINE_AA, _FINE)

    outline = to_pixel[:, :2] @ (middle + wide * shoulders(heading)).T + to_pixel[:, 2:]
    corners = np.round(outline.T * 2**_FINE).astype(np.int32)
    # the edge first, then all that it surrounds
    cv2.polylines(image, [corners], True, EDGE, 2, cv2.LINE_AA, _FINE)
    disc(0.0, radius + 1 / scale, EDGE)
    cv2.fillPoly(image, [corners], color, cv2.LINE_AA, _FINE)
    disc(0.0, radius, color)
    disc(0.0, wide * HEAD, HAIR)
    disc(FACE_AHEAD, wide * FACE, SKIN)


def draw_disc(
    image: NDArray[np.uint8],
    to_pixel: NDArray[np.float64],
    place: Tensor,
    radius: float,
    color: tuple[int, int, int],
) -> None:
    """Draw a body into a picture.

    Args:
        image: The picture (H, W, 3) uint8 RGB.
        to_pixel: Of its camera, see `Camera.to_pixel`.
        place: Scene position (2,), metres.
        radius: Metres.
        color: RGB.
    """
    import cv2

    pixel = to_pixel[:, :2] @ place.detach().cpu().double().numpy() + to_pixel[:, 2]
    x, y = (round(value * 2**_FINE) for value in pixel)
    across = round(radius * to_pixel[0, 0] * 2**_FINE)
    cv2.circle(image, (x, y), across, color, cv2.FILLED, cv2.LINE_AA, _FINE)
    cv2.circle(image, (x, y), across, EDGE, 1, cv2.LINE_AA, _FINE)
