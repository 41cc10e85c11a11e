"""What pybullet's cameras see: walls of a floor plan, people and robots, apart from the bodies of physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.camera import FLOOR, OUTSIDE, ROBOT_BODY, ROBOT_FRONT, WALL, Lens, person_color
from pedzoo.sim.drawing import HAIR, SKIN
from pedzoo.sim.physics.pybullet.client import (
    AWAY,
    UPRIGHT,
    about_z,
    connect,
    egl_plugin,
    load_egl,
    walls_over,
)

CUT_HEIGHT = 1.0
"""Metres at which walls are cut off in pictures from above, so that people behind them are seen."""

_NEAREST = 0.05
"""Metres from which on robots see."""

BROADER = (0.8, 1.4)
"""Figures are broader where bodies are wider than usual, within these limits."""

ROBOT_HEIGHT = 0.6
"""Metres."""

_DARKER = 0.55
"""Share of a person's colour that trousers have."""

_AXES = {
    "x": (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)),
    "y": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)),
    "z": UPRIGHT,
}
"""Rotations of what lies along an axis, as quaternions."""

_SIDE = (
    ("trousers", 0.078, 0.74, "z", (0.0, 0.09, 0.46)),
    ("trousers", 0.05, 0.12, "x", (0.05, 0.09, 0.05)),
    ("shirt", 0.115, 0.36, "z", (0.0, 0.05, 1.17)),
    ("shirt", 0.05, 0.42, "z", (0.0, 0.21, 1.15)),
    ("skin", 0.04, 0.05, "z", (0.03, 0.215, 0.85)),
)
_MIDDLE = (
    ("trousers", 0.11, 0.1, "y", (0.0, 0.0, 0.93)),
    ("shirt", 0.08, 0.32, "y", (0.0, 0.0, 1.37)),
    ("skin", 0.05, 0.1, "z", (0.01, 0.0, 1.48)),
    ("skin", 0.085, 0.05, "z", (0.02, 0.0, 1.62)),
    ("hair", 0.088, 0.05, "z", (-0.012, 0.0, 1.645)),
)
"""Capsules of a person, at most `SHAPES`: colour, radius, length, axis, middle; those of a side on both."""


class Figure(NamedTuple):
    """How an agent is drawn, in pybullet's frame.

    Attributes:
        x: Metres.
        y: Metres.
        radius: Of the body, metres.
        heading: Where it faces, radians.
        robot: Whether it is a robot.
    """

    x: float
    y: float
    radius: float
    heading: float = 0.0
    robot: bool = False


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
        for half, middle in walls_over(boxes, wall_height):
            looks = {
                "halfExtents": half,
                "visualFramePositions": middle,
                "rgbaColors": [_rgba(WALL)] * len(half),
            }
            self._body((0.0, 0.0, 0.0), shapeTypes=[pybullet.GEOM_BOX] * len(half), **looks)
        self._bodies: dict[tuple[int, float, bool], int] = {}

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
        self.place(figures)
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
        """Show these agents, see `render`, and no others; the body of each is made when it is first shown."""
        for agent, figure in figures.items():
            key = agent, figure.radius, figure.robot
            if key not in self._bodies:
                self._bodies[key] = self._robot(figure.radius) if figure.robot else self._person(*key[:2])
        for (agent, *looks), body in self._bodies.items():
            figure = figures.get(agent)
            place, heading = AWAY, 0.0
            if figure and [figure.radius, figure.robot] == looks:
                place, heading = (figure.x, figure.y, 0.0), figure.heading
            self._p.resetBasePositionAndOrientation(
                body, place, about_z(heading), physicsClientId=self.client
            )

    def _person(self, agent: int, radius: float) -> int:
        shirt = person_color(agent)
        dark = round(_DARKER * shirt[0]), round(_DARKER * shirt[1]), round(_DARKER * shirt[2])
        colors = {"shirt": shirt, "trousers": dark, "skin": SKIN, "hair": HAIR}
        broad = min(max(radius / BODY_RADIUS, BROADER[0]), BROADER[1])
        right = [(*part, (x, -y, z)) for *part, (x, y, z) in _SIDE]
        cloth, radii, lengths, axes, places = zip(*_SIDE, *right, *_MIDDLE, strict=True)
        return self._body(
            AWAY,
            shapeTypes=[self._p.GEOM_CAPSULE] * len(cloth),
            radii=[broad * value for value in radii],
            lengths=lengths,
            visualFramePositions=[(broad * x, broad * y, z) for x, y, z in places],
            visualFrameOrientations=[_AXES[axis] for axis in axes],
            rgbaColors=[_rgba(colors[name]) for name in cloth],
        )

    def _robot(self, radius: float) -> int:
        return self._body(
            AWAY,
            shapeTypes=[self._p.GEOM_CYLINDER] * 2,
            radii=[radius, 0.3 * radius],
            lengths=[ROBOT_HEIGHT - 0.03, 0.11],
            visualFramePositions=[(0.0, 0.0, ROBOT_HEIGHT / 2), (0.6 * radius, 0.0, ROBOT_HEIGHT - 0.045)],
            rgbaColors=[_rgba(ROBOT_BODY), _rgba(ROBOT_FRONT)],
        )

    def _body(self, place: Sequence[float], **shapes: Any) -> int:
        """Return a new body of some shapes; nothing can collide with it."""
        looks = self._p.createVisualShapeArray(**shapes, physicsClientId=self.client)
        return self._p.createMultiBody(0, -1, looks, place, physicsClientId=self.client)


def _rgba(color: tuple[int, int, int]) -> list[float]:
    return [*(value / 255 for value in color), 1.0]
