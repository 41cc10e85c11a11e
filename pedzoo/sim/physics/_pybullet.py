"""pybullet: imported without its greeting, its clients, walls, and people and robots for its cameras."""

from __future__ import annotations

import importlib.util
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pedzoo.core.errors import UserError, install_command
from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.drawing import HAIR, ROBOT_BODY, ROBOT_FRONT, SKIN, WALL, person_color

SHAPES = 16
"""pybullet takes so many shapes per body and drops the others without a word."""

WALL_HEIGHT = 2.5
"""Metres."""

AWAY = (0.0, 0.0, -100.0)
"""Where unused bodies wait: below the floor."""

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""No rotation, as a quaternion."""

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


def load_pybullet() -> Any:
    """Return the module.

    Raises:
        UserError: It is not installed.
    """
    # the first time, it prints when it was built
    with nullcontext() if "pybullet" in sys.modules else quiet(2):
        try:
            import pybullet
        except ImportError as error:
            raise UserError(
                f"the physics 'bullet' needs pybullet, not installed here: {install_command('bullet')} (its "
                "Linux wheels stop at Python 3.11, beyond it pip install pybullet needs a C++ compiler), or "
                "take physics='compiled', which answers the same without it"
            ) from error
    return pybullet


def connect(window: bool = False) -> Any:
    """Return a client of this process: pybullet's functions, for what this client holds.

    With a ``window`` it shows that on the display. It disconnects when it is gone at the latest.
    """
    pybullet = load_pybullet()
    from pybullet_utils.bullet_client import BulletClient

    with quiet(1):  # it prints its options, and a window's threads that they begin
        client = BulletClient(pybullet.GUI if window else pybullet.DIRECT)
    for panel in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS) if window else ():
        client.configureDebugVisualizer(panel, 0)
    return client


def disconnect(client: Any) -> None:
    """Disconnect a client; a second time does nothing."""
    if client.isConnected():
        client.disconnect()


@cache
def egl_plugin() -> str | None:
    """Return the file of pybullet's GPU renderer, None where it does not work."""
    spec = importlib.util.find_spec("eglRenderer")
    devices = (Path("/dev/nvidiactl"), Path("/dev/dri"))
    if spec is None or spec.origin is None or not any(device.exists() for device in devices):
        return None
    # Where there is no driver for it, the plugin ends the whole process: another one goes first.
    code = (
        "import pybullet as p, sys; p.connect(p.DIRECT); "
        "assert p.loadPlugin(sys.argv[1], '_eglRendererPlugin') >= 0; "
        "p.getCameraImage(32, 32); print('drawn')"
    )
    try:
        tried = subprocess.run(
            [sys.executable, "-P", "-c", code, spec.origin], capture_output=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        return None
    return spec.origin if tried.returncode == 0 and b"drawn" in tried.stdout else None


@contextmanager
def quiet(stream: int) -> Iterator[None]:
    """Send a stream (1 or 2) of this process to nowhere, because C code does not ask `sys`."""
    sys.stdout.flush()
    sys.stderr.flush()
    stored, nowhere = os.dup(stream), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, stream)
        yield
    finally:
        os.dup2(stored, stream)
        os.close(stored)
        os.close(nowhere)


def about_z(angle: float) -> tuple[float, float, float, float]:
    """Return the rotation by an angle, radians, as a quaternion."""
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)


def build_walls(
    client: Any, boxes: NDArray[np.float64], height: float, color: tuple[float, ...] | None = None
) -> list[int]:
    """Return the bodies of walls over rectangles (M, 4), x0, y0, x1, y1 in metres: `SHAPES` in each at most.

    With a ``color``, RGBA, walls are seen alone; else bodies collide with them.
    """
    bodies = []
    for part in (boxes[i : i + SHAPES] for i in range(0, len(boxes), SHAPES)):
        flat = (part[:, 2:] - part[:, :2]) / 2, (part[:, :2] + part[:, 2:]) / 2
        half, middle = (np.pad(xy, ((0, 0), (0, 1)), constant_values=height / 2).tolist() for xy in flat)
        kinds = {"shapeTypes": [client.GEOM_BOX] * len(part), "halfExtents": half}
        if color is not None:
            seen = {"visualFramePositions": middle, "rgbaColors": [color] * len(part)}
            bodies.append(client.createMultiBody(0, -1, client.createVisualShapeArray(**kinds, **seen)))
            continue
        shape = client.createCollisionShapeArray(**kinds, collisionFramePositions=middle)
        bodies.append(client.createMultiBody(0, shape))
        # a margin rounds corners by 0.4 of it in closest-point queries
        client.changeDynamics(bodies[-1], -1, collisionMargin=1e-5)
    return bodies


class Figure(NamedTuple):
    """How an agent is drawn: where it stands and how wide it is, metres, and where it faces, radians."""

    x: float
    y: float
    radius: float
    heading: float = 0.0
    robot: bool = False


Eye = tuple[ArrayLike, ArrayLike, ArrayLike]
"""Where a camera stands, what it looks at and which way is up, (x, y, z) each."""


class BulletLooks:
    """Walls and figures of people in a pybullet ``client`` of their own, apart from the bodies of physics.

    pybullet draws every body that can be collided with, in colours of its choice. And a GPU's renderer shows
    only what is made after it is loaded, which takes long: programs without pictures should not wait for it.
    """

    def __init__(
        self, boxes: NDArray[np.float64], wall_height: float = CUT_HEIGHT, window: bool = False
    ) -> None:
        """Build walls of some height, metres, over rectangles (M, 4); a ``window`` shows all of them."""
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

        ``size`` is width and height in pixels, ``angle`` the camera's horizontal opening in radians; bodies
        are drawn between two ``limits``, metres.
        """
        self.place(figures)
        (width, height), (least, most) = size, limits
        upright = 2 * math.atan(math.tan(angle / 2) * height / width)
        image = self.client.getCameraImage(
            width,
            height,
            viewMatrix=self.client.computeViewMatrix(*(np.asarray(point).tolist() for point in eye)),
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
