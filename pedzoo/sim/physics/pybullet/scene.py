"""Floor plans in pybullet: extruded walls, a capsule per person, and scenes in the frames of these plans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.maps.bank import MapBank
from pedzoo.maps.boxes import boxes
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.sim.camera import Affine, scene_to_grid
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.physics.pybullet.client import AWAY, SHAPES, UPRIGHT, build_walls, check_connected, connect
from pedzoo.sim.physics.pybullet.looks import BulletLooks
from pedzoo.sim.physics.pybullet.robots import BulletRobots, DrivenRobots

BODY_HEIGHT = 1.75
"""Metres of a person's capsule, with both round ends."""

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
        self._walls = build_walls(self.client, self.boxes)
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

    def people_meet(self, person: int, other: int, than: float) -> bool:
        """Return whether the capsules of two agents are nearer to each other than some metres."""
        return self.nearer(self._bodies[person, self._radius], self._bodies[other, self._radius], than)

    def hits_wall(self, person: int, box: int, than: float) -> bool:
        """Return whether an agent's capsule is nearer to the walls around a box than some metres."""
        return self.nearer(self._bodies[person, self._radius], self._walls[box // SHAPES], than)

    def nearer(self, one: int, body: int, than: float) -> bool:
        """Return whether a body is nearer to another body than some metres."""
        points = self._p.getClosestPoints(one, body, max(than, 0.0), physicsClientId=self.client)
        return any(point[8] < than for point in points)

    def capsule(self, person: int, place: Sequence[float]) -> int:
        """Put an agent's capsule somewhere; returns the body."""
        self.place(person, *place)
        return self._bodies[person, self._radius]

    def walls(self, boxes: NDArray[np.int64]) -> list[int]:
        """Return the bodies that some boxes are part of."""
        return [self._walls[part] for part in np.unique(boxes // SHAPES).tolist()]

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


class PlacedScene(NamedTuple):
    """One scene of a question.

    Attributes:
        index: Which of the B scenes.
        bullet: Where its floor plan is built.
        affine: From the scene to pybullet's frame.
        places: Where agents are in pybullet's frame (A, 2), metres.
        present: Numbers of the agents that are there, in ascending order.
    """

    index: int
    bullet: BulletScene
    affine: Affine
    places: NDArray[np.float64]
    present: list[int]


class BulletScenes:
    """One pybullet client per floor plan, made when it is first asked about; copies make their own."""

    def __init__(self, bank: MapBank, body_radius: float, urdf: str | None = None) -> None:
        """Take the floor plans, the usual radius of bodies, metres, and the file of robots' bodies."""
        self.bank, self.body_radius, self.urdf = bank, body_radius, urdf
        self._scenes: dict[int, BulletScene] = {}
        self._closed = False

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_scenes": {}}

    def __getitem__(self, row: int) -> BulletScene:
        """Return the client of a floor plan by its row in the bank, -1 for the open floor.

        Raises:
            UserError: All were closed, or this client is gone.
        """
        if self._closed:
            raise UserError("this Bullet was closed: make a new one, Bullet(bank)")
        if row not in self._scenes:
            grid = self.bank.grids[row] if row >= 0 else None
            self._scenes[row] = BulletScene(grid, self.bank.unknown, self.body_radius, self.urdf)
        self._scenes[row].check()
        return self._scenes[row]

    def close(self) -> None:
        """Disconnect all clients."""
        for scene in self._scenes.values():
            scene.close()
        self._scenes.clear()
        self._closed = True

    def placed(self, people: Bodies, present: Tensor) -> Iterator[PlacedScene]:
        """Yield scene after scene, with those of their agents that are ``present`` (B, A) bool."""
        rows = self.bank.index(people.map_id[:, 0]).tolist()
        places, poses = as_array(people.position), people.pose.tolist()
        for index, (row, pose, here) in enumerate(zip(rows, poses, present.tolist(), strict=True)):
            affine = _frame(self.bank.grids[row] if row >= 0 else None, tuple(pose))
            present_people = [person for person, there in enumerate(here) if there]
            yield PlacedScene(index, self[row], affine, moved(affine, places[index]), present_people)


@lru_cache(maxsize=1024)
def _frame(grid: OccupancyGrid | None, pose: tuple[float, ...]) -> Affine:
    """Return the map from a scene to pybullet's frame: poses stay as they are."""
    return scene_to_grid(torch.tensor(pose), grid)


def as_array(points: Tensor) -> NDArray[np.float64]:
    """Return a tensor as numpy's doubles."""
    return points.detach().cpu().double().numpy()


def moved(affine: Affine, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (..., 2) by an affine map."""
    return points @ affine[:, :2].T + affine[:, 2]


def scene_rays(
    asked: PlacedScene,
    radius: list[float],
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float64]:
    """Return how far rays of one scene go (R,), metres, at most ``reach``.

    Args:
        asked: The scene.
        radius: Of all agents' bodies, metres.
        start: Where rays begin (R, 2) in pybullet's frame.
        along: Unit vectors (R, 2).
        reach: Metres.
    """
    asked.bullet.clear()
    for person in asked.present:
        asked.bullet.place(person, *asked.places[person], radius=radius[person])
    # pybullet hits some bodies from inside and others not: bodies around the start are taken away
    starts, of = np.unique(start, axis=0, return_inverse=True)
    apart = starts[:, None] - asked.places[None, asked.present]
    holds = np.square(apart).sum(-1) <= np.square([radius[person] for person in asked.present])
    groups, group = np.unique(holds, axis=0, return_inverse=True)
    group = group.reshape(-1)[of.reshape(-1)]
    result = np.full(len(start), reach)
    for number, held in enumerate(groups):
        taken = [person for person, inside in zip(asked.present, held, strict=True) if inside]
        for person in taken:
            asked.bullet.remove(person, radius[person])
        rays = np.flatnonzero(group == number)
        result[rays] = reach * asked.bullet.rays(start[rays], start[rays] + reach * along[rays])
        for person in taken:
            asked.bullet.place(person, *asked.places[person], radius=radius[person])
    result[asked.bullet.in_wall(start)] = 0.0
    return result
