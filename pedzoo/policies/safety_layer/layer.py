"""A net under a learned policy: the least change of all next steps that keeps bodies from touching.

In the spirit of the safety layer of Dalal et al., "Safe exploration in continuous action spaces", 2018. The
network decides where to go, and its answer is projected on what can be walked without a contact. The layer
looks one step ahead and no farther: it plans nothing, does not wait and finds no way around. Only robots,
which leave all of the avoidance to people, are seen from afar: `pedzoo.policies.safety_layer.yielding`.
"""

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, agents_of, ids_of, maps_of
from pedzoo.core.geometry import limit_speed
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.walls.local_walls import LocalWalls
from pedzoo.policies.safety_layer.clearance import (
    NARROW,
    ROUNDS,
    SHARES,
    SHOULDERS,
    PairConstraints,
    ProposedSteps,
    WallConstraints,
)
from pedzoo.policies.safety_layer.compiled_clearance import kept_clear_compiled, loops_take
from pedzoo.policies.safety_layer.yielding import yielding

WAITED = 0.4
"""Metres within the observed steps, 2.8 s, below which a person waits.

Two people who wait for each other in a narrow place turn a shoulder, too, and one of them makes way:
otherwise they wait for ever.
"""


def kept_clear(steps: ProposedSteps, walls: LocalWalls | None = None, shoulders: float = SHOULDERS) -> Tensor:
    """Return steps (B, A, 2), metres, near those that are asked for, without contacts of bodies or walls.

    Two people share a correction, by who goes first: see `precedence`. Agents that the policy does not move
    take no part in it, and robots leave it to people: the other one makes all of it. Agents that touch
    already part, if velocities blend, else they come no closer. Neither turning a scene nor the order of its
    people changes anything. Two who meet exactly head-on keep to the right.

    Differentiable. Walls are those of `MapBank.walls_around`; ``shoulders`` is the room in narrow places,
    metres: 0 for bodies alone.
    """
    compiled = loops_take(steps)
    return (kept_clear_compiled if compiled else kept_clear_in_torch)(steps, walls, shoulders)


def safe(batch: TensorDictBase, step: Tensor, shoulders: float = SHOULDERS) -> Tensor:
    """Return the next steps of all agents (B, A, 2), metres, kept clear; see `kept_clear`."""
    agents, bank = agents_of(batch), maps_of(batch)
    moved = agents["mask"] & agents["controlled"]
    there = agents["mask"].unsqueeze(-1)
    history, velocity = cast("Tensor", agents["history"]), cast("Tensor", agents["velocity"])
    here = history[:, :, -1]
    waits = (history - here.unsqueeze(2)).norm(dim=-1).amax(2) < WAITED
    steps = ProposedSteps(
        torch.where(there, here, 0.0),
        torch.where(moved.unsqueeze(-1), step, velocity * STEP_SECONDS).where(there, 0.0),
        STEP_SECONDS * cast("Tensor", agents["top_speed"])[..., 0],
        agents["mask"],
        moved,
        waits,
        cast("Tensor", agents["radius"])[..., 0],
        agents["kind"] == ROBOT,
        torch.where(there, velocity, 0.0),
        _ranks(batch, waits),
    )
    walls = bank.walls_around(batch["map_id"][:, 0], batch["scene_pose"]) if bank.grids else None
    return kept_clear(steps._replace(step=yielding(steps, walls)), walls, shoulders)


def _ranks(batch: TensorDictBase, waits: Tensor) -> Tensor | None:
    """Return a number of every agent (B, A), which two who wait need; None on the CPU where none waits."""
    if waits.device.type == "cpu" and not bool(waits.any()):
        return None
    return randomness.uniform(randomness.join(scene_keys(batch), "rank", ids_of(batch)))


def scene_keys(batch: TensorDictBase) -> Tensor:
    """Return what names the scenes (B, 1) long; 0 where nothing does."""
    keys = batch.get("scene_key", None)
    return torch.zeros_like(batch["map_id"]) if keys is None else cast("Tensor", keys)


def kept_clear_in_torch(
    steps: ProposedSteps, walls: LocalWalls | None, shoulders: float = SHOULDERS
) -> Tensor:
    """`kept_clear` on any device and in any precision."""
    narrow = wall_constraints = None
    if walls is not None:
        walls = walls.per_scene()
        ends = torch.stack((steps.position, steps.position + steps.step), 2).detach().movedim((3, 2), (0, 1))
        gap, away = walls.look(ends, edges=False)
        narrow = (gap < NARROW).any(0)
        here = steps.position.movedim(-1, 0)
        wall_constraints = WallConstraints.of(
            steps, walls, gap[0] + ((here - here.detach()) * away[:, 0]).sum(0)
        )
    step = _capped(steps, steps.step)
    pairs = PairConstraints.of(steps._replace(step=step.detach()), narrow, shoulders)
    step = torch.where(pairs.stands.unsqueeze(-1), 0.0, step)
    for _ in range(ROUNDS):
        step = step + pairs.correction(steps.integrate(step)).movedim(0, -1)
        if wall_constraints is not None:
            step = step + wall_constraints.correction(steps.integrate(step)).movedim(0, -1)
        step = _capped(steps, step)
    return step * _kept_share(steps, step.detach(), pairs, wall_constraints).unsqueeze(-1)


@torch.no_grad()
def _kept_share(
    steps: ProposedSteps, step: Tensor, pairs: PairConstraints, wall_constraints: WallConstraints | None
) -> Tensor:
    """Return which part of their steps (B, A) people walk: less of it if they would touch something.

    A person that others run into goes on: in a jam those in front have to get away first.
    """
    walks = [steps.integrate(share * step) for share in SHARES]
    kinds = len(walks)
    # contacts of a pair depend on both shares: they are known for all of them before an agent stops
    upper = {(i, j): pairs.touching(walks[i], walks[j]) for i in range(kinds - 1) for j in range(i, kinds)}
    upper[kinds - 1, kinds - 1] = torch.zeros_like(upper[0, 0])
    touch = torch.stack(
        [upper[i, j] if i <= j else upper[j, i].mT for i in range(kinds) for j in range(kinds)]
    )
    wall = torch.zeros(kinds, *steps.moved.shape, dtype=torch.bool, device=step.device)
    if wall_constraints is not None:
        wall = torch.stack([*(wall_constraints.touching(walk) for walk in walks[:-1]), wall[-1]])
    chosen = torch.zeros_like(steps.moved, dtype=torch.long)
    # less at every turn; later ones all stop some agent, and agents that all stand do not touch
    for turn in range(step.shape[1] + kinds - 1):
        mine, theirs = chosen.unsqueeze(2), chosen.unsqueeze(1)
        none = torch.full_like(chosen, kinds - 1)
        both, alone, other = (
            touch.gather(0, (kinds * i + j).expand(touch.shape[1:]).unsqueeze(0))[0]
            for i, j in ((mine, theirs), (mine, none.unsqueeze(1)), (none.unsqueeze(2), theirs))
        )
        # where both have to walk for a touch, who goes first need not stop
        stops = (both & (alone | (~other & (pairs.mine >= 0.5))) & (pairs.mine > 0)).any(2)
        stops = stops | wall.gather(0, chosen.unsqueeze(0))[0]
        chosen = torch.where(stops, min(turn + 1, kinds - 1), chosen)
    return torch.stack([step.new_full((), share) for share in SHARES])[chosen]


def _capped(steps: ProposedSteps, step: Tensor) -> Tensor:
    return torch.where(steps.moved.unsqueeze(-1), limit_speed(step, steps.longest), steps.step)
