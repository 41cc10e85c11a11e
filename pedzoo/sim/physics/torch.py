"""Torch, batched, differentiable, on any device: walls are squares of the grid, bodies discs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.maps.walls import LocalWalls
from pedzoo.sim.drawing import Camera, Canvas, draw_floor, person_color
from pedzoo.sim.physics._base import REACH, Bodies, Physics
from pedzoo.sim.state import Contacts, MotionInput, State


class Torch(Physics):
    """The walls as they are, for all scenes at once and on the people's device."""

    @torch.no_grad()
    def contacts(self, path: Tensor, people: Bodies) -> Contacts:
        """See `Physics.contacts`."""
        frame, place = self.bank.walls_of_scenes(self.bank.index(people.map_id[:, 0]), people.pose)
        present = people.mask & path.isfinite().flatten(2).all(2)
        return contacts_of(path, self.bank.walls_of_state(frame, place), present, self._radius(people))

    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        if type(self).contacts is not Torch.contacts:
            return super()._touched(state, path, inputs)
        return contacts_of(path, self._walls(state), state.mask, state.radius)

    @torch.no_grad()
    def rays(self, people: Bodies, origin: Tensor, direction: Tensor, reach: float = REACH) -> Tensor:
        """See `Physics.rays`: a traversal of the grid, and discs by formula; both are loops on the host."""
        from pedzoo.maps.walls_numba import meet_bodies

        valid = (origin.isfinite() & direction.isfinite()).all(-1)
        origin, direction = (torch.where(valid.unsqueeze(-1), values, 0) for values in (origin, direction))
        around = self.bank.to("cpu").walls_around(people.map_id[:, 0].cpu(), people.pose.cpu())
        start, way = (part.cpu().permute(2, 1, 0) for part in (origin, direction))
        walls = around.cast(start, way, reach).t()
        length = torch.full(origin.shape[:2], reach, dtype=origin.dtype)
        given = people.position, self._radius(people), self._present(people), origin, direction
        meet_bodies(*(part.detach().cpu().contiguous().numpy() for part in given), length.numpy())
        return torch.where(valid, length.minimum(walls.to(length)).to(origin), reach)

    def image(
        self, people: Bodies, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """See `Physics.image`; always from the top, drawn without any renderer."""
        camera = replace(self.framed(people, scene, size, camera), view="top")
        grid, radius = self.bank.grid(people.map_id[scene]), self._radius(people)[scene]
        canvas = Canvas(draw_floor(grid, self.bank.unknown, people.pose[scene], size, camera), camera)
        for agent in self._present(people)[scene].nonzero()[:, 0].tolist():
            place, wide, color = people.position[scene, agent], float(radius[agent]), person_color(agent)
            robot = people.kind is not None and int(people.kind[scene, agent]) == ROBOT
            if people.heading is None or robot:
                canvas.disc(place, wide, color)
            else:
                canvas.person(place, float(people.heading[scene, agent]), wide, color)
        return canvas.image


_AT_ONCE = 1 << 17
"""Pairs of agents that are compared at once: what they need stays in the cache of the processor."""


@torch.no_grad()
def contacts_of(path: Tensor, walls: LocalWalls | None, present: Tensor, radius: Tensor) -> Contacts:
    """Return which agents touch another one or a wall in each trace step.

    Args:
        path: Sub-steps (B, A, S, M, 2), metres.
        walls: As agents see them, None for none.
        present: Which agents are there (B, A) bool.
        radius: Of their bodies (B, A), metres.
    """
    path = path.permute(4, 2, 3, 0, 1)
    if walls is None or not present.numel():
        wall = torch.zeros_like(path[0, :, 0], dtype=torch.bool)
    else:
        wall = (walls.half_planes(path, radius)[0].amin(1) < radius) & present
    if len(radius) > radius.shape[1]:
        return Contacts(_of_pairs(path, present, radius).permute(1, 2, 0), wall.permute(1, 2, 0))
    both = radius.unsqueeze(1) + radius.unsqueeze(2)
    least = torch.where(present.unsqueeze(1) & present.unsqueeze(2), both * both, -1.0)
    least.diagonal(dim1=1, dim2=2).fill_(-1.0)  # no agent touches itself
    touching = []
    for part in _parts(path, least):
        x, y = part.unsqueeze(-1) - part.unsqueeze(-2)
        touching.append((torch.addcmul(x * x, y, y).amin(1) < least).any(-1))
    return Contacts(torch.cat(touching).permute(1, 2, 0), wall.permute(1, 2, 0))


def _parts(path: Tensor, least: Tensor) -> tuple[Tensor, ...]:
    """Return paths (2, S, M, ...) in parts of few trace steps, for as many pairs as ``least`` has."""
    return path.split(max(1, _AT_ONCE // max(1, path.shape[2] * least.numel())), dim=1)


def _of_pairs(path: Tensor, present: Tensor, radius: Tensor) -> Tensor:
    """Return the same for many scenes of few agents, each pair once: long runs of numbers, scenes last."""
    agents = radius.shape[1]
    one, other = torch.triu_indices(agents, agents, 1, device=radius.device)
    reach = torch.where(present, radius, torch.nan).mT
    least = (reach.index_select(0, one) + reach.index_select(0, other)).square()
    path, touching = path.mT.contiguous(), []
    for part in _parts(path, least):
        x, y = part.index_select(3, one) - part.index_select(3, other)
        touching.append(torch.addcmul(x * x, y, y).amin(1) < least)
    hits = torch.zeros_like(path[0, :, 0], dtype=torch.int16)
    touches = torch.cat(touching).short()
    return (hits.index_add(1, one, touches).index_add_(1, other, touches) > 0).mT
