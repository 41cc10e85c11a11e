"""What pybullet's cameras see: walls of a floor plan, people and robots, apart from the bodies of physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.camera import ROBOT_BODY, ROBOT_FRONT, WALL, person_color
from pedzoo.sim.drawing import HAIR, SKIN
from pedzoo.sim.physics._pybullet import AWAY, UPRIGHT, about_z, build_walls, connect, egl_plugin, quiet

CUT_HEIGHT = 1.0
"""Metres at which walls are cut off in pictures from above, so that people behind them are seen."""

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
    """How an agent is drawn: where it stands and how wide it is, metres, and where it faces, radians."""

    x: float
    y: float
    radius: float
    heading: float = 0.0
    robot: bool = False


Eye = tuple[Sequence[float], Sequence[float], Sequence[float]]
"""Where a camera stands, what it looks at and which way is up, (x, y, z) each."""


class BulletLooks:
    """Walls and figures of people in a pybullet client of their own.

    pybullet draws every body that can be collided with, in colours of its choice. And a GPU's renderer shows
    only what is made after it is loaded, which takes long: programs without pictures should not wait for it.

    Attributes:
        client: Theirs.
    """

    def __init__(
        self, boxes: NDArray[np.float64], wall_height: float = CUT_HEIGHT, window: bool = False
    ) -> None:
        """Connect, and build walls of ``wall_height`` metres over the rectangles ``boxes`` (M, 4).

        With a ``window`` all is seen on the display.
        """
        self.client = connect(window)
        self._egl = False
        if not window and (plugin := egl_plugin()):
            with quiet(1), quiet(2):
                self._egl = self.client.loadPlugin(plugin, "_eglRendererPlugin") >= 0
        build_walls(self.client, boxes, wall_height, _rgba(WALL))
        self._bodies: dict[tuple[int, float, bool], int] = {}

    def look_at(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Let the window show the rectangle from ``low`` to ``high`` (x, y), metres, from above its south."""
        width, depth = high[0] - low[0], high[1] - low[1]
        self.client.resetDebugVisualizerCamera(
            cameraDistance=max(0.5 * width, 0.7 * depth) + 1,
            cameraYaw=0,
            cameraPitch=-65,
            cameraTargetPosition=[(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0],
        )

    def shot(
        self,
        figures: dict[int, Figure],
        size: tuple[int, int],
        eye: Eye,
        angle: float,
        limits: tuple[float, float],
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.bool_]]:
        """Return colours (H, W, 3) uint8 RGB, depths (H, W), metres, and where no body is (H, W).

        Args:
            figures: How to draw which agent.
            size: Width and height in pixels.
            eye: The camera.
            angle: Its horizontal opening angle, radians.
            limits: Metres between which bodies are drawn.
        """
        self.place(figures)
        (width, height), (least, most) = size, limits
        upright = 2 * math.atan(math.tan(angle / 2) * height / width)
        image = self.client.getCameraImage(
            width,
            height,
            viewMatrix=self.client.computeViewMatrix(*eye),
            projectionMatrix=self.client.computeProjectionMatrixFOV(
                math.degrees(upright), width / height, *limits
            ),
            lightDirection=(-3, -5, 12),
            lightColor=(1, 1, 1),
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self.client.ER_BULLET_HARDWARE_OPENGL if self._egl else self.client.ER_TINY_RENDERER,
        )
        picture = np.asarray(image[2], dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        buffer = np.asarray(image[3], dtype=np.float64).reshape(height, width)
        depth = least * most / (most - (most - least) * buffer)
        return picture, depth, np.asarray(image[4]).reshape(height, width) < 0

    def place(self, figures: dict[int, Figure]) -> None:
        """Show these agents and no others; the body of each is made when it is first shown."""
        for agent, figure in figures.items():
            key = agent, figure.radius, figure.robot
            if key not in self._bodies:
                self._bodies[key] = self._robot(figure.radius) if figure.robot else self._person(*key[:2])
        for (agent, *looks), body in self._bodies.items():
            figure = figures.get(agent)
            place, heading = AWAY, 0.0
            if figure and [figure.radius, figure.robot] == looks:
                place, heading = (figure.x, figure.y, 0.0), figure.heading
            self.client.resetBasePositionAndOrientation(body, place, about_z(heading))

    def _person(self, agent: int, radius: float) -> int:
        shirt = person_color(agent)
        dark = round(_DARKER * shirt[0]), round(_DARKER * shirt[1]), round(_DARKER * shirt[2])
        colors = {"shirt": shirt, "trousers": dark, "skin": SKIN, "hair": HAIR}
        broad = min(max(radius / BODY_RADIUS, BROADER[0]), BROADER[1])
        right = [(*part, (x, -y, z)) for *part, (x, y, z) in _SIDE]
        cloth, radii, lengths, axes, places = zip(*_SIDE, *right, *_MIDDLE, strict=True)
        return self._body(
            shapeTypes=[self.client.GEOM_CAPSULE] * len(cloth),
            radii=[broad * value for value in radii],
            lengths=lengths,
            visualFramePositions=[(broad * x, broad * y, z) for x, y, z in places],
            visualFrameOrientations=[_AXES[axis] for axis in axes],
            rgbaColors=[_rgba(colors[name]) for name in cloth],
        )

    def _robot(self, radius: float) -> int:
        return self._body(
            shapeTypes=[self.client.GEOM_CYLINDER] * 2,
            radii=[radius, 0.3 * radius],
            lengths=[ROBOT_HEIGHT - 0.03, 0.11],
            visualFramePositions=[(0.0, 0.0, ROBOT_HEIGHT / 2), (0.6 * radius, 0.0, ROBOT_HEIGHT - 0.045)],
            rgbaColors=[_rgba(ROBOT_BODY), _rgba(ROBOT_FRONT)],
        )

    def _body(self, **shapes: Any) -> int:
        """Return a new body of some shapes; nothing can collide with it."""
        return self.client.createMultiBody(0, -1, self.client.createVisualShapeArray(**shapes), AWAY)


def _rgba(color: tuple[int, int, int]) -> tuple[float, ...]:
    return *(value / 255 for value in color), 1.0
