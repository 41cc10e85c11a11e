"""pybullet itself: imported without its greeting, its clients, and a GPU's renderer where that works."""

from __future__ import annotations

import importlib.util
import math
import os
import subprocess
import sys
import weakref
from collections.abc import Callable, Iterator
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


def connect(owner: object, window: bool = False) -> tuple[Any, int, Callable[[], object]]:
    """Return the module, a new client that computes in this process, and the function that disconnects it.

    With a ``window`` it shows what it holds on the display.
    It is disconnected when ``owner`` is gone at the latest; doing it again does nothing.
    """
    pybullet = load_pybullet()
    if window:
        with quiet(1):  # its threads say that they begin
            client: int = pybullet.connect(pybullet.GUI)
        for panel in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS):
            pybullet.configureDebugVisualizer(panel, 0, physicsClientId=client)
    else:
        client = pybullet.connect(pybullet.DIRECT)
    return pybullet, client, weakref.finalize(owner, _disconnect, pybullet, client)


def _disconnect(pybullet: Any, client: int) -> None:
    if pybullet.isConnected(client):
        pybullet.disconnect(client)


def check_connected(client: int) -> None:
    """Check that a client is still there.

    Raises:
        UserError: It was disconnected from outside.
    """
    if not load_pybullet().isConnected(client):
        raise UserError(
            f"pybullet client {client} of this Bullet is gone, pybullet.disconnect was called: "
            "make a new Bullet(bank), and leave its clients to close()"
        )


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


def load_egl(client: int, plugin: str) -> bool:
    """Let a client draw with the GPU from now on; returns whether it does."""
    pybullet = load_pybullet()
    with quiet(1), quiet(2):
        return pybullet.loadPlugin(plugin, "_eglRendererPlugin", physicsClientId=client) >= 0


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


def walls_over(boxes: NDArray[np.float64], height: float) -> Iterator[tuple[list[Any], list[Any]]]:
    """Yield half sides and centres (x, y, z) of walls over rectangles (M, 4), body after body."""
    for part in (boxes[i : i + SHAPES] for i in range(0, len(boxes), SHAPES)):
        half, middle = (part[:, 2:] - part[:, :2]) / 2, (part[:, :2] + part[:, 2:]) / 2
        yield tuple(
            np.pad(sides, ((0, 0), (0, 1)), constant_values=height / 2).tolist() for sides in (half, middle)
        )


def build_walls(client: int, boxes: NDArray[np.float64]) -> list[int]:
    """Return the bodies of walls over rectangles (M, 4), at most `SHAPES` for each body."""
    pybullet, bodies = load_pybullet(), []
    for half, middle in walls_over(boxes, WALL_HEIGHT):
        shape = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(half),
            halfExtents=half,
            collisionFramePositions=middle,
            physicsClientId=client,
        )
        bodies.append(pybullet.createMultiBody(0, shape, physicsClientId=client))
        # A margin rounds corners by 0.4 of it in closest-point queries; without any, ray tests miss boxes.
        pybullet.changeDynamics(bodies[-1], -1, collisionMargin=1e-5, physicsClientId=client)
    return bodies
