"""Pybullet's cameras, and robots of URDF files; all else is answered as `compiled` answers it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC, speed_and_turn
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import TURNS_FROM, direction_of, heading_of
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import boxes
from pedzoo.sim.drawing import (
    FLOOR,
    OUTSIDE,
    VIEW_ANGLE,
    Affine,
    Camera,
    Lens,
    as_array,
    moved,
    scene_to_grid,
)
from pedzoo.sim.dynamics import SKIN, driven
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.physics._pybullet import (
    CUT_HEIGHT,
    WALL_HEIGHT,
    BulletLooks,
    Figure,
    disconnect,
    load_pybullet,
)
from pedzoo.sim.physics._urdf import STEPS, Crossing, DrivenRobots, RobotShapes, find_urdf
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.state import Contacts, MotionInput, OwnedMotion, State

DRIVES = ("kinematic", "wheels")
"""How robots of a URDF file move."""

_NEAREST = 0.05
"""Metres from which on robots see."""


class _Placed(NamedTuple):
    """One of the B scenes of a question, in pybullet's frame: the grid's axes, cell (0, 0) at the origin."""

    index: int
    row: int  # its floor plan's row in the bank, -1 for the open floor
    frame: Affine  # from the scene to pybullet's frame
    places: NDArray[np.float64]  # where agents are (A, 2), metres
    present: list[int]  # numbers of the agents that are there, in ascending order


class Bullet(Compiled):
    """Takes pictures with pybullet, which also moves robots of a URDF file by their wheels.

    Robots are discs, or have the shape of a URDF file, which decides what they touch at their heading.
    Their paths, rays and pictures are those of discs all the same. A mirrored scene does not mirror the file.

    Each floor plan has clients of its own, made when it is first asked about; copies make their own.
    """

    views = ("top", "perspective")

    def __init__(
        self,
        bank: MapBank,
        body_radius: float = BODY_RADIUS,
        urdf: str | None = None,
        drive: str = "kinematic",
    ) -> None:
        """Take the floor plans.

        Args:
            bank: See `Physics`.
            body_radius: See `Physics`.
            urdf: File of the bodies of robots, a path or a name within pybullet_data; None for discs.
            drive: How they move: ``kinematic``, as all agents, or by their ``wheels`` at 240 Hz. Holonomic
                robots have none.

        Raises:
            UserError: pybullet is not installed, or there is no such file or drive.
        """
        super().__init__(bank, body_radius)
        load_pybullet()
        if drive not in DRIVES or (drive == "wheels" and urdf is None):
            raise UserError(
                f"physics bullet: drive {drive}, urdf {urdf}: expected kinematic, or wheels with a file like "
                "urdf=husky/husky.urdf"
            )
        self.drive, self.urdf = drive, None if urdf is None else find_urdf(urdf)
        self._whole = urdf is None
        self._clients: dict[Any, Any] = {}
        self._closed = False

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_clients": {}}

    @classmethod
    def check(cls) -> None:  # noqa: D102
        load_pybullet()

    def close(self) -> None:
        """Disconnect all clients."""
        for held in self._clients.values():
            disconnect(held.client)
        self._clients.clear()
        self._closed = True

    def _of_plan(self, kind: type, row: int, *settings: object) -> Any:
        """Return what holds a client for the floor plan in a row of the bank; the first time, it is made."""
        if self._closed:
            raise UserError("this Bullet was closed: make a new one, Bullet(bank)")
        key = kind, row, settings
        if key not in self._clients:
            walls = boxes(self.bank.grids[row], self.bank.unknown) if row >= 0 else np.zeros((0, 4))
            # boxes of one body lie near one another
            walls = walls[np.lexsort(np.floor(walls[:, :2] / 2).T)]
            self._clients[key] = kind(walls, *settings)
        if not self._clients[key].client.isConnected():
            raise UserError(
                "a pybullet client of this Bullet is gone, pybullet.disconnect was called: make a new "
                "Bullet(bank), and leave its clients to close()"
            )
        return self._clients[key]

    def _placed(self, people: Bodies, present: Tensor) -> Iterator[_Placed]:
        """Yield scene after scene, with those of their agents that are ``present`` (B, A) bool."""
        rows, places = self.bank.index(people.map_id[:, 0]).tolist(), as_array(people.position)
        for index, (row, pose, here) in enumerate(zip(rows, people.pose, present, strict=True)):
            frame = scene_to_grid(pose, self.bank.grids[row] if row >= 0 else None)
            yield _Placed(index, row, frame, moved(frame, places[index]), here.nonzero()[:, 0].tolist())

    def owned(self, state: State) -> Tensor | None:
        """See `Physics.owned`: robots that drive by their wheels."""
        return (state.kind == ROBOT) & (state.drive != HOLONOMIC) if self.drive == "wheels" else None

    @torch.no_grad()
    def move_owned(self, state: State, inputs: MotionInput) -> OwnedMotion:
        """See `Physics.move_owned`; pybullet limits friction and walls, and the robot its accelerations."""
        people, ticks, substeps = Bodies.of(state), inputs.velocity.shape[1], inputs.substeps
        path = as_array(state.position)[:, :, None, None].repeat(ticks, 2).repeat(substeps, 3)
        heading, rate = as_array(state.heading).copy(), np.zeros(state.mask.shape)
        speed = (state.velocity * direction_of(state.heading)).sum(-1)
        wanted, turn = speed_and_turn(inputs.command.unbind(-1), state.drive, state.track)
        wanted = wanted.clamp(-state.top_speed, state.top_speed)
        columns = state.heading, speed, state.turn_rate, wanted, turn
        limits = state.acceleration, state.turn_acceleration, state.track
        values = as_array(torch.stack((*columns, *limits), -1))
        at = np.round(np.arange(1, ticks * substeps + 1) * (STEPS / substeps)).astype(np.int64) - 1
        for one in self._placed(people, self._present(people) & inputs.moving):
            if not one.present:
                continue
            linear, here = one.frame[:2, :2], (one.index, one.present)
            mirror = 1.0 if np.linalg.det(linear) > 0 else -1.0
            drive = values[here]
            drive[:, 0] = _turned(linear, drive[:, 0])
            drive[:, [2, 4]] *= mirror
            robots = self._of_plan(DrivenRobots, one.row, self.urdf)
            ways = robots.run(one.present, one.places[one.present], drive, ticks)
            places = (ways[:, at, :2] - one.frame[:2, 2]) @ linear
            path[here] = places.reshape(-1, ticks, substeps, 2)
            angles = ways[..., 2]
            heading[here] = _turned(linear.T, angles[:, -1])
            last = np.unwrap(angles[:, -STEPS - 1 :], axis=1) if ticks > 1 else np.unwrap(angles, axis=1)
            seconds = TRACE_SECONDS * (last.shape[1] - 1) / STEPS
            rate[here] = mirror * (last[:, -1] - last[:, 0]) / seconds
        return OwnedMotion(*(torch.from_numpy(values).to(state.velocity) for values in (path, heading, rate)))

    @torch.no_grad()
    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        if self.urdf is None:
            return super()._touched(state, path, inputs)
        robots = (state.kind == ROBOT) & state.mask
        people = super()._touched(state._replace(mask=state.mask & ~robots), path, inputs)
        agent, wall = (values.cpu().numpy().copy() for values in people)
        paths, radius, ahead = map(as_array, (path, state.radius, direction_of(_headings(state, inputs))))
        bodies, mine = Bodies.of(state), robots.cpu().numpy()
        # what stands in the way of wheels stops them: they never overlap
        margin = SKIN if self.drive == "wheels" else 0.0
        for one in self._placed(bodies, self._present(bodies) & path.isfinite().flatten(2).all(-1)):
            at, frame = one.index, one.frame
            x, y = np.moveaxis(ahead[at] @ frame[:2, :2].T, -1, 0)
            way = Crossing(one.present, mine[at], moved(frame, paths[at]), np.arctan2(y, x), radius[at])
            shapes = self._of_plan(RobotShapes, one.row, self.urdf, self.body_radius, margin)
            shapes.touch(way, agent[at], wall[at])
        return Contacts(*(torch.from_numpy(values).to(path.device) for values in (agent, wall)))

    def image(
        self, people: Bodies, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """See `Physics.image`; drawn on a GPU where pybullet's plugin for it works, else on the CPU."""
        one = people.scene(scene)
        (asked,) = self._placed(one, self._present(one))
        camera, linear = self.framed(people, scene, size, camera), asked.frame[:2, :2]
        eye, target, up = (np.array(values) for values in camera.eye())
        distance = float(np.linalg.norm(eye - target))
        for place in (eye, target):
            place[:2] = moved(asked.frame, place[:2])
        up[:2] = linear @ up[:2]
        looks, figures = (
            self._of_plan(BulletLooks, asked.row, CUT_HEIGHT),
            _figures(asked, one, self._radius(one)[0]),
        )
        pinhole, limits = (eye, target, up), (max(0.1, 0.2 * distance), 3 * distance + 10)
        picture, _, empty = looks.shot(figures, size, pinhole, VIEW_ANGLE[camera.view], limits)
        # The floor is where no body is: one to draw takes longer on the CPU than all the rest.
        picture[empty] = FLOOR
        # in a mirrored scene, left is right
        return picture if np.linalg.det(linear) > 0 else np.ascontiguousarray(picture[:, ::-1])

    @torch.no_grad()
    def onboard(
        self, people: Bodies, heading: Tensor, lens: Lens
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """See `Physics.onboard`."""
        shape = (*heading.shape, lens.height, lens.width)
        pictures, depths = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
        ahead, radius, height = as_array(direction_of(heading)), self._radius(people), lens.eye_height
        first, limits = radius.shape[1] - heading.shape[1], (_NEAREST, 1.2 * lens.reach + 1)
        floor = np.broadcast_to(lens.floor()[:, None], shape[2:])
        for asked in self._placed(people, self._present(people)):
            linear, looks = asked.frame[:2, :2], self._of_plan(BulletLooks, asked.row, WALL_HEIGHT)
            order = 1 if np.linalg.det(linear) > 0 else -1
            figures = _figures(asked, people, radius[asked.index])
            for robot in (agent for agent in asked.present if agent >= first):
                others = {agent: figure for agent, figure in figures.items() if agent != robot}
                at, (x, y) = (asked.index, robot - first), figures[robot][:2]
                dx, dy = linear @ ahead[at]
                eye = [x, y, height], [x + dx, y + dy, height], [0.0, 0.0, 1.0]
                picture, depth, empty = looks.shot(others, (lens.width, lens.height), eye, lens.angle, limits)
                picture[empty] = np.where(floor[empty, None] < np.inf, FLOOR, OUTSIDE)
                depth[empty] = floor[empty]
                pictures[at], depths[at] = picture[:, ::order], np.minimum(depth, lens.reach)[:, ::order]
        return pictures, depths


def _turned(linear: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles (N,), radians, of directions that a linear map (2, 2) has turned or mirrored."""
    x, y = linear @ np.stack((np.cos(angle), np.sin(angle)))
    return np.arctan2(y, x)


def _figures(asked: _Placed, people: Bodies, radius: Tensor) -> dict[int, Figure]:
    """Return how the agents of a scene are drawn in pybullet's frame; bodies have ``radius`` (A,) metres."""
    at, angles = asked.index, np.zeros(len(radius))
    if people.heading is not None:
        angles = _turned(asked.frame[:2, :2], as_array(people.heading[at]))
    robots = [False] * len(radius) if people.kind is None else (people.kind[at] == ROBOT).tolist()
    return {
        agent: Figure(x, y, round(float(radius[agent]), 6), float(angles[agent]), robots[agent])
        for agent, (x, y) in zip(asked.present, asked.places[asked.present].tolist(), strict=True)
    }


def _headings(state: State, inputs: MotionInput) -> Tensor:
    """Return where agents face at all sub-steps (B, A, S, M), radians; between trace points they turn evenly.

    Agents on the common path face as the kernel turns them, agents that the backend owns turn evenly.
    """
    wheels = state.drive != HOLONOMIC
    now, points = state, [state.heading]
    for tick in range(inputs.velocity.shape[1]):
        velocity = inputs.velocity[:, tick : tick + 1]
        _, heading, rate = driven(now, inputs.command.movedim(-1, 0), velocity)
        going = velocity[:, 0].movedim(0, -1)
        heading = torch.where(wheels, heading, heading_of(going, now.heading, TURNS_FROM))
        now = now._replace(heading=heading, turn_rate=rate, velocity=going)
        points.append(heading)
    turned = torch.stack(points, dim=-1)
    if inputs.owned is not None:
        share = torch.linspace(0, 1, turned.shape[-1], device=turned.device)
        own = state.heading.unsqueeze(-1) + share * _short(inputs.owned.heading - state.heading).unsqueeze(-1)
        turned = torch.where((inputs.moving | ~wheels).unsqueeze(-1), turned, own)
    step = torch.arange(1, inputs.substeps + 1, device=turned.device) / inputs.substeps
    return turned[..., :-1, None] + step * _short(turned.diff(dim=-1)).unsqueeze(-1)


def _short(angle: Tensor) -> Tensor:
    return torch.atan2(angle.sin(), angle.cos())
