"""Robots of a URDF file that drive by their wheels: gravity, friction, walls, and 240 steps a second."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.physics_parts.bullet.client import connect
from pedzoo.sim.physics_parts.bullet.looks import SHAPES
from pedzoo.sim.physics_parts.bullet.robots import BulletRobots
from pedzoo.sim.physics_parts.bullet.walls import build_walls

STEPS = 24
"""Steps of every 0.1 s."""

_SECONDS = TRACE_SECONDS / STEPS
_FORCE = 1000.0
"""N m that motors have at most: speeds are limited by the robot's acceleration."""

_SETTLING = 120
"""Steps in which a robot that is put down comes to rest."""


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
        build_walls(self._p, self.client, [boxes[i : i + SHAPES] for i in range(0, len(boxes), SHAPES)])

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
