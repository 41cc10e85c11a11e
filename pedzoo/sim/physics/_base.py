"""What every physics backend does: it moves agents, and answers what is near them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import move_to_scene
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.walls import LocalWalls
from pedzoo.sim.drawing import Camera, Canvas, Lens, free_corners, person_color
from pedzoo.sim.dynamics import SKIN, integrate
from pedzoo.sim.scenario import Rules
from pedzoo.sim.state import Contacts, Decision, Motion, MotionInput, OwnedMotion, State

REACH = 5.0
"""Metres up to which rays are asked for, where nothing else is said."""


class Bodies(NamedTuple):
    """Where people are in B scenes: what every question to a physics backend begins with.

    Attributes:
        position: Scene positions (B, A, 2), metres, of the people who are present by ``mask`` (B, A) bool.
        map_id: Floor plan of each scene (B, 1) long, -1 for none.
        pose: How each scene lies on its floor plan (B, 4).
        radius: Of the bodies (B, A), metres; None for that of the backend.
        heading: Where they face (B, A), radians, for pictures; None where it is not known.
        kind: Person or robot (B, A) long, for pictures; None for people alone.
    """

    position: Tensor
    mask: Tensor
    map_id: Tensor
    pose: Tensor
    radius: Tensor | None = None
    heading: Tensor | None = None
    kind: Tensor | None = None

    @classmethod
    def of(cls, state: State) -> Bodies:
        """Return those of a state."""
        map_id = state.map_id.unsqueeze(1)
        return cls(state.position, state.mask, map_id, state.pose, state.radius, state.heading, state.kind)

    def scene(self, number: int) -> Bodies:
        """Return those of one scene."""
        return Bodies(*(None if value is None else value[[number]] for value in self))  # type: ignore[arg-type]


class Physics(ABC):
    """Moves agents on the floor plans of its bank, and answers questions about them.

    A backend is one file in `pedzoo.sim.physics`, or ``file.py:Class``. It keeps nothing between two
    questions, so one serves any number of scenes. Agents whose position is not finite are treated as absent.
    Agents move along one common path, `pedzoo.sim.dynamics.integrate`. A backend that simulates bodies of its
    own says which in `owned`, and moves them in `move_owned`.

    Attributes:
        scenes_at_once: Scenes that evaluations run together: memory grows with them, time hardly.
        views: Where its camera can be.
        bank: The floor plans.
        body_radius: Radius of a body where nothing else is said, metres.
    """

    scenes_at_once: ClassVar[int] = 64
    views: ClassVar[tuple[str, ...]] = ("top",)

    def __init__(self, bank: MapBank, body_radius: float = BODY_RADIUS) -> None:
        """Take the floor plans and a radius, above that by which bodies give at walls."""
        if not body_radius > SKIN:
            raise UserError(
                f"body_radius {body_radius}: expected metres above {SKIN}, by which a body gives at walls, "
                f"like {BODY_RADIUS}"
            )
        self.bank, self.body_radius = bank, body_radius

    @classmethod
    def check(cls) -> None:
        """Raise a `UserError` that says how to get it where what the backend needs is not installed."""
        return

    def decide(self, state: State, commands: Tensor, rules: Rules) -> Decision | None:
        """Return what `kernel.step` finds before it asks the planner; None, the default: it finds that."""
        return None

    def owned(self, state: State) -> Tensor | None:
        """Return which agents the backend always moves itself (B, A) bool; None, the default, for none."""
        return None

    def move_owned(self, state: State, inputs: MotionInput) -> OwnedMotion:
        """Return how agents of `owned` that are ``moving`` do; rows of all others do not matter.

        Begin from ``state``: an episode may have begun since the last call. Paths show contacts and goals.
        """
        raise NotImplementedError(f"{type(self).__name__} owns agents and has no move_owned")

    def advance(self, state: State, inputs: MotionInput) -> Motion:
        """Return where agents are every 0.1 s, what they touch on the way and which reach their goals.

        Positions are differentiable with respect to positions, velocities and played paths.
        """
        own = self.owned(state)
        if own is None:
            return self._advance(state, inputs)
        own, others = own & inputs.moving, inputs.played
        moved = self.move_owned(state, inputs._replace(moving=own))
        others = state.position[:, :, None, None] if others is None else others
        played = torch.where(own[:, :, None, None, None], moved.path, others)
        inputs = inputs._replace(moving=inputs.moving & ~own, played=played, owned=moved)
        heading, turn_rate = moved.heading.where(own, torch.nan), moved.turn_rate.where(own, 0.0)
        return self._advance(state, inputs)._replace(heading=heading, turn_rate=turn_rate)

    def _advance(self, state: State, inputs: MotionInput) -> Motion:
        """See `advance`, of agents that move on the common path."""
        position, velocity = state.position.movedim(-1, 0).contiguous(), inputs.velocity * inputs.moving
        path = integrate(position, velocity, state.radius, inputs.substeps, self._walls(state))
        if inputs.played is not None:
            given = inputs.played.flatten(2, 3).permute(3, 2, 0, 1).to(path.dtype)
            path = torch.where(state.mask & ~inputs.moving, given, path)
        steps = path.permute(2, 3, 1, 0).unflatten(2, (-1, inputs.substeps))
        x, y = path.detach() - state.goal_point.detach().movedim(-1, 0).unsqueeze(1)
        near = (torch.addcmul(x * x, y, y) < GOAL_RADIUS**2) & inputs.wanted
        arrived = near.unflatten(0, (-1, inputs.substeps)).any(1).cumsum(0) > 0
        contacts = self._touched(state, steps.detach(), inputs)
        return Motion(steps[:, :, :, -1], *contacts, arrived.permute(1, 2, 0))

    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        """Return which agents touch something on their paths (B, A, S, M, 2); see `contacts`."""
        return self.contacts(path, Bodies.of(state))

    def _walls(self, state: State) -> LocalWalls | None:
        """Return the walls as the agents of each scene see them; None for scenes in the open."""
        return self.bank.to(state.past.device).walls_of_state(state.wall_frame, state.wall_place)

    @abstractmethod
    def contacts(self, path: Tensor, people: Bodies) -> Contacts:
        """Return which agents touch another one or a wall on the way.

        Agents touch when their centres are closer than the sum of their radii, a wall is touched by a centre
        closer than its own. A trace point counts when any of its sub-steps does.

        Args:
            path: Positions after ``people.position`` (B, A, S, M, 2): M sub-steps up to each trace point.
            people: Where people start, and which are present.
        """

    @abstractmethod
    def rays(self, people: Bodies, origin: Tensor, direction: Tensor, reach: float = REACH) -> Tensor:
        """Return how far rays go before they meet a wall or a body (B, R), metres; else ``reach``.

        A ray that starts inside a body does not see that body; one that starts inside a wall goes nowhere.

        Args:
            people: Their bodies are in the way.
            origin: Where each ray starts (B, R, 2), scene positions.
            direction: Unit vectors (B, R, 2).
            reach: Greatest length, metres.
        """

    @abstractmethod
    def image(
        self, people: Bodies, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture (H, W, 3) uint8 RGB of one scene, so many pixels wide and high.

        Without a ``camera`` it is taken from the top: all free space of the floor plan, or all people where
        there is none.
        """

    def onboard(
        self, people: Bodies, heading: Tensor, lens: Lens
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return pictures (B, R, H, W, 3) uint8 RGB and depths (B, R, H, W), metres, as robots see them.

        The last R of ``people`` are robots, which face ``heading`` (B, R), radians. Depths are along the
        optical axis. A robot does not see itself; for absent ones all is 0.

        Raises:
            UserError: The backend has no such camera.
        """
        name = type(self).__name__.lower()
        raise UserError(f"sensor camera: physics {name} has no pictures from robots: take physics='bullet'")

    def framed(self, people: Bodies, scene: int, size: tuple[int, int], camera: Camera | None) -> Camera:
        """Return a camera whose center and width are known."""
        camera = camera or Camera()
        if camera.center is not None and camera.width is not None:
            return camera
        points, margin = people.position[scene][people.mask[scene]], 1.0
        if (grid := self.bank.grid(people.map_id[scene])) is not None:
            corners = torch.from_numpy(free_corners(grid, self.bank.unknown)).to(people.pose)
            points, margin = move_to_scene(corners[None], people.pose[[scene]]), 0.4
        fitted = camera.around(points, size, margin)
        return replace(camera, center=camera.center or fitted.center, width=camera.width or fitted.width)

    def picture(self, state: State, scene: int = 0, size: tuple[int, int] = (640, 480)) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3) uint8 RGB of a scene as it is now, from above, with its goals."""
        bodies, there = Bodies.of(state), state.mask[scene]
        seen = torch.cat((state.position[scene][there], state.goal_point[scene][there]))
        open_floor = int(state.map_id[scene]) < 0
        camera = self.framed(bodies, scene, size, Camera().around(seen, size) if open_floor else None)
        canvas = Canvas(np.ascontiguousarray(self.image(bodies, scene, size, camera)), camera)
        for slot in (there & (state.goal_id[scene] >= 0)).nonzero()[:, 0].tolist():
            canvas.goal(state.goal_point[scene, slot], person_color(slot), width=2)
        return canvas.image

    def close(self) -> None:  # noqa: B027 (most backends hold nothing)
        """Give back what the backend holds outside of Python; it cannot be asked afterwards."""

    def _radius(self, people: Bodies) -> Tensor:
        """Return the radii of the bodies (B, A), metres."""
        usual = people.position.new_full(people.mask.shape, self.body_radius)
        return usual if people.radius is None else people.radius

    def _present(self, people: Bodies) -> Tensor:
        return people.mask & people.position.isfinite().all(-1)
