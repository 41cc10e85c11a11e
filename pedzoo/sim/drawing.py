"""Scenes drawn from the top: floor plans, people with shoulders and a head, robots as discs, goals."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.geometry import direction_of, heading_of
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.sim.camera import FLOOR, OUTSIDE, WALL, Camera, as_array, map_to_scene, square

Image = NDArray[np.uint8]
Color = tuple[int, int, int]

SHOULDERS = (0.13, 0.23)
"""Half axes of a person from above, along and across where it faces, metres."""

HEAD, FACE, FACE_AHEAD = 0.1, 0.07, 0.05
"""Radii of a head and of the face on it from above, and how far ahead the face lies, metres."""

SKIN, HAIR = (226, 180, 150), (66, 48, 40)
"""RGB."""

_WINDOW, _TURNS = 3, 0.08
"""Trace points before and after one over which headings are means, and metres then from which people turn."""

EDGE = (40, 40, 40)
"""RGB around bodies."""

_FINE = 4
"""cv2 draws at whole pixels, or at sixteenths of them with this shift."""


def shoulders(heading: float) -> NDArray[np.float64]:
    """Return the outline (24, 2) of shoulders around the origin, metres; ``heading`` in radians."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    along, across = SHOULDERS[0] * np.cos(angle), SHOULDERS[1] * np.sin(angle)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack((along, across), 1) @ np.array([[c, s], [-s, c]])


def goal_circle(goal: Tensor) -> Tensor:
    """Return the circle (32, 2) around a goal (2,), metres, within which it is reached."""
    angle = torch.linspace(0, 2 * torch.pi, 33)[:-1]
    return goal.detach().cpu() + GOAL_RADIUS * direction_of(angle)


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


def draw_floor(
    grid: OccupancyGrid | None, unknown: Unknown, pose: Tensor, size: tuple[int, int], camera: Camera
) -> Image:
    """Return the picture (H, W, 3) uint8 RGB of the floor from above, so many pixels wide and high.

    ``grid`` is None for open floor, ``pose`` (4,) that of the scene; the camera's center and width are used.
    """
    import cv2

    image = np.full((size[1], size[0], 3), FLOOR, dtype=np.uint8)
    if grid is not None:
        colors = np.array([FLOOR, WALL], dtype=np.uint8)[grid.occupied(unknown).astype(int)]
        affine = camera.to_pixel(size) @ map_to_scene(pose) @ np.linalg.inv(square(grid.map_to_cell()))
        cv2.warpAffine(
            colors,
            affine[:2],
            size,
            dst=image,
            # Shrunken plans keep their thin walls with areas averaged; enlarged cells keep their edges.
            flags=cv2.INTER_NEAREST if abs(np.linalg.det(affine[:2, :2])) >= 1 else cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=OUTSIDE,
        )
    return image


class Canvas:
    """A picture of a scene, ``image``, into which bodies, ways and goals are drawn where they are."""

    def __init__(self, image: Image, camera: Camera) -> None:
        """Take a picture (H, W, 3) uint8 RGB, and the camera that took it; its center and width are known."""
        self.image, self._camera = image, camera
        self._size = image.shape[1], image.shape[0]

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return points of the floor (N, 2), metres, in sixteenths of pixels (N, 1, 2)."""
        pixels = self._camera.floor_pixels(points, self._size) * 2**_FINE
        return np.round(pixels).astype(np.int32).reshape(-1, 1, 2)

    def line(self, points: Tensor, color: Color, width: int = 1, closed: bool = False) -> None:
        """Draw a line on the floor, so many pixels broad; none where a point is behind the camera."""
        import cv2

        places = as_array(points)
        if np.isfinite(self._camera.floor_pixels(places, self._size)).all():
            cv2.polylines(self.image, [self.pixels(places)], closed, color, width, cv2.LINE_AA, _FINE)

    def goal(self, goal: Tensor, color: Color, width: int = 1) -> None:
        """Draw the circle around a goal (2,), metres; nothing if it is not finite."""
        self.line(goal_circle(goal), color, width, closed=True)

    def disc(self, place: Tensor, radius: float, color: Color) -> None:
        """Draw a body from the top: the disc of ``radius`` metres around a place (2,)."""
        self._circle(as_array(place), radius, color)
        self._circle(as_array(place), radius, EDGE, thickness=1)

    def person(self, place: Tensor, heading: float, radius: float, color: Color) -> None:
        """Draw a person from the top: shoulders across its ``heading``, the disc that touches, and a head."""
        import cv2

        middle, wide = as_array(place), radius / BODY_RADIUS
        face = middle + wide * FACE_AHEAD * np.array([np.cos(heading), np.sin(heading)])
        outline = self.pixels(middle + wide * shoulders(heading))
        # the edge first, then all that it surrounds
        cv2.polylines(self.image, [outline], True, EDGE, 2, cv2.LINE_AA, _FINE)
        self._circle(middle, radius, EDGE, wider=1)
        cv2.fillPoly(self.image, [outline], color, cv2.LINE_AA, _FINE)
        self._circle(middle, radius, color)
        self._circle(middle, wide * HEAD, HAIR)
        self._circle(face, wide * FACE, SKIN)

    def _circle(
        self, place: NDArray[np.float64], radius: float, color: Color, thickness: int = -1, wider: int = 0
    ) -> None:
        """Draw a circle around a place (2,), metres, filled by default, so many pixels ``wider``."""
        import cv2

        across = radius * self._size[0] / (self._camera.width or 1.0) + wider
        (x, y), cut = self.pixels(place[None])[0, 0].tolist(), round(across * 2**_FINE)
        cv2.circle(self.image, (x, y), cut, color, thickness, cv2.LINE_AA, _FINE)
