"""Pictures of scenes: where they are taken from, floor plans from the top, people, robots and goals.

Affine maps of the plane are matrices (3, 3).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, heading_of, move_to_scene
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown

Affine = NDArray[np.float64]
"""A map of the plane (3, 3): that of ``second`` after ``first`` is ``second @ first``."""

FLOOR, WALL, OUTSIDE, EDGE = (236, 236, 232), (112, 114, 122), (205, 208, 212), (40, 40, 40)
"""RGB of free cells, walls, what is beyond the floor plan or above the horizon, and around bodies."""

ROBOT_BODY, ROBOT_FRONT = (45, 48, 56), (255, 176, 32)
"""RGB of robots, and of their front."""

_PEOPLE = (
    (214, 39, 40),
    (31, 119, 180),
    (44, 160, 44),
    (255, 127, 14),
    (148, 103, 189),
    (23, 190, 207),
    (227, 119, 194),
    (188, 189, 34),
    (140, 86, 75),
    (20, 60, 120),
)

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

_FINE = 4
"""cv2 draws at whole pixels, or at sixteenths of them with this shift."""

VIEW_ANGLE = {"top": math.radians(8), "perspective": math.radians(50)}
"""Horizontal opening angles of pinholes: from the top a narrow one from high above, so walls hide little."""


def person_color(person: int) -> tuple[int, int, int]:
    """Return the RGB colour of the person in slot ``person``: ten that are easy to tell apart, repeated."""
    return _PEOPLE[person % len(_PEOPLE)]


def check_size(size: object) -> None:
    """Refuse a size of pictures that is no width and height in whole pixels."""
    sides = list(size) if isinstance(size, Iterable) else []
    if len(sides) != 2 or not all(isinstance(side, Integral) and int(side) > 0 for side in sides):
        raise UserError(f"size {size!r:.60}: expected width and height in pixels, such as (640, 480)")


class Lens(NamedTuple):
    """A camera on a robot: a pinhole above its centre that looks ahead, level.

    Attributes:
        width: W, pixels.
        height: H, pixels.
        angle: Horizontal opening angle, radians.
        eye_height: Metres above the floor.
        reach: Greatest depth, metres.
    """

    width: int
    height: int
    angle: float
    eye_height: float
    reach: float

    def floor(self) -> NDArray[np.float64]:
        """Return the depth (H,) at which rows of pixels see the floor, metres; inf above the horizon."""
        focal = self.width / 2 / math.tan(self.angle / 2)
        below = np.arange(self.height) + 0.5 - self.height / 2
        return np.where(below > 0, self.eye_height * focal / np.maximum(below, 1e-9), np.inf)


@dataclass(frozen=True)
class Camera:
    """A camera over a scene, in the scene's frame; without ``center`` and ``width`` it sees everything.

    Attributes:
        view: ``top`` looks straight down, x to the right and y up; ``perspective`` looks down obliquely.
        center: The point of the floor in the middle of the image, metres.
        width: How many metres of floor fit from left to right through ``center``.
        heading: Perspective only: the direction in which the camera looks, radians (pi / 2: along y).
        pitch: Perspective only: how far it looks down, radians below the horizon.
    """

    view: Literal["top", "perspective"] = "top"
    center: tuple[float, float] | None = None
    width: float | None = None
    heading: float = math.pi / 2
    pitch: float = math.radians(50)

    def around(self, points: Tensor, size: tuple[int, int] = (640, 480), margin: float = 1.0) -> Camera:
        """Return this camera with ``center`` and ``width`` such that it sees points (..., 2), metres.

        It sees ``margin`` metres around those that are finite. A video's camera stands still: give the points
        of all its frames, once. ``size`` is the image's width and height in pixels.
        """
        # the image's right and up on the floor, as columns
        heading = math.pi / 2 if self.view == "top" else self.heading
        c, s = math.cos(heading), math.sin(heading)
        axes = np.array([[s, c], [-c, s]])
        places = as_array(points).reshape(-1, 2) @ axes
        places = places[np.isfinite(places).all(axis=1)]
        low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else np.zeros((2, 2))
        wide, deep = high - low + 2 * margin
        if self.view == "perspective":
            # Seen obliquely depth is shorter; what is near is larger and people stand up, hence some room.
            wide, deep = 1.25 * wide, 1.25 * deep * math.sin(self.pitch) + 1.5
        x, y = axes @ ((low + high) / 2)
        return replace(self, center=(float(x), float(y)), width=float(max(wide, deep * size[0] / size[1])))

    def to_pixel(self, size: tuple[int, int]) -> Affine:
        """Return the map from scene positions to (column, row) seen from the top; see `floor_pixels`."""
        assert self.center is not None and self.width is not None
        scale, (x, y), (columns, rows) = size[0] / self.width, self.center, size
        return square(
            np.array([[scale, 0.0, (columns - 1) / 2 - x * scale], [0.0, -scale, (rows - 1) / 2 + y * scale]])
        )

    def floor_pixels(self, points: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
        """Return (column, row) (N, 2) of points (N, 2) of the floor, metres; NaN for those behind the camera.

        Whole numbers are the centres of pixels; ``center`` and ``width`` have to be known.
        """
        if self.view == "top":
            return moved(self.to_pixel(size), points)
        eye, target, up = (np.array(values) for values in self.eye())
        ahead = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(ahead, up)
        right /= np.linalg.norm(right)
        axes = np.stack((right, np.cross(ahead, right), ahead), axis=1)  # right, down, ahead
        seen = (np.pad(points, ((0, 0), (0, 1))) - eye) @ axes
        depth = np.where(seen[:, 2:] > 0, seen[:, 2:], np.nan)
        focal = size[0] / 2 / math.tan(VIEW_ANGLE[self.view] / 2)
        return focal * seen[:, :2] / depth + (np.array(size) - 1) / 2

    def eye(self) -> tuple[list[float], list[float], list[float]]:
        """Return where the pinhole camera stands, what it looks at and which way is up, (x, y, z) each."""
        assert self.center is not None and self.width is not None
        distance = self.width / 2 / math.tan(VIEW_ANGLE[self.view] / 2)
        x, y = self.center
        if self.view == "top":
            return [x, y, distance], [x, y, 0.0], [0.0, 1.0, 0.0]
        c, s = math.cos(self.heading), math.sin(self.heading)
        back = distance * math.cos(self.pitch)
        return [x - back * c, y - back * s, distance * math.sin(self.pitch)], [x, y, 0.0], [0.0, 0.0, 1.0]


def free_corners(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.float64]:
    """Return the corners (4, 2) of the rectangle around all free cells, in the map's frame, metres."""
    free = ~grid.occupied(unknown)
    if not free.any():
        free = ~free
    (top, bottom), (left, right) = (np.flatnonzero(free.any(axis=axis))[[0, -1]] for axis in (1, 0))
    left, right, top, bottom = left - 0.5, right + 0.5, top - 0.5, bottom + 0.5
    cells = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return grid.cells_to_map(cells)


def as_array(points: Tensor) -> NDArray[np.float64]:
    """Return a tensor as numpy's doubles."""
    return points.detach().cpu().double().numpy()


def moved(affine: Affine, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (..., 2) by an affine map."""
    return points @ affine[:2, :2].T + affine[:2, 2]


def map_to_scene(pose: Tensor) -> Affine:
    """Return the map of a pose (4,)."""
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    zero, x, y = move_to_scene(corners[None], pose.detach().cpu().double()[None])[0].numpy()
    return square(np.column_stack((x - zero, y - zero, zero)))


def scene_to_grid(pose: Tensor, grid: OccupancyGrid | None) -> Affine:
    """Return the map from a scene to metres along a grid's axes, from the outer corner of its cell (0, 0).

    It turns, mirrors and shifts, but does not stretch. Without a floor plan, scenes stay where they are.
    """
    if grid is None:
        return np.eye(3)
    to_grid = (grid.map_to_cell() + np.array([[0, 0, 0.5], [0, 0, 0.5]])) * grid.resolution
    return square(to_grid) @ np.linalg.inv(map_to_scene(pose))


def square(affine: NDArray[np.float64]) -> Affine:
    """Return the matrix (3, 3) of an affine map (2, 3)."""
    return np.vstack((affine, [0.0, 0.0, 1.0]))


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
