"""The view of robots' sensors: the scenes, and their values in a robot's own frame."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import direction_of, rotate, unrotate
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.physics_parts.base import Physics
from pedzoo.sim.physics_parts.bodies import Bodies
from pedzoo.sim.state import State


class RobotView(NamedTuple):
    """B scenes of A agents, of which the last R are robots.

    Attributes:
        state: The scenes.
        guidance: What the planner says to all agents.
        physics: Casts rays, and takes pictures.
        robots: R.
    """

    state: State
    guidance: Guidance
    physics: Physics
    robots: int

    @property
    def position(self) -> Tensor:
        """Where robots are (B, R, 2), metres."""
        return self.state.position[:, -self.robots :]

    @property
    def heading(self) -> Tensor:
        """Where they face (B, R), radians."""
        return self.state.heading[:, -self.robots :]

    @property
    def ahead(self) -> Tensor:
        """Unit vectors (B, R, 2) to where they face."""
        return direction_of(self.heading)

    @property
    def bodies(self) -> Bodies:
        """All agents that are there, as physics backends take them."""
        return Bodies.of(self.state)

    def own(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the world in the robots' frames: x ahead, y to the left."""
        return unrotate(vectors, _aligned(self.ahead, vectors))

    def world(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the robots' frames in the world's: the inverse of `own`."""
        return rotate(vectors, _aligned(self.ahead, vectors))

    def own_places(self, points: Tensor) -> Tensor:
        """Return places (B, R, ..., 2) of the world as robots see them from where they are, metres."""
        return self.own(points - _aligned(self.position, points))

    def rays(self, direction: Tensor, reach: float, people: bool = True) -> Tensor:
        """Return how far rays from the robots' centres go (B, R, N), metres, at most ``reach``.

        Args:
            direction: Unit vectors of the world (B, R, N, 2).
            reach: Metres.
            people: Other agents are in the way, too, and not walls alone; a robot does not see itself.
        """
        scenes, robots, rays, _ = direction.shape
        origin = self.position.unsqueeze(2).expand_as(direction).flatten(1, 2)
        bodies = self.bodies
        if not people:
            bodies = bodies._replace(mask=torch.zeros_like(bodies.mask))
        # a ray that begins inside a body does not see it: so a robot does not see itself
        return self.physics.rays(bodies, origin, direction.flatten(1, 2), reach).view(scenes, robots, rays)


def shape_of(value: object) -> tuple[int, ...] | str:
    """Return the shape of what a person's own code returned, or what it is if it is no tensor."""
    return tuple(value.shape) if isinstance(value, Tensor) else f"{value!r:.60}, no tensor"


def _aligned(value: Tensor, like: Tensor) -> Tensor:
    """Return (B, R, 2) with as many dimensions as ``like`` (B, R, ..., 2)."""
    return value.view(*value.shape[:2], *[1] * (like.dim() - 3), 2)
