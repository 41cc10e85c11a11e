"""Robots of a URDF file in a pybullet client: where they stand, how large they are, and their wheels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.paths import expanded
from pedzoo.sim.physics_parts.bullet.client import load_pybullet, quiet
from pedzoo.sim.physics_parts.bullet.looks import AWAY, UPRIGHT

_BOUNDS = 0.0025
"""Metres by which the bounds that pybullet tells of a wheel are wider than the wheel, about."""


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
        turned = 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)
        pose = self._p.multiplyTransforms((*place, self._height), turned, *self._inertial)
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
