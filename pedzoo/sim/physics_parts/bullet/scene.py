"""One floor plan in pybullet: extruded walls, a capsule per person, and questions about single bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.walls.boxes import boxes
from pedzoo.sim.physics_parts.bullet.client import check_connected, connect
from pedzoo.sim.physics_parts.bullet.looks import (
    AWAY,
    BODY_HEIGHT,
    SHAPES,
    UPRIGHT,
    BulletLooks,
)
from pedzoo.sim.physics_parts.bullet.robots import BulletRobots
from pedzoo.sim.physics_parts.bullet.walls import build_walls
from pedzoo.sim.physics_parts.bullet.wheels import DrivenRobots

RAY_HEIGHT = 1.0
"""Metres above the floor at which rays run: where a capsule is a cylinder."""

_LEAST_HEIGHT = 0.4
"""Metres of cylinder between the two ends of a capsule."""

_RAYS = 16384
"""pybullet takes so many rays per call (MAX_RAY_INTERSECTION_BATCH_SIZE)."""


class BulletScene:
    """A pybullet client with one floor plan in its grid's frame: no yaw, cell (0, 0) at the origin.

    Bodies have no mass and never move by themselves. Such bodies make no contact points, hence everything is
    asked with closest-point queries.

    Attributes:
        boxes: The rectangles below the walls (M, 4): x0, y0, x1, y1 in metres.
        robots: Bodies of robots; None where they are capsules, as people are.
    """

    boxes: NDArray[np.float64]

    def __init__(
        self, grid: OccupancyGrid | None, unknown: Unknown, body_radius: float, urdf: str | None = None
    ) -> None:
        """Connect, and build the walls; None is open floor. ``urdf`` is the file of robots' bodies.

        Raises:
            UserError: pybullet is not installed, or it cannot read the file.
        """
        self._p, self.client, self._finalizer = connect(self)
        self._radius = body_radius
        self._cells = grid.occupied(unknown) if grid else None
        self._resolution = grid.resolution if grid else 1.0
        ground = self._p.createCollisionShape(self._p.GEOM_PLANE, physicsClientId=self.client)
        self._p.createMultiBody(0, ground, physicsClientId=self.client)
        walls = boxes(grid, unknown) if grid else np.zeros((0, 4))
        # Boxes of one body lie near one another (Z-order): bodies are small, and rays miss most.
        self.boxes = walls[np.argsort(_z_order((walls[:, :2] + walls[:, 2:]) / 2), kind="stable")]
        parts = [self.boxes[i : i + SHAPES] for i in range(0, len(self.boxes), SHAPES)]
        self._walls = build_walls(self._p, self.client, parts)
        self._bodies: dict[tuple[int, float], int] = {}
        self._looks: dict[float, BulletLooks] = {}
        self._urdf = urdf
        self._driven: DrivenRobots | None = None
        self.robots = None if urdf is None else BulletRobots(self.client, urdf)

    def check(self) -> None:
        """Check that its clients are still there.

        Raises:
            UserError: It was disconnected from outside.
        """
        check_connected(self.client)
        for looks in self._looks.values():
            check_connected(looks.client)

    def close(self) -> None:
        """Disconnect; a second time does nothing."""
        self._finalizer()
        for looks in self._looks.values():
            looks.close()
        if self._driven is not None:
            self._driven.close()

    def place(self, person: int, x: float, y: float, radius: float | None = None) -> None:
        """Put an agent's capsule somewhere; the first time, it is made.

        Args:
            person: Number of the agent.
            x: Metres.
            y: Metres.
            radius: Metres; None for that of the scene. One agent has a capsule for each radius.
        """
        radius = self._radius if radius is None else radius
        body = self._bodies.get((person, radius))
        if body is None:
            # wide bodies keep a piece of cylinder, too, at the height of rays
            height = max(BODY_HEIGHT - 2 * radius, _LEAST_HEIGHT)
            shape = self._p.createCollisionShape(
                self._p.GEOM_CAPSULE, radius=radius, height=height, physicsClientId=self.client
            )
            body = self._p.createMultiBody(0, shape, basePosition=AWAY, physicsClientId=self.client)
            self._bodies[person, radius] = body
        self._put(body, (x, y, BODY_HEIGHT / 2 if radius == self._radius else RAY_HEIGHT))

    def clear(self) -> None:
        """Take all bodies away."""
        for body in self._bodies.values():
            self._put(body, AWAY)

    def remove(self, person: int, radius: float) -> None:
        """Take an agent's capsule away."""
        self._put(self._bodies[person, radius], AWAY)

    def _put(self, body: int, where: Sequence[float]) -> None:
        self._p.resetBasePositionAndOrientation(body, where, UPRIGHT, physicsClientId=self.client)

    def person_gap(self, person: int, other: int, within: float) -> tuple[float, NDArray[np.float64]] | None:
        """Return the gap between two bodies and the direction from the other, None beyond ``within`` metres.

        Gaps are negative where bodies overlap; directions are unit vectors (2,), or zero.
        """
        return self._gap(person, self._bodies[other, self._radius], within)

    def wall_gap(self, person: int, box: int, within: float) -> tuple[float, NDArray[np.float64]] | None:
        """Return the gap between a body and the walls around a box, and the direction from them, likewise."""
        return self._gap(person, self._walls[box // SHAPES], within)

    def nearer(self, robot: int, body: int, than: float) -> bool:
        """Return whether the body of a robot is nearer to another body than some metres."""
        points = self._p.getClosestPoints(robot, body, max(than, 0.0), physicsClientId=self.client)
        return any(point[8] < than for point in points)

    def capsule(self, person: int, place: Sequence[float]) -> int:
        """Put an agent's capsule somewhere; returns the body."""
        self.place(person, *place)
        return self._bodies[person, self._radius]

    def walls(self, boxes: NDArray[np.int64]) -> list[int]:
        """Return the bodies that some boxes are part of."""
        return [self._walls[part] for part in np.unique(boxes // SHAPES).tolist()]

    def _gap(self, person: int, body: int, within: float) -> tuple[float, NDArray[np.float64]] | None:
        mine = self._bodies[person, self._radius]
        points = self._p.getClosestPoints(mine, body, within, physicsClientId=self.client)
        if not points:
            return None
        nearest = min(points, key=lambda point: point[8])  # contactDistance
        x, y, _ = nearest[7]  # contactNormalOnB
        return nearest[8], np.array([x, y]) / (math.hypot(x, y) or 1.0)

    def in_wall(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which positions (N, 2) lie inside a wall."""
        inside = np.zeros(len(points), dtype=bool)
        if self._cells is not None:
            columns, rows = (np.floor(points / self._resolution).astype(np.int64)).T
            on = (columns >= 0) & (rows >= 0) & (rows < len(self._cells)) & (columns < self._cells.shape[1])
            inside[on] = self._cells[rows[on], columns[on]]
        return inside

    def rays(self, origin: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return which share of the way from ``origin`` to ``end`` (R, 2) is free (R,)."""
        height = np.full((len(origin), 1), RAY_HEIGHT)
        start, stop = np.hstack((origin, height)), np.hstack((end, height))
        shares = [
            hit[2]
            for i in range(0, len(origin), _RAYS)
            for hit in self._p.rayTestBatch(
                start[i : i + _RAYS], stop[i : i + _RAYS], numThreads=1, physicsClientId=self.client
            )
        ]
        return np.array(shares, dtype=np.float64)

    @property
    def driven(self) -> DrivenRobots:
        """The robots that drive by their wheels, in a client of their own; made the first time."""
        if self._driven is None:
            assert self._urdf is not None
            self._driven = DrivenRobots(self.boxes, self._urdf)
        return self._driven

    def looks(self, wall_height: float) -> BulletLooks:
        """Return what takes pictures of the scene, with walls of some metres; made the first time."""
        if wall_height not in self._looks:
            self._looks[wall_height] = BulletLooks(self.boxes, wall_height)
        return self._looks[wall_height]


def _z_order(points: NDArray[np.float64], side: float = 0.5) -> NDArray[np.int64]:
    """Morton numbers of positions (N, 2), metres above zero, on a lattice of ``side`` metres."""
    cells = (points / side).astype(np.int64)
    bits = np.arange(16)
    spread = ((cells[..., None] >> bits & 1) << 2 * bits).sum(axis=-1)
    return spread[:, 0] | spread[:, 1] << 1
