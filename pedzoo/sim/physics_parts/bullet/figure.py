"""Figures of people and robots for pybullet's cameras, made of rings; contacts do not see them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.physics_parts.camera import ROBOT_BODY, ROBOT_FRONT, person_color
from pedzoo.sim.physics_parts.stance import HAIR, SKIN

SIDES = 8
"""Corners of a person's rings."""

STRIDE = 1.4
"""Metres that a person walks in two steps."""

SWING, KNEE, ARMS = 0.44, 0.9, 0.8
"""Greatest angles of hips and knees, radians; and of arms, in parts of the hips'."""

FULL_SPEED = 1.3
"""Metres per second from on which steps do not get longer."""

THIGH, SHIN = 0.43, 0.47
"""Lengths of both parts of a leg, metres."""

DARKER = 0.55
"""Share of a person's colour that trousers have."""

BROADER = (0.8, 1.4)
"""Figures are broader where bodies are wider than usual, within these limits."""

ROBOT_HEIGHT = 0.6
"""Metres."""

Ring = tuple[float, float, float, float]
"""Height, half axes along x and y, and how far ahead the middle lies, metres."""

Mesh = tuple[list[list[float]], list[int], list[list[float]]]
"""Corners, the three corners of each triangle, and normals at corners."""

TORSO: tuple[Ring, ...] = (
    (-0.1, 0.1, 0.15, 0.0), (-0.07, 0.115, 0.172, 0.0), (0.0, 0.112, 0.17, 0.0), (0.16, 0.092, 0.142, 0.0),
    (0.4, 0.115, 0.178, 0.0), (0.5, 0.1, 0.205, 0.0), (0.545, 0.075, 0.17, 0.0), (0.575, 0.058, 0.09, 0.0),
    (0.6, 0.05, 0.055, 0.01),
)  # fmt: skip
FACE: tuple[Ring, ...] = (
    (0.57, 0.05, 0.05, 0.01), (0.62, 0.05, 0.05, 0.015), (0.65, 0.08, 0.065, 0.03), (0.73, 0.1, 0.077, 0.02),
    (0.8, 0.092, 0.073, 0.015), (0.83, 0.06, 0.055, 0.01),
)  # fmt: skip
HAIR_CAP: tuple[Ring, ...] = (
    (0.65, 0.045, 0.06, -0.03), (0.72, 0.085, 0.084, -0.025), (0.79, 0.1, 0.087, -0.012),
    (0.84, 0.08, 0.07, -0.005), (0.86, 0.03, 0.03, -0.005),
)  # fmt: skip
UPPER_LEG: tuple[Ring, ...] = (
    (-THIGH, 0.058, 0.055, 0.0), (-0.2, 0.078, 0.072, 0.0), (-0.03, 0.085, 0.078, 0.0),
    (0.04, 0.05, 0.05, 0.0),
)  # fmt: skip
LOWER_LEG: tuple[Ring, ...] = (
    (-SHIN, 0.13, 0.045, 0.055), (-SHIN + 0.05, 0.12, 0.045, 0.05), (-SHIN + 0.09, 0.05, 0.042, 0.0),
    (-0.15, 0.06, 0.055, -0.01), (0.02, 0.055, 0.052, 0.0),
)  # fmt: skip
ARM: tuple[Ring, ...] = (
    (-0.53, 0.029, 0.028, 0.075), (-0.3, 0.039, 0.036, -0.005), (-0.04, 0.055, 0.052, 0.0),
    (0.015, 0.05, 0.045, 0.0), (0.045, 0.025, 0.02, 0.0),
)  # fmt: skip
HAND: tuple[Ring, ...] = (
    (-0.67, 0.025, 0.015, 0.11), (-0.6, 0.042, 0.022, 0.1), (-0.52, 0.026, 0.024, 0.075)
)  # fmt: skip


class Part(NamedTuple):
    """A part of a person besides the torso.

    Attributes:
        rings: Around its joint, from the lowest to the highest.
        cloth: What its colour is of.
        parent: Number of the part that it hangs on, from 1; 0 is the torso.
        joint: Where the joint is on that part (x, y, z), metres.
    """

    rings: tuple[Ring, ...]
    cloth: str
    parent: int = 0
    joint: tuple[float, float, float] = (0.0, 0.0, 0.0)


PARTS = (
    Part(FACE, "skin"),
    Part(HAIR_CAP, "hair"),
    Part(UPPER_LEG, "trousers", 0, (0.0, 0.087, 0.0)),
    Part(LOWER_LEG, "trousers", 3, (0.0, 0.0, -THIGH)),
    Part(UPPER_LEG, "trousers", 0, (0.0, -0.087, 0.0)),
    Part(LOWER_LEG, "trousers", 5, (0.0, 0.0, -THIGH)),
    Part(ARM, "shirt", 0, (0.0, 0.205, 0.49)),
    Part(HAND, "skin", 7),
    Part(ARM, "shirt", 0, (0.0, -0.205, 0.49)),
    Part(HAND, "skin", 9),
)
"""Left before right, as `Figures` turns them."""


class Figure(NamedTuple):
    """How an agent is drawn, in pybullet's frame.

    Attributes:
        x: Metres.
        y: Metres.
        radius: Of the body, metres.
        heading: Where it faces, radians.
        walked: How far it has walked, metres.
        speed: How fast, m/s.
        robot: Whether it is a robot.
    """

    x: float
    y: float
    radius: float
    heading: float = 0.0
    walked: float = 0.0
    speed: float = 0.0
    robot: bool = False


def gait(walked: float, speed: float) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return how legs stand after so many metres, at so many m/s; the lower foot is on the floor.

    These are the angles of hips and knees, left and right, radians, and how high the hips are, metres.
    """
    phase, size = 2 * math.pi * walked / STRIDE, min(speed / FULL_SPEED, 1.0)
    hips = SWING * size * math.sin(phase), -SWING * size * math.sin(phase)
    # a knee bends while its leg swings ahead
    knees = KNEE * size * max(math.cos(phase), 0.0), KNEE * size * max(-math.cos(phase), 0.0)
    both = zip(hips, knees, strict=True)
    return hips, knees, max(THIGH * math.cos(hip) + SHIN * math.cos(hip - knee) for hip, knee in both)


def lofted(rings: Sequence[Ring], broader: float = 1.0, sides: int = SIDES) -> Mesh:
    """Return the closed surface through elliptic rings, from the lowest to the highest."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    corners = [
        np.stack((ahead + broader * rx * np.cos(angle), broader * ry * np.sin(angle), np.full(sides, z)), 1)
        for z, rx, ry, ahead in rings
    ]
    ends = np.array([[rings[end][3], 0.0, rings[end][0]] for end in (0, -1)])
    points = np.concatenate((*corners, ends))
    one, top = np.arange(sides), sides * (len(rings) - 1)
    other, low, high = (one + 1) % sides, len(points) - 2, len(points) - 1
    faces = [np.stack((np.full(sides, low), other, one), 1), np.stack((np.full(sides, high), one, other), 1)]
    faces[1][:, 1:] += top
    for first in range(0, top, sides):
        a, b, c, d = first + one, first + other, first + sides + one, first + sides + other
        faces += [np.stack((a, b, d), 1), np.stack((a, d, c), 1)]
    triangles = np.concatenate(faces)
    return points.tolist(), triangles.ravel().tolist(), _normals(points, triangles).tolist()


def _normals(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return unit normals (P, 3) at corners (P, 3), means of those of triangles (F, 3) by their areas."""
    first, second, third = (points[triangles[:, i]] for i in range(3))
    normal, result = np.cross(second - first, third - first), np.zeros_like(points)
    for i in range(3):
        np.add.at(result, triangles[:, i], normal)
    return result / np.linalg.norm(result, axis=1, keepdims=True).clip(1e-12)


class Figures:
    """The figures in a pybullet client; each is made when it is first shown."""

    def __init__(self, pybullet: Any, client: int, away: Sequence[float]) -> None:
        """Take the module, a client, and a place (x, y, z) where nobody sees those that are not shown."""
        self._p, self._client, self._away = pybullet, client, away
        self._bodies: dict[tuple[int, float, bool], int] = {}

    def show(self, figures: dict[int, Figure]) -> None:
        """Show agents as these figures, and no others."""
        shown = set()
        for agent, figure in figures.items():
            key = agent, figure.radius, figure.robot
            if key not in self._bodies:
                self._bodies[key] = self._robot(figure.radius) if figure.robot else self._person(*key[:2])
            self._pose(self._bodies[key], figure)
            shown.add(key)
        for key, body in self._bodies.items():
            if key not in shown:
                self._put(body, self._away, 0.0)

    def _pose(self, body: int, figure: Figure) -> None:
        if figure.robot:
            self._put(body, (figure.x, figure.y, 0.0), figure.heading)
            return
        (left, right), knees, height = gait(figure.walked, figure.speed)
        # positive angles about y turn what hangs down backwards
        angles = [0, 0, -left, knees[0], -right, knees[1], ARMS * left, 0, ARMS * right, 0]
        self._put(body, (figure.x, figure.y, height), figure.heading)
        states = [[angle] for angle in angles]
        self._p.resetJointStatesMultiDof(body, range(len(states)), states, physicsClientId=self._client)

    def _put(self, body: int, place: Sequence[float], heading: float) -> None:
        turned = 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)
        self._p.resetBasePositionAndOrientation(body, place, turned, physicsClientId=self._client)

    def _person(self, agent: int, radius: float) -> int:
        shirt = person_color(agent)
        trousers = (round(DARKER * shirt[0]), round(DARKER * shirt[1]), round(DARKER * shirt[2]))
        cloth = {"shirt": shirt, "trousers": trousers, "skin": SKIN, "hair": HAIR}
        broader = min(max(radius / BODY_RADIUS, BROADER[0]), BROADER[1])
        torso = self._shape(lofted(TORSO, broader), shirt)
        shapes = [self._shape(lofted(part.rings, broader), cloth[part.cloth]) for part in PARTS]
        joints = [(part.joint[0], broader * part.joint[1], part.joint[2]) for part in PARTS]
        return self._body(torso, shapes, [part.parent for part in PARTS], joints)

    def _robot(self, radius: float) -> int:
        rim, front = 0.97 * radius, 0.2 * radius
        sides = [(0.03, radius, radius, 0.0), (ROBOT_HEIGHT - 0.01, radius, radius, 0.0)]
        can = self._shape(lofted([*sides, (ROBOT_HEIGHT, rim, rim, 0.0)], sides=24), ROBOT_BODY)
        heights = (ROBOT_HEIGHT - 0.1, ROBOT_HEIGHT + 0.01)
        eye = self._shape(lofted([(z, front, 2 * front, 0.6 * radius) for z in heights]), ROBOT_FRONT)
        return self._body(can, [eye], [0], [(0.0, 0.0, 0.0)])

    def _shape(self, mesh: Mesh, color: tuple[int, int, int]) -> int:
        corners, triangles, normals = mesh
        return self._p.createVisualShape(
            self._p.GEOM_MESH,
            vertices=corners,
            indices=triangles,
            normals=normals,
            rgbaColor=[*(value / 255 for value in color), 1.0],
            physicsClientId=self._client,
        )

    def _body(
        self, base: int, shapes: list[int], parents: list[int], joints: Sequence[Sequence[float]]
    ) -> int:
        """Return a new body whose parts turn about y; nothing can collide with it."""
        count, upright = len(shapes), [0.0, 0.0, 0.0, 1.0]
        links = {
            "Masses": [0] * count,
            "CollisionShapeIndices": [-1] * count,
            "VisualShapeIndices": shapes,
            "Positions": joints,
            "Orientations": [upright] * count,
            "InertialFramePositions": [[0.0] * 3] * count,
            "InertialFrameOrientations": [upright] * count,
            "ParentIndices": parents,
            "JointTypes": [self._p.JOINT_REVOLUTE] * count,
            "JointAxis": [[0.0, 1.0, 0.0]] * count,
        }
        links = {f"link{name}": values for name, values in links.items()}
        return self._p.createMultiBody(0, -1, base, self._away, physicsClientId=self._client, **links)
