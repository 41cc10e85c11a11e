"""Looks of a floor plan for pybullet's cameras, apart from the bodies of physics."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pedzoo.sim.physics_parts.camera import FLOOR, WALL, person_color
from pedzoo.sim.physics_parts.pybullet_client import connect, egl_plugin, load_egl

_CUT_HEIGHT = 1.0
"""Metres at which walls are cut off in pictures, so that people behind them are seen."""

BODY_HEIGHT = 1.75
"""Metres, with both round ends of the capsule."""

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

    def __init__(self, boxes: NDArray[np.float64]) -> None:
        """Connect, and build walls over the rectangles ``boxes`` (M, 4)."""
        pybullet, client, self._finalizer = connect(self)
        self._p, self.client = pybullet, client
        plugin = egl_plugin()
        self._egl = plugin is not None and load_egl(client, plugin)
        for i in range(0, len(boxes), SHAPES):
            part = boxes[i : i + SHAPES]
            shape = pybullet.createVisualShapeArray(
                shapeTypes=[pybullet.GEOM_BOX] * len(part),
                halfExtents=half_extents(part, _CUT_HEIGHT),
                visualFramePositions=middles(part, _CUT_HEIGHT),
                rgbaColors=[_rgba(WALL)] * len(part),
                physicsClientId=client,
            )
            pybullet.createMultiBody(0, -1, shape, physicsClientId=client)
        self._figures: dict[tuple[int, float], int] = {}

    def close(self) -> None:
        """Disconnect; a second time does nothing."""
        self._finalizer()

    def render(
        self,
        positions: dict[int, tuple[float, float, float]],
        size: tuple[int, int],
        eye: tuple[Sequence[float], Sequence[float], Sequence[float]],
        view_angle: float,
    ) -> NDArray[np.uint8]:
        """Return a picture (H, W, 3) uint8 RGB.

        Args:
            positions: Where to draw which agent: x, y and the radius of its body, metres.
            size: Width and height in pixels.
            eye: Where the camera stands, what it looks at and which way is up.
            view_angle: Horizontal opening angle, radians.
        """
        shown = {self._figure(person, radius): (x, y) for person, (x, y, radius) in positions.items()}
        for body in self._figures.values():
            place = (*shown[body], BODY_HEIGHT / 2) if body in shown else AWAY
            self._p.resetBasePositionAndOrientation(body, place, UPRIGHT, physicsClientId=self.client)
        width, height = size
        distance = math.dist(eye[0], eye[1])
        upright = 2 * math.atan(math.tan(view_angle / 2) * height / width)
        image = self._p.getCameraImage(
            width,
            height,
            viewMatrix=self._p.computeViewMatrix(*eye),
            projectionMatrix=self._p.computeProjectionMatrixFOV(
                math.degrees(upright), width / height, max(0.1, 0.2 * distance), 3 * distance + 10
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
        # The floor is where no body is: one to draw takes longer on the CPU than all the rest.
        picture[np.asarray(image[4]).reshape(height, width) < 0] = FLOOR
        return picture

    def _figure(self, person: int, radius: float) -> int:
        """Return the body that is drawn for an agent; the first time, it is made."""
        if (person, radius) not in self._figures:
            shape = self._p.createVisualShape(
                self._p.GEOM_CAPSULE,
                radius=radius,
                length=max(BODY_HEIGHT - 2 * radius, 0.0),
                rgbaColor=_rgba(person_color(person)),
                physicsClientId=self.client,
            )
            body = self._p.createMultiBody(0, -1, shape, AWAY, physicsClientId=self.client)
            self._figures[person, radius] = body
        return self._figures[person, radius]


def half_extents(part: NDArray[np.float64], height: float) -> list[list[float]]:
    """Return the half sides (x, y, z) of walls over rectangles (M, 4)."""
    return [[*half, height / 2] for half in ((part[:, 2:] - part[:, :2]) / 2).tolist()]


def middles(part: NDArray[np.float64], height: float) -> list[list[float]]:
    """Return the centres (x, y, z) of walls that stand on rectangles (M, 4)."""
    return [[*middle, height / 2] for middle in ((part[:, :2] + part[:, 2:]) / 2).tolist()]


def _rgba(color: tuple[int, int, int]) -> list[float]:
    return [*(value / 255 for value in color), 1.0]
