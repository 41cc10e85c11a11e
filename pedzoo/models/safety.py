"""A net under a learned policy: the least change of everybody's next step that keeps bodies from touching.

In the spirit of the safety layer of Dalal et al., "Safe exploration in continuous action spaces", 2018: the
network decides where to go, and what it asks for is projected on what can be walked without a contact. It
looks one step ahead and no farther: it plans nothing, waits for nobody and finds no way around. Only robots,
which leave all of the avoidance to people, are seen from afar: `pedzoo.models.yielding`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.batch import ROBOT, agents_of, maps_of
from pedzoo.geometry import limit_speed
from pedzoo.maps.local_walls import LocalWalls
from pedzoo.models.clearance import Near, Pairs, Steps
from pedzoo.models.yielding import yielding
from pedzoo.types import STEP_SECONDS, TOP_SPEED_RATIO

ROUNDS = 8
"""Corrections at most: each may undo a part of another."""

NARROW = 0.5
"""Metres to a wall, before or after the step: in the open people turn a shoulder and pass closer."""

WAITED = 0.4
"""Metres within the observed steps, 2.8 s, below which somebody waits. Two who wait for each other in a
narrow place turn a shoulder, too: nobody else would end that."""


def kept_clear(steps: Steps, walls: LocalWalls | None = None) -> Tensor:
    """Return steps (B, A, 2) near those that are asked for, in which nobody touches anybody or a wall.

    Two people share a correction. Agents that the policy does not move take no part in it, and robots leave
    it to people: the other one makes all of it. Agents that touch already come no closer. Neither turning a
    scene nor the order of its people changes anything. Differentiable.

    Args:
        steps: What is asked for.
        walls: As people see them (`MapBank.walls_of_people`), B * A entries; None for none.
    """
    narrow = near = None
    if walls is not None:
        ends = torch.stack((steps.position, steps.position + steps.step), 2)
        gap, _ = walls.closest(ends.flatten(0, 1))
        narrow = (gap < NARROW).any(1).view(steps.moved.shape)
        near = Near.of(steps, walls, gap[:, :1])
    pairs = Pairs.of(steps, narrow)
    step = _capped(steps, steps.step)
    groups = [group for group in (pairs, near) if group is not None]
    for _ in range(ROUNDS):
        before = step
        for group in groups:
            step = group.corrected(step)
        if step is before:
            return step
        step = _capped(steps, step)
    return _stopped(step, groups)


def _stopped(step: Tensor, groups: Sequence[Pairs | Near]) -> Tensor:
    """Return steps (B, A, 2), shorter ones of whoever would touch something all the same.

    Whoever is run into goes on: in a jam those in front have to get away first.
    """
    with torch.no_grad():
        share = torch.ones_like(step[..., :1])
        # half a step first, then none; every turn stops somebody, and when all stand nobody touches anybody
        for turn in range(step.shape[1] + 2):
            touching = torch.stack([group.touching(step * share) for group in groups]).any(0)
            if not bool(touching.any()):
                break
            share = torch.where(touching.unsqueeze(-1), 0.0 if turn else 0.5, share)
    return step * share


def safe(batch: TensorDictBase, step: Tensor) -> Tensor:
    """Return everybody's next steps (B, A, 2), metres, kept clear; see `kept_clear`.

    Args:
        batch: Scenes.
        step: What people are asked to do (B, A, 2), metres.
    """
    agents, bank = agents_of(batch), maps_of(batch)
    moved = agents["mask"] & agents["controlled"]
    there = agents["mask"].unsqueeze(-1)
    history = cast("Tensor", agents["history"])
    here = history[:, :, -1]
    steps = Steps(
        torch.where(there, here, 0.0),
        torch.where(moved.unsqueeze(-1), step, agents["velocity"] * STEP_SECONDS).where(there, 0.0),
        TOP_SPEED_RATIO * STEP_SECONDS * cast("Tensor", agents["pref_speed"])[..., 0],
        agents["mask"],
        moved,
        (history - here.unsqueeze(2)).norm(dim=-1).amax(2) < WAITED,
        cast("Tensor", agents["radius"])[..., 0],
        agents["kind"] == ROBOT,
    )
    walls = bank.walls_of_people(batch["map_id"][:, 0], batch["scene_pose"], moved.shape[1])
    return kept_clear(steps._replace(step=yielding(steps, walls)), walls)


def _capped(steps: Steps, step: Tensor) -> Tensor:
    return torch.where(steps.moved.unsqueeze(-1), limit_speed(step, steps.longest), steps.step)
