"""Walls in pybullet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.sim.physics_parts.bullet.looks import half_extents, middles

WALL_HEIGHT = 2.5
"""Metres."""


def build_walls(pybullet: Any, client: int, parts: list[NDArray[np.float64]]) -> list[int]:
    """Return the bodies of walls over rectangles, at most `SHAPES` (M, 4) for each body."""
    return [_wall(pybullet, client, part) for part in parts]


def _wall(pybullet: Any, client: int, part: NDArray[np.float64]) -> int:
    shape = pybullet.createCollisionShapeArray(
        shapeTypes=[pybullet.GEOM_BOX] * len(part),
        halfExtents=half_extents(part, WALL_HEIGHT),
        collisionFramePositions=middles(part, WALL_HEIGHT),
        physicsClientId=client,
    )
    body = pybullet.createMultiBody(0, shape, physicsClientId=client)
    # A margin rounds corners by 0.4 of it in closest-point queries; without any, ray tests miss boxes.
    pybullet.changeDynamics(body, -1, collisionMargin=1e-5, physicsClientId=client)
    return body
