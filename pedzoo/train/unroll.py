"""Recorded people walked by a policy from where a window's observed part ends, without an environment.

What the environment would tell them in the open, step by step and differentiable: `pedzoo.sim.env` with the
scenario `replay` and no walls gives the same observations. B scenes, A people, N steps of 0.4 s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo import geometry
from pedzoo.batch import agents_of, goals_of, maps_of, scene_batch
from pedzoo.sim.scenario import SLOWEST
from pedzoo.sim.state import TURNS_FROM
from pedzoo.types import AHEAD_SECONDS, GOAL_RADIUS, STEP_SECONDS, TOP_SPEED_RATIO

Walk = Callable[[TensorDict], Tensor]
"""Returns everybody's next displacement (B, A, 2), metres, for what they see."""

_NEAR = 1e-6
"""Metres: whoever is so near to a place is there."""


class Unrolled(NamedTuple):
    """How the people of recorded windows go on.

    Attributes:
        xy: Positions at the end of each step (B, A, N, 2), metres; the last one where they have left.
        walked: Whom a policy has in the step (B, A, N) bool; the step in which they arrive is the last.
        present: Who is there meanwhile (B, A, N) bool: these, and who is played back.
    """

    xy: Tensor
    walked: Tensor
    present: Tensor


def unroll(walk: Walk, batch: TensorDict, steps: int, key: Tensor | None = None) -> Unrolled:
    """Return what comes of ``walk`` when all people of recorded windows walk together.

    In every step the goal is the point ``pref_speed`` x 3.2 s ahead on the straight line from where somebody
    is to their destination, and beyond it. ``pref_speed`` is what was observed, at least 0.3 m/s, and nobody
    walks faster than 1.3 times that. Whoever comes within 0.3 m of their destination leaves, and so does
    everybody in the moment in which they really left. People who are at their destination from the beginning
    are played back, not controlled. Nobody is set back to where they really were. There are no walls.

    Gradients flow through all that people see, others included; who leaves when has none.

    Args:
        walk: The policy.
        batch: Recorded windows with the goal protocol ``destination`` and at least ``steps`` of future.
        steps: N.
        key: Keys (B,) long, by which a `pedzoo.models.walker.Walker` draws noise; 0 to B - 1 if None.

    Raises:
        UserError: The windows have no goals.
    """
    agents, maps, there = agents_of(batch), maps_of(batch), known_to_be_there(batch)
    destination = goals_of(batch, "walking on")[0]
    pref_speed = agents["pref_speed"].clamp_min(SLOWEST)
    top_speed = TOP_SPEED_RATIO * pref_speed[..., 0]
    history, valid, velocity = list(agents["history"].unbind(2)), agents["valid"], agents["velocity"]
    heading = agents["heading"][..., 0]
    on_their_way = agents["mask"] & _controlled(history[-1], destination)
    slots = torch.arange(there.shape[1], device=there.device).expand(there.shape[:2])
    key = torch.arange(len(batch), device=there.device) if key is None else key
    here, found = agents["mask"], []
    for step in range(steps):
        here = here & there[..., step]
        position, moving = history[-1], here & on_their_way
        unit = _towards(position, destination)
        seen = scene_batch(
            maps=maps,
            map_id=batch["map_id"],
            pose=batch["scene_pose"],
            history=torch.stack(history[-valid.shape[2] :], 2),
            valid=valid,
            mask=here,
            velocity=velocity,
            heading=heading.unsqueeze(-1),
            pref_speed=pref_speed,
            radius=agents["radius"],
            kind=agents["kind"],
            goal=position + unit * (pref_speed * AHEAD_SECONDS),
            desired_velocity=unit * pref_speed,
            controlled=moving,
            id=slots.where(here, -1),
            key=key.unsqueeze(1),
            time=pref_speed.new_full((len(batch), 1), step * STEP_SECONDS),
        )
        moved = geometry.limit_speed(walk(seen) / STEP_SECONDS, top_speed) * STEP_SECONDS
        played = torch.where(here.unsqueeze(2), agents["future"][:, :, step], position)
        place = torch.where(moving.unsqueeze(2), position + moved, played)
        found.append((place, moving, here))
        here = here & ~(moving & _arrives(position.detach(), place.detach(), destination))
        history.append(place)
        velocity = (place - position) / STEP_SECONDS
        heading = geometry.heading_of(velocity, heading, TURNS_FROM)
        valid = torch.cat((valid[..., 1:], here.unsqueeze(2)), 2)
    return Unrolled(*(torch.stack(values, 2) for values in zip(*found, strict=True)))


def recorded(batch: TensorDict, steps: int) -> Unrolled:
    """Return how they really went on, with ``walked`` as a policy that walks like them would have it.

    They are ``present`` until they really leave, even if they stand about at their destination before.
    """
    agents, there = agents_of(batch), known_to_be_there(batch)[..., :steps]
    destination, xy = goals_of(batch, "walking on")[0], agents["future"][:, :, :steps]
    before = torch.cat((agents["history"][:, :, -1:], xy[:, :, :-1]), 2)
    arrives = _arrives(before, xy, destination.unsqueeze(2))
    had = torch.cat((torch.zeros_like(arrives[..., :1]), arrives[..., :-1]), 2).cummax(2).values
    walked = there & ~had & _controlled(before[:, :, 0], destination).unsqueeze(2)
    return Unrolled(xy, walked, there)


def known_to_be_there(batch: TensorDict) -> Tensor:
    """Return who is there from begin to end of each future step (B, A, T) bool: until they are not seen."""
    agents = agents_of(batch)
    known: Tensor = agents["future_valid"] & agents["mask"].unsqueeze(2)
    return torch.cummin(known, 2).values


def _controlled(position: Tensor, destination: Tensor) -> Tensor:
    """Return who is not at their destination already (B, A) bool."""
    return (destination - position).norm(dim=-1) > GOAL_RADIUS


def _towards(position: Tensor, destination: Tensor) -> Tensor:
    """Return unit vectors (B, A, 2), zero where somebody is there."""
    way = destination - position
    return way / way.square().sum(-1, keepdim=True).clamp_min(_NEAR**2).sqrt()


def _arrives(begin: Tensor, end: Tensor, destination: Tensor) -> Tensor:
    """Return whose straight way (..., 2) comes within 0.3 m of their destination (...,) bool."""
    move, away = end - begin, begin - destination
    nearest = away + geometry.nearest_part(away, move).unsqueeze(-1) * move
    return nearest.square().sum(-1) < GOAL_RADIUS**2
