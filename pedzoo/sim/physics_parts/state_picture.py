"""A scene as it is now, from above, with the goals of its agents."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from pedzoo.sim.physics_parts.base import Physics
from pedzoo.sim.physics_parts.bodies import Bodies
from pedzoo.sim.physics_parts.camera import Camera, person_color
from pedzoo.sim.physics_parts.floor_marks import draw_goal
from pedzoo.sim.physics_parts.stance import Stance
from pedzoo.sim.state import State


def bodies_seen(state: State) -> Bodies:
    """Return the bodies of a state, and how they stand: for pictures."""
    return Bodies.of(state)._replace(stance=Stance.of(state))


def picture_of(
    state: State, physics: Physics, scene: int = 0, size: tuple[int, int] = (640, 480)
) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3) uint8 RGB of a scene, of ``size`` width and height in pixels."""
    bodies, there = bodies_seen(state), state.mask[scene]
    seen = torch.cat((state.position[scene][there], state.goal_point[scene][there]))
    open_floor = int(state.map_id[scene]) < 0
    camera = Camera().around(seen, size) if open_floor else None
    camera = physics.framed(bodies, scene, size, camera)
    image = np.ascontiguousarray(physics.image(bodies, scene, size, camera))
    for slot in (there & (state.goal_id[scene] >= 0)).nonzero()[:, 0].tolist():
        draw_goal(image, state.goal_point[scene, slot], camera, size, person_color(slot), width=2)
    return image
