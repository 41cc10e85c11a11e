"""Pictures of scenes with robots: from the top, with their headings and goals."""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pedzoo.core.errors import UserError, installed
from pedzoo.core.geometry import direction_of
from pedzoo.sim.physics_parts.camera import Camera, check_size, person_color
from pedzoo.sim.physics_parts.floor_marks import draw_goal
from pedzoo.sim.physics_parts.state_picture import bodies_seen
from pedzoo.sim.robot_parts.env import RobotEnv

MODES = ("rgb_array", "human")
"""What ``render_mode`` may be, beside None."""


def modes_here() -> list[str]:
    """Return the modes of this machine: a window needs a display."""
    shown = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    backend = os.environ.get("MPLBACKEND", "").lower()
    drawn = backend not in ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
    return [*MODES] if shown and drawn and installed("matplotlib") else [*MODES[:1]]


class Pictures:
    """Takes pictures of the scenes of an environment, or shows the first one in a window."""

    def __init__(self, env: RobotEnv, mode: str | None, size: tuple[int, int]) -> None:
        """Take the environment; ``size`` is width and height in pixels.

        Raises:
            UserError: There is no such size, or no display to show a window on.
        """
        check_size(size)
        self._env, self._mode, self._size = env, mode, size
        self._cameras: dict[int, Camera] = {}
        self._window: Any = _window() if mode == "human" else None

    def begin(self) -> None:
        """Look anew where scenes begin: the camera then stands still until their end."""
        self._cameras.clear()
        self.show()

    def show(self) -> None:
        """Draw into the window, if there is one."""
        if self._window is not None:
            self._window.clear()
            self._window.set_axis_off()
            self._window.imshow(self._of(0))
            self._window.figure.canvas.draw_idle()
            self._window.figure.canvas.flush_events()

    def taken(self) -> list[NDArray[np.uint8]] | None:
        """Return a picture (H, W, 3) RGB of every scene, in the mode ``rgb_array``."""
        if self._mode != "rgb_array":
            return None
        return [self._of(scene) for scene in range(self._env.batch_size[0])]

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window.figure)
            self._window = None

    def _of(self, scene: int) -> NDArray[np.uint8]:
        import cv2

        env, state = self._env, self._env.state
        bodies = bodies_seen(state)
        if scene not in self._cameras:
            there = state.mask[scene]
            seen = torch.cat((state.position[scene][there], state.goal_point[scene][there]))
            open_floor = int(state.map_id[scene]) < 0
            camera = Camera().around(seen, self._size) if open_floor else None
            self._cameras[scene] = env.physics.framed(bodies, scene, self._size, camera)
        camera = self._cameras[scene]
        image = np.ascontiguousarray(env.physics.image(bodies, scene, self._size, camera))
        to_pixel = camera.to_pixel(self._size)

        def pixel(point: torch.Tensor) -> tuple[int, int]:
            x, y = to_pixel[:, :2] @ point.detach().cpu().double().numpy() + to_pixel[:, 2]
            return round(float(x)), round(float(y))

        for slot in range(state.mask.shape[1] - env.robots, state.mask.shape[1]):
            if state.mask[scene, slot]:
                heading, radius = state.heading[scene, slot], state.radius[scene, slot]
                here = state.position[scene, slot]
                front = here + radius * direction_of(heading)
                wide = max(3, round(float(radius) * to_pixel[0, 0]))
                cv2.circle(image, pixel(here), wide, (0, 0, 0), 2, cv2.LINE_AA)
                cv2.line(image, pixel(here), pixel(front), (0, 0, 0), 2, cv2.LINE_AA)
                draw_goal(image, state.goal_point[scene, slot], camera, self._size, person_color(slot), 2)
        return image


def _window() -> Any:
    import matplotlib.pyplot as plt
    from matplotlib.backends.registry import BackendFilter, backend_registry

    backend = plt.get_backend()
    windows = [name.lower() for name in backend_registry.list_builtin(BackendFilter.INTERACTIVE)]
    if backend.lower() not in windows:
        raise UserError(
            f"render_mode 'human' needs a display, and matplotlib has none here (its backend is {backend}): "
            "use render_mode='rgb_array', or set DISPLAY"
        )
    plt.ion()
    return plt.figure("pedzoo").add_axes((0, 0, 1, 1))
