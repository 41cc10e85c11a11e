"""Robots of a URDF file in pybullet: where they stand, what they touch, and how wheels drive them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import expanded
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.physics._pybullet import (
    AWAY,
    SHAPES,
    UPRIGHT,
    WALL_HEIGHT,
    about_z,
    build_walls,
    connect,
    load_pybullet,
    quiet,
)

BODY_HEIGHT = 1.75
"""Metres of a person's capsule, with both round ends."""

_LEAST_HEIGHT = 0.4
"""Metres of cylinder between the two ends of a capsule."""

_BOUNDS = 0.0025
"""Metres by which the bounds that pybullet tells of a wheel are wider than the wheel, about."""

STEPS, _SETTLING = 24, 120
"""Steps of every 0.1 s, and those in which a robot that is put down comes to rest."""

_SECONDS = TRACE_SECONDS / STEPS
_FORCE = 1000.0
"""N m that motors have at most: speeds are limited by the robot's acceleration."""


def find_urdf(name: str) -> str:
    """Return the path of a URDF file, which may be one of pybullet_data's.

    Raises:
        UserError: There is no such file.
    """
    load_pybullet()
    import pybullet_data

    for path in (expanded(name), Path(pybullet_data.getDataPath()) / name):
        if path.is_file():
            return str(path.resolve())
    raise UserError(
        f"urdf {name}: no such file, neither from here nor in {pybullet_data.getDataPath()}: expected a path "
        "like robot.urdf or husky/husky.urdf"
    )


class Robots:
    """A body of a URDF file for each agent that is a robot; it stands with its lowest point on the floor."""

    def __init__(self, file: str, fixed: bool) -> None:
        """Load a file, which needs a shape to collide with; ``fixed`` bodies stay where they are put."""
        self.client, self._file, self._fixed = connect(), file, fixed
        first = self._load()
        self._bodies: dict[int, int] = {-1: first}
        links = range(-1, self.client.getNumJoints(first))
        solid = [link for link in links if self.client.getCollisionShapeData(first, link)]
        if not solid:
            raise UserError(f"urdf {file}: it has no collision shapes: expected at least one link with one")
        corners = [self.client.getAABB(first, link) for link in solid]
        # metres from a robot's origin to its farthest point, seen from above
        self.reach = max(math.hypot(max(-low[0], high[0]), max(-low[1], high[1])) for low, high in corners)
        self._height = -min(low[2] for low, _ in corners)
        self._inertial = self.client.getDynamicsInfo(first, -1)[3:5]
        self._outertial = self.client.invertTransform(*self._inertial)
        self.client.resetBasePositionAndOrientation(first, AWAY, UPRIGHT)

    def _load(self) -> int:
        with quiet(1), quiet(2):
            try:
                return self.client.loadURDF(self._file, useFixedBase=self._fixed)
            except self.client.error as error:
                raise UserError(f"urdf {self._file}: pybullet cannot load it ({error})") from error

    def body(self, agent: int) -> int:
        """Return the body of an agent; the first time, it is made."""
        if agent not in self._bodies:
            self._bodies[agent] = self._bodies.pop(-1) if -1 in self._bodies else self._load()
        return self._bodies[agent]

    def put(self, agent: int, place: Sequence[float], angle: float) -> int:
        """Let the body of an agent stand at (x, y), facing ``angle`` radians from x; returns the body."""
        body = self.body(agent)
        pose = self.client.multiplyTransforms((*place, self._height), about_z(angle), *self._inertial)
        self.client.resetBasePositionAndOrientation(body, *pose)
        return body

    def clear(self) -> None:
        """Take all bodies away, each to a place of its own."""
        # the floor throws out bodies that can move and are below it
        height = AWAY[2] if self._fixed else -AWAY[2]
        for number, body in enumerate(self._bodies.values()):
            self.client.resetBasePositionAndOrientation(body, (10.0 * number, 0.0, height), UPRIGHT)
            self.client.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3)


class Crossing(NamedTuple):
    """The way of the agents of one scene in S trace points of M sub-steps, in pybullet's frame, metres."""

    present: list[int]  # numbers of the agents that are there, in ascending order
    robots: NDArray[np.bool_]  # which agents have the body of the file (A,)
    path: NDArray[np.float64]  # positions at all sub-steps (A, S, M, 2)
    angle: NDArray[np.float64]  # where agents face at them (A, S, M), radians
    radius: NDArray[np.float64]  # of all bodies (A,)


class RobotShapes(Robots):
    """A floor plan with its robots, and a capsule for each person, to ask what touches.

    Bodies that never move by themselves make no contact points, hence the queries for closest points.
    """

    def __init__(self, boxes: NDArray[np.float64], file: str, body_radius: float, margin: float) -> None:
        """Build walls over rectangles (M, 4); bodies touch from ``margin`` metres on."""
        super().__init__(file, fixed=True)
        self._low, self._high = np.split(boxes, 2, axis=1)
        self._walls = build_walls(self.client, boxes, WALL_HEIGHT)
        self._usual, self._margin = body_radius, margin
        self._capsules: dict[int, int] = {}

    def touch(self, way: Crossing, agent: NDArray[np.bool_], wall: NDArray[np.bool_]) -> None:
        """Note which agents touch a robot or are one that touches something (A, S), and which touch walls."""
        self.clear()
        wide = np.where(way.robots, self.reach, way.radius) + self._margin
        for robot in (number for number in way.present if way.robots[number]):
            # two robots meet once
            others = [other for other in way.present if not way.robots[other] or other > robot]
            apart = np.linalg.norm(way.path[others] - way.path[robot], axis=-1)
            near = apart < (wide[others] + wide[robot])[:, None, None]
            here = way.path[robot][..., None, :]
            beside = ((here > self._low - wide[robot]) & (here < self._high + wide[robot])).all(-1)
            for tick, step in np.argwhere(near.any(0) | beside.any(-1)).tolist():
                body = self.put(robot, way.path[robot, tick, step].tolist(), way.angle[robot, tick, step])
                for other in np.array(others, dtype=np.int64)[near[:, tick, step]].tolist():
                    if not (agent[robot, tick] and agent[other, tick]):
                        met, extra = self._other(way, other, tick, step)
                        if self._nearer(body, met, extra):
                            agent[[robot, other], tick] = True
                if not wall[robot, tick]:
                    parts = np.unique(np.flatnonzero(beside[tick, step]) // SHAPES).tolist()
                    wall[robot, tick] = any(self._nearer(body, self._walls[i], self._margin) for i in parts)
        self.clear()

    def _other(self, way: Crossing, agent: int, tick: int, step: int) -> tuple[int, float]:
        """Put an agent where it is; returns its body and from how many metres on that touches."""
        place = way.path[agent, tick, step].tolist()
        if way.robots[agent]:
            return self.put(agent, place, way.angle[agent, tick, step]), self._margin
        if agent not in self._capsules:
            height = max(BODY_HEIGHT - 2 * self._usual, _LEAST_HEIGHT)
            shape = self.client.createCollisionShape(
                self.client.GEOM_CAPSULE, radius=self._usual, height=height
            )
            self._capsules[agent] = self.client.createMultiBody(0, shape, basePosition=AWAY)
        body = self._capsules[agent]
        self.client.resetBasePositionAndOrientation(body, (*place, BODY_HEIGHT / 2), UPRIGHT)
        return body, float(way.radius[agent]) - self._usual + self._margin

    def _nearer(self, one: int, other: int, than: float) -> bool:
        """Return whether a body is nearer to another one than some metres."""
        return any(point[8] < than for point in self.client.getClosestPoints(one, other, max(than, 0.0)))


class DrivenRobots(Robots):
    """One floor plan and its robots that drive by their wheels; people are not there, and push nothing."""

    def __init__(self, boxes: NDArray[np.float64], file: str) -> None:
        """Build walls over rectangles (M, 4), and let a robot come to rest; the file has to have wheels."""
        super().__init__(file, fixed=False)
        self.client.setGravity(0, 0, -9.81)
        self.client.setTimeStep(_SECONDS)
        self._find_wheels()
        self.client.createMultiBody(0, self.client.createCollisionShape(self.client.GEOM_PLANE))
        body = self.put(0, (0.0, 0.0), 0.0)
        self._turn(0, 0.0, 0.0, 1.0)
        for _ in range(_SETTLING):
            self.client.stepSimulation()
        # from now on bodies are put as high as this one stands
        pose = self.client.getBasePositionAndOrientation(body)
        self._height = self.client.multiplyTransforms(*pose, *self._outertial)[0][2]
        build_walls(self.client, boxes, WALL_HEIGHT)

    def _find_wheels(self) -> None:
        """Find the joints that turn and whose names say `wheel`, and `left` or `right`."""
        body, wheels = self._bodies[-1], []
        for joint in range(self.client.getNumJoints(body)):
            info = self.client.getJointInfo(body, joint)
            name = info[1].decode().lower()
            side = ("left" in name) - ("right" in name)
            if info[2] == self.client.JOINT_REVOLUTE and "wheel" in name and side:
                state = self.client.getLinkState(body, joint, computeForwardKinematics=1)
                low, high = self.client.getAABB(body, joint)
                along = self.client.rotateVector(state[5], info[13])[1]
                radius = max((high[2] - low[2]) / 2 - _BOUNDS, 1e-3)
                wheels.append((joint, side, math.copysign(1 / radius, along)))
        if {side for _, side, _ in wheels} != {-1, 1}:
            raise UserError(
                f"urdf {self._file}: no wheels on both sides: expected joints with names like left_wheel and "
                "right_wheel, or take drive=kinematic"
            )
        joints, sides, spins = zip(*wheels, strict=True)
        # how far joints turn per metre on the floor, rad/m
        self._joints, self._sides, self._spins = list(joints), np.array(sides), np.array(spins)

    def run(
        self, agents: list[int], place: NDArray[np.float64], drive: NDArray[np.float64], ticks: int
    ) -> NDArray[np.float64]:
        """Return x, y and angle of robots (R, S * STEPS, 3) after every step of S ``ticks`` of 0.1 s.

        Args:
            agents: Their numbers.
            place: Where they stand (R, 2), metres.
            drive: Angle, speed, turning rate, both as wanted, greatest change of both, distance of the wheels
                (R, 8): metres, seconds, radians.
            ticks: S.
        """
        self.clear()
        angle, speeds, wanted, track = drive[:, 0], drive[:, 1:3].copy(), drive[:, 3:5], drive[:, 7]
        most = _SECONDS * drive[:, 5:7]
        for agent, (x, y), faces, (speed, turn), wide in zip(
            agents, place.tolist(), angle.tolist(), speeds.tolist(), track.tolist(), strict=True
        ):
            body = self.put(agent, (x, y), faces)
            along = speed * math.cos(faces), speed * math.sin(faces), 0.0
            self.client.resetBaseVelocity(body, along, (0.0, 0.0, turn))
            for joint, velocity in zip(self._joints, self._rates(speed, turn, wide), strict=True):
                self.client.resetJointState(body, joint, 0.0, velocity)
        result = np.empty((len(agents), ticks * STEPS, 3))
        for step in range(ticks * STEPS):
            speeds += np.clip(wanted - speeds, -most, most)
            for agent, (speed, turn), wide in zip(agents, speeds.tolist(), track.tolist(), strict=True):
                self._turn(agent, speed, turn, wide)
            self.client.stepSimulation()
            for number, agent in enumerate(agents):
                pose = self.client.getBasePositionAndOrientation(self.body(agent))
                (x, y, _), turned = self.client.multiplyTransforms(*pose, *self._outertial)
                result[number, step] = x, y, self.client.getEulerFromQuaternion(turned)[2]
        return result

    def _turn(self, agent: int, speed: float, turn: float, track: float) -> None:
        """Let the motors of an agent turn its wheels at a speed, m/s, and a turning rate, rad/s."""
        self.client.setJointMotorControlArray(
            self.body(agent),
            self._joints,
            self.client.VELOCITY_CONTROL,
            targetVelocities=self._rates(speed, turn, track),
            forces=[_FORCE] * len(self._joints),
        )

    def _rates(self, speed: float, turn: float, track: float) -> list[float]:
        """Return how fast the joints turn, rad/s."""
        return ((speed - self._sides * turn * track / 2) * self._spins).tolist()
