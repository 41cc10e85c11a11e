"""Pybullet: extruded walls, capsules, closest-point queries, ray casts and a camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.bank import MapBank
from pedzoo.sim.camera import VIEW_ANGLE, Camera, Lens
from pedzoo.sim.dynamics import SKIN
from pedzoo.sim.physics._base import REACH, Bodies
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.physics.pybullet.client import WALL_HEIGHT, load_pybullet
from pedzoo.sim.physics.pybullet.looks import CUT_HEIGHT, Figure
from pedzoo.sim.physics.pybullet.robots import find_urdf
from pedzoo.sim.physics.pybullet.scene import (
    BulletScene,
    BulletScenes,
    PlacedScene,
    as_array,
    moved,
    scene_rays,
)
from pedzoo.sim.physics.pybullet.shapes import drive_by_wheels, headings, with_shapes
from pedzoo.sim.state import Contacts, MotionInput, OwnedMotion, State

_SLACK = 1e-6
"""Metres by which the broad phase is generous: far above rounding."""

DRIVES = ("kinematic", "wheels")
"""How robots of a URDF file move."""


class Bullet(Compiled):
    """One pybullet client per floor plan, made when it is first asked about.

    pybullet answers; torch only says which bodies are near enough to be asked about. Inside a wall the
    distance is negative, but pybullet's depth is that in one box and not in the whole wall.

    Robots are capsules, or have the shape of a URDF file, which decides what they touch at their heading.
    Their paths, rays and pictures are those of discs all the same. A mirrored scene does not mirror the file.

    It can be pickled and sent to workers: the copy makes its own clients.
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
            urdf: File of the bodies of robots, a path or a name within pybullet_data; None for capsules.
            drive: How they move: ``kinematic``, as all agents, or by their ``wheels`` at 240 Hz. Holonomic
                robots have none.

        Raises:
            UserError: The radius is not above zero, pybullet is not installed, or there is no such file or
                drive.
        """
        super().__init__(bank, body_radius)
        load_pybullet()
        if drive not in DRIVES or (drive == "wheels" and urdf is None):
            raise UserError(
                f"physics bullet: drive {drive}, urdf {urdf}: expected kinematic, or wheels with a file like "
                "urdf=husky/husky.urdf"
            )
        self.drive = drive
        # what stands in the way of wheels stops them: they never overlap
        self._margin = SKIN if drive == "wheels" else 0.0
        self.urdf = None if urdf is None else find_urdf(urdf)
        self._scenes = BulletScenes(bank, body_radius, self.urdf)

    @classmethod
    def check(cls) -> None:
        """Check that pybullet is there; errors as of `load_pybullet`."""
        load_pybullet()

    def close(self) -> None:
        """Disconnect all clients."""
        self._scenes.close()

    @torch.no_grad()
    def contacts(self, path: Tensor, people: Bodies) -> Contacts:
        """See `Physics.contacts`."""
        extra = self._radius(people) - self.body_radius
        # a bound on how far any agent gets
        far = torch.hypot(*(path - people.position[:, :, None, None]).abs().amax((2, 3)).movedim(-1, 0))
        present = people.mask & far.isfinite()
        agent, wall = np.zeros((2, *path.shape[:3]), dtype=bool)
        own = torch.where(present, far + self._radius(people) + _SLACK, -torch.inf)
        reach = own.unsqueeze(2) + own.unsqueeze(1)
        between = (people.position.unsqueeze(2) - people.position.unsqueeze(1)).square().sum(-1)
        near = (between < reach.square()) & (reach > 0)
        of, first, second = near.triu(1).nonzero(as_tuple=True)
        both = 2 * self.body_radius + extra[of, first] + extra[of, second]
        apart = (path[of, first] - path[of, second]).abs().amax(-1)
        pair, trace, step = (apart < both.view(-1, 1, 1) + _SLACK).nonzero(as_tuple=True)
        meetings: list[list[tuple[int, ...]]] = [[] for _ in range(len(path))]
        columns = (of[pair], first[pair], second[pair], trace, step)
        for scene, *meeting in torch.stack(columns, 1).tolist():
            meetings[scene].append(tuple(meeting))
        paths, rooms, wider = as_array(path), far.cpu().numpy(), as_array(extra)
        for asked in self._scenes.placed(people, present):
            if asked.present:
                way, more = moved(asked.affine, paths[asked.index]), wider[asked.index]
                self._meet(asked.bullet, way, more, meetings[asked.index], agent[asked.index])
                self._hit(asked, way, more, rooms[asked.index], wall[asked.index])
        return Contacts(*(torch.from_numpy(values).to(path.device) for values in (agent, wall)))

    def owned(self, state: State) -> Tensor | None:
        """See `Physics.owned`: robots that drive by their wheels."""
        return (state.kind == ROBOT) & (state.drive != HOLONOMIC) if self.drive == "wheels" else None

    @torch.no_grad()
    def move_owned(
        self, state: State, command: Tensor, moving: Tensor, ticks: int, substeps: int
    ) -> OwnedMotion:
        """See `Physics.move_owned`; pybullet limits friction and walls, and the robot its accelerations."""
        people = Bodies.of(state)
        placed = self._scenes.placed(people, self._present(people) & moving)
        return drive_by_wheels(placed, state, command, ticks, substeps)

    @torch.no_grad()
    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        if self.urdf is None:
            return self.contacts(path, Bodies.of(state))
        robots = (state.kind == ROBOT) & state.mask
        people = Bodies.of(state)
        between_people = self.contacts(path, people._replace(mask=people.mask & ~robots))
        present = self._present(people) & path.isfinite().all(-1).flatten(2).all(-1)
        placed = self._scenes.placed(people, present)
        return with_shapes(
            placed, between_people, state, path, headings(state, inputs), self.body_radius, self._margin
        )

    def _meet(
        self,
        bullet: BulletScene,
        way: NDArray[np.float64],
        extra: NDArray[np.float64],
        meetings: list[tuple[int, ...]],
        touching: NDArray[np.bool_],
    ) -> None:
        """Note which pairs touch; bodies are ``extra`` (A,) wider than their capsules, metres."""
        for first, second, trace, step in meetings:
            if touching[first, trace] and touching[second, trace]:
                continue
            bullet.place(first, *way[first, trace, step])
            bullet.place(second, *way[second, trace, step])
            more = float(extra[first] + extra[second])
            if bullet.people_meet(first, second, more):
                touching[[first, second], trace] = True

    def _hit(
        self,
        asked: PlacedScene,
        way: NDArray[np.float64],
        extra: NDArray[np.float64],
        far: NDArray[Any],
        touching: NDArray[np.bool_],
    ) -> None:
        low, high = np.split(asked.bullet.boxes, 2, axis=1)
        room = (self.body_radius + _SLACK + extra)[:, None, None]
        start, reach = asked.places[asked.present, None], far[asked.present, None, None] + room[asked.present]
        near, box = np.nonzero(((start > low - reach) & (start < high + reach)).all(-1))
        person = np.array(asked.present, dtype=np.int64)[near]
        points, margin = way[person], room[person][:, None]
        at = (points > low[box, None, None] - margin) & (points < high[box, None, None] + margin)
        which, trace, step = np.nonzero(at.all(-1))
        questions = np.stack((person[which], box[which], trace), axis=1).tolist()
        places = points[which, trace, step].tolist()
        for (person, box, trace), place in zip(questions, places, strict=True):
            if not touching[person, trace]:
                asked.bullet.place(person, *place)
                touching[person, trace] = asked.bullet.hits_wall(person, box, float(extra[person]))

    @torch.no_grad()
    def rays(self, people: Bodies, origin: Tensor, direction: Tensor, reach: float = REACH) -> Tensor:
        """See `Physics.rays`: pybullet's batched ray test, at the height of the chest."""
        result = np.full(origin.shape[:2], reach)
        starts = as_array(origin)
        widths = self._radius(people).tolist()
        for asked in self._scenes.placed(people, self._present(people)):
            width = [round(radius, 6) for radius in widths[asked.index]]
            start = moved(asked.affine, starts[asked.index])
            along = direction[asked.index].cpu().double().numpy() @ asked.affine[:, :2].T
            which = np.flatnonzero((np.isfinite(start) & np.isfinite(along)).all(axis=1))
            result[asked.index, which] = scene_rays(asked, width, start[which], along[which], reach)
        return torch.from_numpy(result).to(origin)

    def image(
        self, people: Bodies, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """See `Physics.image`; drawn on a GPU where pybullet's plugin for it works, else on the CPU."""
        one = people.scene(scene)
        (asked,) = self._scenes.placed(one, self._present(one))
        camera, linear = self.framed(people, scene, size, camera), asked.affine[:, :2]
        eye, target, up = (np.array(values) for values in camera.eye())
        for place in (eye, target):
            place[:2] = linear @ place[:2] + asked.affine[:, 2]
        up[:2] = linear @ up[:2]
        pinhole = eye.tolist(), target.tolist(), up.tolist()
        figures = _figures(asked, one, self._radius(one)[0])
        picture = asked.bullet.looks(CUT_HEIGHT).render(figures, size, pinhole, VIEW_ANGLE[camera.view])
        # in a mirrored scene, left is right
        return picture if np.linalg.det(linear) > 0 else np.ascontiguousarray(picture[:, ::-1])

    @torch.no_grad()
    def onboard(
        self, people: Bodies, heading: Tensor, lens: Lens
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """See `Physics.onboard`."""
        shape = (*heading.shape, lens.height, lens.width)
        pictures, depths = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
        ahead, radius = as_array(direction_of(heading)), self._radius(people)
        first = radius.shape[1] - heading.shape[1]
        for asked in self._scenes.placed(people, self._present(people)):
            linear, looks = asked.affine[:, :2], asked.bullet.looks(WALL_HEIGHT)
            order = 1 if np.linalg.det(linear) > 0 else -1
            figures = _figures(asked, people, radius[asked.index])
            for robot in (agent for agent in asked.present if agent >= first):
                others = {agent: figure for agent, figure in figures.items() if agent != robot}
                at = asked.index, robot - first
                picture, depth = looks.onboard(
                    others, figures[robot][:2], (linear @ ahead[at]).tolist(), lens
                )
                pictures[at], depths[at] = picture[:, ::order], depth[:, ::order]
        return pictures, depths


def _figures(asked: PlacedScene, people: Bodies, radius: Tensor) -> dict[int, Figure]:
    """Return how the agents of a scene are drawn in pybullet's frame; bodies have ``radius`` (A,) metres."""
    at, angles = asked.index, np.zeros(len(radius))
    if people.heading is not None:
        x, y = (as_array(direction_of(people.heading[at])) @ asked.affine[:, :2].T).T
        angles = np.arctan2(y, x)
    robots = [False] * len(radius) if people.kind is None else (people.kind[at] == ROBOT).tolist()
    return {
        agent: Figure(x, y, round(float(radius[agent]), 6), float(angles[agent]), robots[agent])
        for agent, (x, y) in zip(asked.present, asked.places[asked.present].tolist(), strict=True)
    }
