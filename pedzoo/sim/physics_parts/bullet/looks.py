"""Looks of a floor plan for pybullet's cameras, apart from the bodies of physics."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pedzoo.sim.physics_parts.bullet.client import connect, egl_plugin, load_egl
from pedzoo.sim.physics_parts.bullet.figure import Figure, Figures
from pedzoo.sim.physics_parts.camera import FLOOR, OUTSIDE, WALL, Lens

CUT_HEIGHT = 1.0
"""Metres at which walls are cut off in pictures from above, so that people behind them are seen."""

_NEAREST = 0.05
"""Metres from which on robots see."""

BODY_HEIGHT = 1.75
"""Metres of a person's capsule in the scene of physics, with both round ends."""

SHAPES = 16
"""pybullet takes so many shapes per body and drops the others without a word."""

AWAY = (0.0, 0.0, -100.0)
"""Where unused bodies wait: below the floor."""

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""No rotation, as a quaternion."""


class BulletLooks:
    """Walls and figures of people in a pybullet client of their own.

    pybullet draws every body that can be collided with, in colours of its choice. And a GPU's renderer shows
    only what is made after it is loaded, which takes long: programs without pictures should not wait for it.
    """

    def __init__(
        self, boxes: NDArray[np.float64], wall_height: float = CUT_HEIGHT, window: bool = False
    ) -> None:
        """Connect, and build walls of ``wall_height`` metres over the rectangles ``boxes`` (M, 4).

        With a ``window`` all is seen on the display.
        """
        pybullet, client, self._finalizer = connect(self, window)
        self._p, self.client = pybullet, client
        plugin = None if window else egl_plugin()
        self._egl = plugin is not None and load_egl(client, plugin)
        for i in range(0, len(boxes), SHAPES):
            part = boxes[i : i + SHAPES]
            shape = pybullet.createVisualShapeArray(
                shapeTypes=[pybullet.GEOM_BOX] * len(part),
                halfExtents=half_extents(part, wall_height),
                visualFramePositions=middles(part, wall_height),
                rgbaColors=[_rgba(WALL)] * len(part),
                physicsClientId=client,
            )
            pybullet.createMultiBody(0, -1, shape, physicsClientId=client)
        self._figures = Figures(pybullet, client, AWAY)

    def look_at(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Let the window show a rectangle from above, from its south.

        Args:
            low: Its lower corner (x, y), metres.
            high: Its upper corner (x, y), metres.
        """
        width, depth = high[0] - low[0], high[1] - low[1]
        self._p.resetDebugVisualizerCamera(
            cameraDistance=max(0.5 * width, 0.7 * depth) + 1,
            cameraYaw=0,
            cameraPitch=-65,
            cameraTargetPosition=[(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0],
            physicsClientId=self.client,
        )

    def close(self) -> None:
        """Disconnect; a second time does nothing."""
        self._finalizer()

    def render(
        self,
        figures: dict[int, Figure],
        size: tuple[int, int],
        eye: tuple[Sequence[float], Sequence[float], Sequence[float]],
        view_angle: float,
    ) -> NDArray[np.uint8]:
        """Return a picture (H, W, 3) uint8 RGB.

        Args:
            figures: How to draw which agent.
            size: Width and height in pixels.
            eye: Where the camera stands, what it looks at and which way is up.
            view_angle: Horizontal opening angle, radians.
        """
        width, height = size
        distance = math.dist(eye[0], eye[1])
        upright = 2 * math.atan(math.tan(view_angle / 2) * height / width)
        picture, _, empty = self._shot(
            figures, size, eye, upright, (max(0.1, 0.2 * distance), 3 * distance + 10)
        )
        # The floor is where no body is: one to draw takes longer on the CPU than all the rest.
        picture[empty] = FLOOR
        return picture

    def onboard(
        self,
        figures: dict[int, Figure],
        place: Sequence[float],
        ahead: Sequence[float],
        lens: Lens,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return a picture (H, W, 3) uint8 RGB and the depth (H, W), metres, as a robot sees it.

        Args:
            figures: See `render`.
            place: Where the camera stands (x, y), metres.
            ahead: The direction (x, y) in which it looks.
            lens: Its pixels, angle and height.
        """
        (x, y), (dx, dy), z = place, ahead, lens.eye_height
        size, farthest = (lens.width, lens.height), 1.2 * lens.reach + 1
        upright = 2 * math.atan(math.tan(lens.angle / 2) * lens.height / lens.width)
        eye = ([x, y, z], [x + dx, y + dy, z], [0.0, 0.0, 1.0])
        picture, buffer, empty = self._shot(figures, size, eye, upright, (_NEAREST, farthest))
        depth = _NEAREST * farthest / (farthest - (farthest - _NEAREST) * buffer)
        floor = np.broadcast_to(lens.floor()[:, None], empty.shape)
        picture[empty] = np.where(floor[empty, None] < np.inf, FLOOR, OUTSIDE)
        depth[empty] = floor[empty]
        return picture, np.minimum(depth, lens.reach).astype(np.float32)

    def _shot(
        self,
        figures: dict[int, Figure],
        size: tuple[int, int],
        eye: tuple[Sequence[float], Sequence[float], Sequence[float]],
        upright: float,
        limits: tuple[float, float],
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.bool_]]:
        """Return colours (H, W, 3), the depth buffer (H, W) and where no body is (H, W).

        The vertical opening angle ``upright`` is in radians, and ``limits``, the planes between which bodies
        are drawn, in metres.
        """
        self._figures.show(figures)
        width, height = size
        image = self._p.getCameraImage(
            width,
            height,
            viewMatrix=self._p.computeViewMatrix(*eye),
            projectionMatrix=self._p.computeProjectionMatrixFOV(
                math.degrees(upright), width / height, *limits
            ),
            lightDirection=(-3, -5, 12),
            lightColor=(1, 1, 1),
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._p.ER_BULLET_HARDWARE_OPENGL if self._egl else self._p.ER_TINY_RENDERER,
            physicsClientId=self.client,
        )
        picture = np.asarray(image[2], dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        buffer = np.asarray(image[3], dtype=np.float64).reshape(height, width)
        return picture, buffer, np.asarray(image[4]).reshape(height, width) < 0

    def place(self, figures: dict[int, Figure]) -> None:
        """Show these agents, see `render`, and no others."""
        self._figures.show(figures)


def half_extents(part: NDArray[np.float64], height: float) -> list[list[float]]:
    """Return the half sides (x, y, z) of walls over rectangles (M, 4)."""
    return [[*half, height / 2] for half in ((part[:, 2:] - part[:, :2]) / 2).tolist()]


def middles(part: NDArray[np.float64], height: float) -> list[list[float]]:
    """Return the centres (x, y, z) of walls that stand on rectangles (M, 4)."""
    return [[*middle, height / 2] for middle in ((part[:, :2] + part[:, 2:]) / 2).tolist()]


def _rgba(color: tuple[int, int, int]) -> list[float]:
    return [*(value / 255 for value in color), 1.0]
