"""Robots of a URDF file in pybullet: where they stand, how large they are, and how wheels drive them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import expanded
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.physics.pybullet.client import (
    AWAY,
    UPRIGHT,
    about_z,
    build_walls,
    connect,
    load_pybullet,
    quiet,
)

_BOUNDS = 0.0025
"""Metres by which the bounds that pybullet tells of a wheel are wider than the wheel, about."""

STEPS = 24
"""Steps of every 0.1 s."""

_SECONDS = TRACE_SECONDS / STEPS
_FORCE = 1000.0
"""N m that motors have at most: speeds are limited by the robot's acceleration."""

_SETTLING = 120
"""Steps in which a robot that is put down comes to rest."""


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


class Wheel(NamedTuple):
    """A joint that drives.

    Attributes:
        joint: Its number.
        side: 1 for a wheel on the left, -1 on the right.
        spin: Angle of the joint per metre on the floor, rad/m.
    """

    joint: int
    side: int
    spin: float


class BulletRobots:
    """One body of a URDF file for each agent that is a robot; it stands with its lowest point on the floor.

    Attributes:
        reach: Metres from its origin to the farthest point, seen from above.
    """

    def __init__(self, client: int, file: str, fixed: bool = True) -> None:
        """Take a client and a file; ``fixed`` bodies stay where they are put.

        Raises:
            UserError: pybullet cannot read the file, or it has no shape that can be collided with.
        """
        self._p, self._client, self._file, self._fixed = load_pybullet(), client, file, fixed
        self._bodies: dict[int, int] = {}
        first = self._load()
        self._bodies[-1] = first
        links = range(-1, self._p.getNumJoints(first, physicsClientId=client))
        solid = [link for link in links if self._p.getCollisionShapeData(first, link, physicsClientId=client)]
        if not solid:
            raise UserError(f"urdf {file}: it has no collision shapes: expected at least one link with one")
        corners = [self._p.getAABB(first, link, physicsClientId=client) for link in solid]
        self.reach = max(math.hypot(max(-low[0], high[0]), max(-low[1], high[1])) for low, high in corners)
        self._height = -min(low[2] for low, _ in corners)
        self._inertial = self._p.getDynamicsInfo(first, -1, physicsClientId=client)[3:5]
        self._outertial = self._p.invertTransform(*self._inertial)
        self._p.resetBasePositionAndOrientation(first, AWAY, UPRIGHT, physicsClientId=client)

    def _load(self) -> int:
        with quiet(1), quiet(2):
            try:
                return self._p.loadURDF(self._file, useFixedBase=self._fixed, physicsClientId=self._client)
            except self._p.error as error:
                raise UserError(f"urdf {self._file}: pybullet cannot load it ({error})") from error

    def __getitem__(self, agent: int) -> int:
        """Return the body of an agent; the first time, it is made."""
        if agent not in self._bodies:
            self._bodies[agent] = self._bodies.pop(-1) if -1 in self._bodies else self._load()
        return self._bodies[agent]

    def put(self, agent: int, place: Sequence[float], angle: float) -> int:
        """Let the body of an agent stand at (x, y), facing ``angle`` radians from x; returns the body."""
        body = self[agent]
        pose = self._p.multiplyTransforms((*place, self._height), about_z(angle), *self._inertial)
        self._p.resetBasePositionAndOrientation(body, *pose, physicsClientId=self._client)
        return body

    def rest(self, agent: int) -> None:
        """Put bodies from now on as high as that of an agent stands."""
        pose = self._p.getBasePositionAndOrientation(self[agent], physicsClientId=self._client)
        self._height = self._p.multiplyTransforms(*pose, *self._outertial)[0][2]

    def clear(self) -> None:
        """Take all bodies away, each to a place of its own."""
        # the floor throws out bodies that can move and are below it
        height = AWAY[2] if self._fixed else -AWAY[2]
        for number, body in enumerate(self._bodies.values()):
            place = (10.0 * number, 0.0, height)
            self._p.resetBasePositionAndOrientation(body, place, UPRIGHT, physicsClientId=self._client)
            self._p.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3, physicsClientId=self._client)

    def where(self, agent: int) -> tuple[float, float, float]:
        """Return where an agent's body stands and faces: x, y, metres, and radians."""
        pose = self._p.getBasePositionAndOrientation(self[agent], physicsClientId=self._client)
        (x, y, _), turned = self._p.multiplyTransforms(*pose, *self._outertial)
        return x, y, self._p.getEulerFromQuaternion(turned)[2]

    def wheels(self) -> list[Wheel]:
        """Return the wheels: joints that turn and whose names say `wheel`, and `left` or `right`.

        Raises:
            UserError: There is none on one of the sides.
        """
        body = next(iter(self._bodies.values()))
        self._p.resetBasePositionAndOrientation(body, AWAY, UPRIGHT, physicsClientId=self._client)
        result = []
        for joint in range(self._p.getNumJoints(body, physicsClientId=self._client)):
            info = self._p.getJointInfo(body, joint, physicsClientId=self._client)
            name = info[1].decode().lower()
            side = ("left" in name) - ("right" in name)
            if info[2] == self._p.JOINT_REVOLUTE and "wheel" in name and side:
                result.append(Wheel(joint, side, self._spin(body, joint, info[13])))
        if {wheel.side for wheel in result} != {-1, 1}:
            raise UserError(
                f"urdf {self._file}: no wheels on both sides: expected joints with names like left_wheel and "
                "right_wheel, or take drive=kinematic"
            )
        return result

    def _spin(self, body: int, joint: int, axis: Any) -> float:
        state = self._p.getLinkState(body, joint, computeForwardKinematics=1, physicsClientId=self._client)
        low, high = self._p.getAABB(body, joint, physicsClientId=self._client)
        _, along, _ = self._p.rotateVector(state[5], axis)
        return math.copysign(1 / max((high[2] - low[2]) / 2 - _BOUNDS, 1e-3), along)


class WheelCommand(NamedTuple):
    """What one robot does in a decision.

    Attributes:
        agent: Its number.
        place: Where it stands (x, y), metres.
        angle: Where it faces, radians.
        speed: m/s.
        turn: rad/s.
        wanted_speed: What it is commanded, m/s.
        wanted_turn: rad/s.
        acceleration: m/s^2.
        turn_acceleration: rad/s^2.
        track: Distance between the wheels, metres.
    """

    agent: int
    place: list[float]
    angle: float
    speed: float
    turn: float
    wanted_speed: float
    wanted_turn: float
    acceleration: float
    turn_acceleration: float
    track: float


class DrivenRobots:
    """One floor plan and its robots in a client of their own; people are not there, and push nothing."""

    def __init__(self, boxes: NDArray[np.float64], file: str) -> None:
        """Build walls over rectangles (M, 4), and let a robot come to rest.

        Raises:
            UserError: The file cannot be read, or it has no wheels.
        """
        self._p, self.client, self._finalizer = connect(self)
        self._p.setGravity(0, 0, -9.81, physicsClientId=self.client)
        self._p.setTimeStep(_SECONDS, physicsClientId=self.client)
        self._robots = BulletRobots(self.client, file, fixed=False)
        self._wheels = self._robots.wheels()
        ground = self._p.createCollisionShape(self._p.GEOM_PLANE, physicsClientId=self.client)
        self._p.createMultiBody(0, ground, physicsClientId=self.client)
        self._settle()
        build_walls(self.client, boxes)

    def close(self) -> None:
        """Disconnect; a second time does nothing."""
        self._finalizer()

    def _settle(self) -> None:
        self._robots.put(0, (0.0, 0.0), 0.0)
        self._spin(0, 0.0, 0.0, 1.0)
        for _ in range(_SETTLING):
            self._p.stepSimulation(physicsClientId=self.client)
        self._robots.rest(0)

    def run(self, drives: list[WheelCommand], ticks: int) -> NDArray[np.float64]:
        """Return x, y and angle of robots (R, S * STEPS, 3) after every step of S ``ticks`` of 0.1 s."""
        self._robots.clear()
        speeds = np.array([[drive.speed, drive.turn] for drive in drives], dtype=np.float64)
        wanted = np.array([[drive.wanted_speed, drive.wanted_turn] for drive in drives])
        most = _SECONDS * np.array([[drive.acceleration, drive.turn_acceleration] for drive in drives])
        for drive in drives:
            self._begin(drive)
        result = np.empty((len(drives), ticks * STEPS, 3))
        for step in range(ticks * STEPS):
            speeds += np.clip(wanted - speeds, -most, most)
            for drive, (speed, turn) in zip(drives, speeds.tolist(), strict=True):
                self._spin(drive.agent, speed, turn, drive.track)
            self._p.stepSimulation(physicsClientId=self.client)
            result[:, step] = [self._robots.where(drive.agent) for drive in drives]
        return result

    def _begin(self, drive: WheelCommand) -> None:
        body = self._robots.put(drive.agent, drive.place, drive.angle)
        along = drive.speed * math.cos(drive.angle), drive.speed * math.sin(drive.angle), 0.0
        self._p.resetBaseVelocity(body, along, (0.0, 0.0, drive.turn), physicsClientId=self.client)
        for joint, velocity in self._turning(drive.speed, drive.turn, drive.track):
            self._p.resetJointState(body, joint, 0.0, velocity, physicsClientId=self.client)

    def _spin(self, agent: int, speed: float, turn: float, track: float) -> None:
        joints, velocities = zip(*self._turning(speed, turn, track), strict=True)
        self._p.setJointMotorControlArray(
            self._robots[agent],
            joints,
            self._p.VELOCITY_CONTROL,
            targetVelocities=velocities,
            forces=[_FORCE] * len(joints),
            physicsClientId=self.client,
        )

    def _turning(self, speed: float, turn: float, track: float) -> list[tuple[int, Any]]:
        """Return joints and how fast they turn, rad/s."""
        return [(wheel.joint, (speed - wheel.side * turn * track / 2) * wheel.spin) for wheel in self._wheels]
