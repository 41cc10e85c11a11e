"""Scenes drawn from the top: floor plans, people with shoulders and a head, robots as discs, goals."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.geometry import heading_of
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.sim.camera import FLOOR, OUTSIDE, WALL, Camera, after, inverse, map_to_scene, person_color

Image = NDArray[np.uint8]

SHOULDERS = (0.13, 0.23)
"""Half axes of a person from above, along and across where it faces, metres."""

HEAD, FACE, FACE_AHEAD = 0.1, 0.07, 0.05
"""Radii of a head and of the face on it from above, and how far ahead the face lies, metres."""

SKIN, HAIR = (226, 180, 150), (66, 48, 40)
"""RGB."""

_WINDOW = 3
"""Trace points before and after one over which people's headings are means: 0.6 s in all."""

_TURNS = 0.08
"""Metres in such a time from which on people face where they walk."""

EDGE = (40, 40, 40)
"""RGB around bodies."""

_FINE = 4
"""cv2 draws at whole pixels, or at sixteenths of them with this shift."""

_CIRCLE = 32
"""Corners of the circle around a goal."""


def shoulders(heading: float) -> NDArray[np.float64]:
    """Return the outline (24, 2) of shoulders around the origin, metres; ``heading`` in radians."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    along, across = SHOULDERS[0] * np.cos(angle), SHOULDERS[1] * np.sin(angle)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack((along, across), 1) @ np.array([[c, s], [-s, c]])


def headings_along(path: Tensor) -> Tensor:
    """Return where people face (A, T), radians, at points every 0.1 s of their paths (A, T, 2), metres.

    People who stand face where they last went, and at first where they will go. Positions are not finite
    where nobody is.
    """
    last = path.shape[1] - 1
    points = torch.arange(last + 1, device=path.device)
    before, after = (points - _WINDOW).clamp_min(0), (points + _WINDOW).clamp_max(last)
    moves = path[:, after] - path[:, before]
    turned = moves.norm(dim=-1) > _TURNS
    latest = torch.where(turned, points, -1).cummax(1).values
    kept = torch.where(latest < 0, turned.int().argmax(1, keepdim=True), latest)
    return heading_of(moves, moves.new_zeros(moves.shape[:2]), _TURNS).gather(1, kept)


def draw_top_view(
    grid: OccupancyGrid | None,
    unknown: Unknown,
    pose: Tensor,
    position: Tensor,
    present: Tensor,
    radius: Tensor,
    size: tuple[int, int],
    camera: Camera,
    heading: Tensor | None = None,
    kind: Tensor | None = None,
) -> Image:
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
        heading: Where people face (A,), radians; None draws discs.
        kind: Person or robot (A,), which is a disc; None for people alone.
    """
    image = draw_floor(grid, unknown, pose, size, camera)
    to_pixel = camera.to_pixel(size)
    for person in present.nonzero()[:, 0].tolist():
        place, wide, color = position[person], float(radius[person]), person_color(person)
        if heading is None or (kind is not None and int(kind[person]) == ROBOT):
            draw_disc(image, to_pixel, place, wide, color)
        else:
            draw_person(image, to_pixel, place, float(heading[person]), wide, color)
    return image


def draw_floor(
    grid: OccupancyGrid | None, unknown: Unknown, pose: Tensor, size: tuple[int, int], camera: Camera
) -> Image:
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
    image: Image,
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
    image: Image,
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
    angle = torch.linspace(0, 2 * torch.pi, _CIRCLE + 1)[:-1]
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
