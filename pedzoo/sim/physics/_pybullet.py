"""pybullet itself: imported without its greeting, clients, walls, and a GPU's renderer where that works."""

from __future__ import annotations

import importlib.util
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError, install_command

SHAPES = 16
"""pybullet takes so many shapes per body and drops the others without a word."""

WALL_HEIGHT = 2.5
"""Metres."""

AWAY = (0.0, 0.0, -100.0)
"""Where unused bodies wait: below the floor."""

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""No rotation, as a quaternion."""


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
    """Return the bodies of walls over rectangles (M, 4), at most `SHAPES` for each body.

    Args:
        client: Where they are.
        boxes: Corners x0, y0, x1, y1, metres.
        height: Metres.
        color: RGBA of walls that are seen alone; None for walls that bodies collide with.
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
