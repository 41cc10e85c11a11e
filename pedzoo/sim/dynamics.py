"""How people move: one pure, differentiable function, the same in every world.

A person goes where the action says, never faster than their top speed. Walls stop them, and they slide
along. Nobody is pushed apart: overlapping people are counted, not repaired.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.walls import LocalWalls
from pedzoo.types import BODY_RADIUS, TRACE_SECONDS

SKIN = 0.01
"""Metres by which a body gives at a wall: whoever presses against one is seen to touch it, by every world."""

_PUSHES = 3
"""Corrections per sub-step: an inner corner has two walls, and the second may push back to the first."""

_ROUNDING = 1e-5
"""Metres that are not worth a correction; ten times as much is not accepted after the last one."""


def substeps(fastest: float, body_radius: float = BODY_RADIUS) -> int:
    """Return how many sub-steps a trace step of 0.1 s needs for a top speed.

    Nobody may move more than half a body radius in one: then nobody passes through a wall or another
    person unseen.
    """
    return max(1, math.ceil(fastest * TRACE_SECONDS / (body_radius / 2)))


def walk(
    position: Tensor,
    velocity: Tensor,
    seconds: float,
    steps: int,
    bank: MapBank,
    map_id: Tensor,
    pose: Tensor,
    body_radius: float = BODY_RADIUS,
) -> Tensor:
    """Return where people are (B, A, N, 2) after each of N equal sub-steps.

    Differentiable with respect to positions and velocities. Who starts inside a wall may only move out.

    Args:
        position: Where they are (B, A, 2), metres.
        velocity: What they want (B, A, 2), m/s, their top speed respected already.
        seconds: Duration of all sub-steps together.
        steps: N.
        bank: The floor plans.
        map_id: Floor plan of each scene (B,) long, -1 for none.
        pose: Scene poses (B, 4).
        body_radius: Of a person, metres.
    """
    time = torch.linspace(seconds / steps, seconds, steps, device=position.device, dtype=position.dtype)
    path = position.unsqueeze(2) + velocity.unsqueeze(2) * time.unsqueeze(1)
    if not bank.grids:
        return path
    reach = body_radius - SKIN
    with torch.no_grad():  # who can come to a wall at all, then who does
        field = bank.signed_distance(position, map_id, pose)
        near = field < reach + bank.field_error + velocity.norm(dim=-1) * seconds
        scene, slot = near.nonzero(as_tuple=True)
        if not len(scene):
            return path
        touching = bank.walls_within(path[scene, slot], map_id[scene], pose[scene], reach).any(1)
        scene, slot = scene[touching], slot[touching]
    if not len(scene):
        return path
    walls = bank.walls_around(map_id[scene], pose[scene])
    slid = _slide(position[scene, slot], velocity[scene, slot] * (seconds / steps), steps, walls, reach)
    return path.index_put((scene, slot), slid)


def _slide(position: Tensor, move: Tensor, steps: int, walls: LocalWalls, reach: float) -> Tensor:
    """Return paths (P, N, 2) of people (P, 2) who meet a wall and want to ``move`` (P, 2) per sub-step."""
    distance, _ = walls.closest(position)
    path = []
    for _ in range(steps):
        wanted = position + move
        allowed = distance.detach().clamp_max(reach)  # whoever is too close already may not come closer
        gap, away = walls.closest(wanted)
        for _ in range(_PUSHES):
            too_close = gap < allowed - _ROUNDING
            if not bool(too_close.any()):
                break
            # only these: what happens to one person does not depend on who else is asked about
            push = torch.where(too_close, allowed - gap, 0.0)
            wanted = wanted + push.unsqueeze(-1) * away.detach()
            gap, away = walls.closest(wanted)
        stuck = gap < allowed - 10 * _ROUNDING
        position = torch.where(stuck.unsqueeze(-1), position, wanted)
        distance = torch.where(stuck, distance, gap.maximum(allowed))  # rounding must not add up
        path.append(position)
    return torch.stack(path, dim=1)
