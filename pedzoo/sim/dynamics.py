"""How people move: one pure, differentiable function, the same in every world.

A person goes where the action says, never faster than their top speed. Walls stop them, and they slide
along. Nobody is pushed apart: overlapping people are counted, not repaired.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.maps.local_walls import LocalWalls
from pedzoo.maps.planar import columns
from pedzoo.types import BODY_RADIUS, TRACE_SECONDS

SKIN = 0.01
"""Metres by which a body gives at a wall: whoever presses against one is seen to touch it, by every world."""

_PUSHES = 3
"""Corrections per place: an inner corner has two walls, and the second may push back to the first."""

_STRETCH = 4
"""So many sub-steps are first asked about in one go."""

_ROUNDING = 1e-5
"""Metres that are not worth a correction; ten times as much is not accepted after the last one."""


def substeps(fastest: float, body_radius: float = BODY_RADIUS) -> int:
    """Return how many sub-steps a trace step of 0.1 s needs for a top speed.

    Nobody may move more than half a body radius in one: then nobody passes through a wall or another
    person unseen. A little less, because a body gives by `SKIN` at walls, and two sub-steps are a stride.
    """
    return max(1, math.ceil(fastest * TRACE_SECONDS / ((body_radius - SKIN) / 2) - 1e-9))


def walk(
    position: Tensor,
    velocity: Tensor,
    seconds: float,
    steps: int,
    walls: LocalWalls | None,
    body_radius: float = BODY_RADIUS,
) -> Tensor:
    """Return where people are (B, A, N, 2) after each of N equal sub-steps.

    Differentiable with respect to positions and velocities. Who starts inside a wall may only move out.

    Args:
        position: Where they are (B, A, 2), metres.
        velocity: What they want (B, A, 2), m/s, their top speed respected already.
        seconds: Duration of all sub-steps together.
        steps: N.
        walls: As people see them (`MapBank.walls_of_people`), None for none.
        body_radius: Of a person, metres.
    """
    time = torch.linspace(seconds / steps, seconds, steps, device=position.device, dtype=position.dtype)
    # coordinates first, people last, (2, N, B * A): on the CPU several times faster than pairs
    start, wanted = (values.flatten(0, 1).t().contiguous() for values in (position, velocity))
    path = torch.addcmul(start.unsqueeze(1), wanted.unsqueeze(1), time.unsqueeze(1))
    if walls is not None:
        path = _along_walls(path, start, wanted * (seconds / steps), walls, body_radius)
    return path.permute(2, 1, 0).unflatten(0, position.shape[:2])


def _along_walls(path: Tensor, start: Tensor, move: Tensor, walls: LocalWalls, body_radius: float) -> Tensor:
    """Return ``path`` (2, N, P) with the ways of those who meet a wall.

    Args:
        path: Straight ways.
        start: Where they begin (2, P).
        move: What everybody wants in a sub-step (2, P).
        walls: As people see them.
        body_radius: Of a person, metres.
    """
    reach, steps = body_radius - SKIN, path.shape[1]
    with torch.no_grad():  # who can come to a wall at all, then who does
        half = move * (steps / 2)
        least = walls.least((start + half).unsqueeze(1))[0]
        who = (least < torch.hypot(*half) + reach).nonzero()[:, 0]
        some = walls.rows(who)
        stretches = columns(path, who).unflatten(1, (-1, math.gcd(steps, _STRETCH)))
        touching = some.within(stretches, reach).any(0).nonzero()[:, 0]
        who, some = who[touching], some.rows(touching)
    if not len(who):
        return path
    slid = _slide(start.index_select(1, who), move.index_select(1, who), steps, some, body_radius)
    return path.index_copy(2, who, slid)


def _slide(start: Tensor, move: Tensor, steps: int, walls: LocalWalls, body_radius: float) -> Tensor:
    """Return ways (2, N, P) of people who meet a wall.

    Nobody comes nearer to the nearest wall than a body's radius, or than they are already; whoever is then
    too near to another wall is pushed off it.

    Args:
        start: Where they begin (2, P), metres.
        move: What they want in a sub-step (2, P), metres.
        steps: N.
        walls: As they see them.
        body_radius: Of a person, metres.
    """
    reach = body_radius - SKIN
    # two sub-steps are no longer than the reach: nobody gets to the other side of a wall in them
    stride = 2 - steps % 2
    here, move = start.double(), stride * move.double()
    gap, away = _look(walls, here)
    allowed = gap.detach().clamp_max(reach)
    way, kept = [here], []
    for _ in range(steps // stride):
        kept.append(allowed)
        excess = allowed - gap - (move * away).sum(0)
        wanted = torch.addcmul(here + move, excess.clamp_min(0), away)
        before = here, gap, away
        here, gap, away, stuck = _off_walls(walls, wanted, allowed)
        if bool(stuck.any()):
            now = here, gap, away
            here, gap, away = (torch.where(stuck, old, new) for old, new in zip(before, now, strict=True))
        allowed = gap.detach().clamp_max(reach).maximum(allowed)  # rounding must not add up
        way.append(here)
    ends = torch.stack(way, dim=1)
    if stride == 1:
        return ends[:, 1:].to(start.dtype)
    # a straight line between two places may cut a corner
    between, _, _, stuck = _off_walls(walls, torch.lerp(ends[:, :-1], ends[:, 1:], 0.5), torch.stack(kept))
    between = torch.where(stuck, ends[:, :-1], between)
    return torch.stack((between, ends[:, 1:]), dim=2).flatten(1, 2).to(start.dtype)


def _off_walls(walls: LocalWalls, place: Tensor, allowed: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Push people who are nearer to a wall than ``allowed`` (..., P) off it.

    Returns:
        Where they are (2, ..., P); their distance to the nearest wall (..., P), and where it grows
        (2, ..., P); and who is too near all the same (..., P) bool.
    """
    gap, away = _look(walls, place)
    for _ in range(_PUSHES):
        lacking = allowed - gap
        too_close = lacking > _ROUNDING
        if not bool(too_close.any()):
            break
        # only these: what happens to one person does not depend on who else is asked about
        place = torch.addcmul(place, lacking * too_close, away)
        gap, away = _look(walls, place)
    return place, gap, away, gap < allowed - 10 * _ROUNDING


def _look(walls: LocalWalls, place: Tensor) -> tuple[Tensor, Tensor]:
    """Return the distance to the nearest wall (..., P), differentiable, and where it grows (2, ..., P)."""
    gap, away = walls.look(place.detach().view(2, -1, place.shape[-1]))
    gap, away = gap.view(place.shape[1:]), away.view(place.shape)
    if place.requires_grad:
        gap = gap + ((place - place.detach()) * away).sum(0)
    return gap, away
