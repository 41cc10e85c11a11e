"""A world of torch alone: walls are the squares of the occupancy grid, bodies are discs."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.local_walls import LocalWalls
from pedzoo.maps.planar import columns
from pedzoo.sim.worlds.base import REACH, Contacts, Distances, People, World
from pedzoo.sim.worlds.camera import Camera
from pedzoo.sim.worlds.near import farthest, near_pairs
from pedzoo.sim.worlds.top_view import draw_top_view
from pedzoo.sim.worlds.wall_rays import WallRays
from pedzoo.types import BODY_RADIUS

_CHUNK = 4_000_000
"""Ray-body pairs that are compared at once."""


class GridWorld(World):
    """Exact distances to the grid's squares, for all scenes at once and on the people's device."""

    def __init__(self, bank: MapBank, body_radius: float = BODY_RADIUS) -> None:
        """Take the floor plans.

        Raises:
            UserError: The radius is too small.
        """
        super().__init__(bank, body_radius)
        self._wall_rays: WallRays | None = None

    def distances(self, people: People, reach: float = REACH) -> Distances:
        """See `World.distances`; differentiable with respect to positions."""
        self._check_reach(reach)
        present = self._present(people)
        position = torch.where(present.unsqueeze(-1), people.position, 0)
        between = torch.cdist(position, position, compute_mode="donot_use_mm_for_euclid_dist")
        alone = torch.eye(position.shape[1], dtype=torch.bool, device=position.device)
        valid = present.unsqueeze(1) & present.unsqueeze(2) & ~alone
        between = torch.where(valid, between, reach).clamp_max(reach)
        if position.shape[1]:
            agent, nearest = between.min(-1)
        else:
            agent, nearest = position[..., 0], torch.zeros_like(people.mask, dtype=torch.long)
        apart = position - position.gather(1, nearest.unsqueeze(-1).expand_as(position))
        apart = torch.where((agent < reach).unsqueeze(-1), apart, 0)
        wall, away = self.bank.closest_wall(position, people.map_id[:, 0], people.pose)
        near = present & (wall < reach)
        return Distances(
            agent=agent,
            wall=torch.where(near, wall, reach),
            agent_normal=torch.nn.functional.normalize(apart, dim=-1),
            wall_normal=torch.where(near.unsqueeze(-1), away, 0),
        )

    @torch.no_grad()
    def contacts(self, path: Tensor, people: People, walls: LocalWalls | None = None) -> Contacts:
        """See `World.contacts`: bounds first, and the exact question only for the few whom they leave."""
        # coordinates first, people last, (2, S, M, B * A): as `dynamics.walk` has them in memory
        planes = path.permute(4, 2, 3, 0, 1).contiguous().flatten(3)
        # a bound about the middle of a way is half of one about its start
        middle = planes.flatten(1, 2)[:, planes.shape[1] * planes.shape[2] // 2]
        far = farthest(planes.flatten(1, 2), middle).view(people.mask.shape)
        present = people.mask & far.isfinite()
        pairs = near_pairs(middle.t().unflatten(0, far.shape), present, far, 2 * self.body_radius)
        first, second = pairs.places(far.shape[1])
        apart = columns(planes, first) - columns(planes, second)
        hit = (apart.square().sum(0) < (2 * self.body_radius) ** 2).any(1)
        agent = torch.zeros(planes.shape[1::2], dtype=torch.bool, device=path.device)
        point, pair = hit.nonzero(as_tuple=True)
        agent[point.repeat(2), torch.cat((first[pair], second[pair]))] = True
        if walls is None:
            walls = self.bank.walls_of_people(people.map_id[:, 0], people.pose, far.shape[1])
        wall = self._wall_contacts(planes, middle, far.flatten(), present.flatten(), walls)
        return Contacts(*(touch.t().unflatten(0, far.shape) for touch in (agent, wall)))

    def _wall_contacts(
        self, path: Tensor, middle: Tensor, far: Tensor, present: Tensor, walls: LocalWalls | None
    ) -> Tensor:
        """Return when who touches a wall (S, P) bool.

        Args:
            path: Sub-steps (2, S, M, P), metres.
            middle: A point of each path (2, P).
            far: What no point of it is farther away (P,).
            present: Whom to ask about (P,) bool.
            walls: As they see them.
        """
        touching = torch.zeros(path.shape[1::2], dtype=torch.bool, device=path.device)
        if walls is not None:
            near = present & (walls.least(middle.unsqueeze(1))[0] < far + self.body_radius)
            who = near.nonzero()[:, 0]
            hit = walls.rows(who).within(columns(path, who), self.body_radius)
            touching.index_copy_(1, who, hit)
        return touching

    @torch.no_grad()
    def rays(self, people: People, origin: Tensor, direction: Tensor, reach: float = REACH) -> Tensor:
        """See `World.rays`: a traversal of the grid, and discs by formula."""
        if self._wall_rays is None or self._wall_rays.leap.device != origin.device:
            self._wall_rays = WallRays.of(self.bank.grids, self.bank.unknown, origin.device)
        valid = (origin.isfinite() & direction.isfinite()).all(-1)
        origin, direction = (torch.where(valid.unsqueeze(-1), values, 0) for values in (origin, direction))
        row = self.bank.index(people.map_id[:, 0])
        walls = self._wall_rays.cast(origin, direction, row, people.pose, reach).to(origin.dtype)
        chunk = max(1, _CHUNK // max(1, people.mask.numel()))
        bodies = [
            self._body_rays(people, some_origins, some_directions, reach)
            for some_origins, some_directions in zip(
                origin.split(chunk, 1), direction.split(chunk, 1), strict=True
            )
        ]
        return torch.where(valid, torch.minimum(walls, torch.cat(bodies, 1)), reach)

    def _body_rays(self, people: People, origin: Tensor, direction: Tensor, reach: float) -> Tensor:
        present = self._present(people)
        if not people.mask.shape[1]:
            return origin.new_full(origin.shape[:2], reach)
        # |origin + t direction - position| = radius, the smaller t; a root below zero lies behind the ray
        apart = origin.unsqueeze(2) - people.position.unsqueeze(1)
        along = (apart * direction.unsqueeze(2)).sum(-1)
        outside = apart.square().sum(-1) - self.body_radius**2
        root = along.square() - outside
        entry = -along - root.clamp_min(0).sqrt()
        seen = (root > 0) & (entry >= 0) & (outside > 0) & present.unsqueeze(1)
        return torch.where(seen, entry, reach).amin(-1).clamp_max(reach)

    def image(
        self, people: People, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """See `World.image`; always from the top, drawn without any renderer."""
        return draw_top_view(
            self._plan(people, scene),
            self.bank.unknown,
            people.pose[scene],
            people.position[scene],
            self._present(people)[scene],
            self.body_radius,
            size,
            self._framed(people, scene, size, camera),
        )
