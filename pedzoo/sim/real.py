"""A recorded crowd in the form of a rollout, so that it is measured like everything else."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.metrics.rollout import Rollout
from pedzoo.sim import kernel
from pedzoo.sim.arrival import arrived
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.script import Script
from pedzoo.sim.state import TRACE_PER_STEP, State
from pedzoo.sim.traces import rollout_of
from pedzoo.sim.worlds.base import People
from pedzoo.types import GOAL_RADIUS, TOP_SPEED_RATIO

_AT_ONCE = 64
"""Scenes: as many as are walked together."""


def real_parts(scenario: Scenario, scenes: int) -> Iterator[Rollout]:
    """Yield the first ``scenes`` of a prepared scenario with a script as everybody really walked in them.

    On the same slots and trace as any rollout of them. ``controlled`` are the people whom a policy would
    have, for as long as it would have them if it walked as they did: until they come within 0.3 m of their
    goal. From there on they have ``reached`` it, and are met by others until they really leave: who stands
    about at the exit does so where no policy has anybody. Who never comes so near, because the goal is not
    quite where they left, reaches it by leaving.
    """
    assert scenario.script is not None
    fine = substeps(scenario.fastest * TOP_SPEED_RATIO)
    physics = Compiled(scenario.bank)
    episodes = Episodes(scenario, "recorded", physics, kernel.rules_of(scenario, TRACE_PER_STEP, fine))
    for number in torch.arange(scenes).split(_AT_ONCE):
        start = episodes.begin(Draws.of(0, number))
        yield _walked(scenario, scenario.script, physics, start, fine)


def _walked(scenario: Scenario, script: Script, physics: Compiled, start: State, fine: int) -> Rollout:
    """Return what really happened in scenes that begin so, with ``fine`` sub-steps per trace point."""
    people, scene = script.people, start.scene
    origin = script.scenes.origin[scene]
    goal_point = people.goal.float()
    planned = (people.way.float() - GOAL_RADIUS).clamp_min(0)
    steps: list[dict[str, Tensor]] = []
    position, before, done = start.position, start.person, torch.zeros_like(start.mask)
    # nobody whom a policy would have is there any more in the frame `end`
    end = script.scenes.left[scene]
    for frame in range(int((end - origin).max())):
        now = origin + frame
        person = script.due(scene, now)
        at = now.unsqueeze(1).expand_as(person)
        there = (person >= 0) & (at < people.last[person]) & (now < end).unsqueeze(1)
        tick = torch.full_like(scene, frame * TRACE_PER_STEP)
        path = script.path(scene, person, tick, TRACE_PER_STEP, fine)
        path = torch.where(there[..., None, None, None], path, position[:, :, None, None])
        position = torch.where(there.unsqueeze(2), script.places(person, at), position)
        contacts = physics.contacts(path, People(position, there, start.map_id.unsqueeze(1), start.pose))
        position = path[:, :, -1, -1]
        had = script.scored(scene, person) & there & (at >= people.taken[person])
        done = done & (person == before)
        leaves = had & (at + 1 == people.last[person])
        reached = arrived(path, goal_point[person], had) | done.unsqueeze(2)
        reached[..., -1] |= leaves
        walks = had.unsqueeze(2) & ~torch.cat((done.unsqueeze(2), reached[..., :-1]), dim=2)
        before, done = person, reached[..., -1]
        step = {
            "trace": path[:, :, :, -1],
            "agent_contact": contacts.agent,
            "wall_contact": contacts.wall,
            "reached": reached.long(),
            "controlled": walks,
        }
        always = {
            "goal": goal_point[person],
            "present": there,
            "person": torch.where(there, person, -1),
            "planned": torch.where(had, planned[person], 0.0),
        }
        step |= {
            key: value.unsqueeze(2).expand(*value.shape[:2], TRACE_PER_STEP, *value.shape[2:])
            for key, value in always.items()
        }
        steps.append(step)
    return rollout_of(scenario, start, steps, torch.zeros_like(start.mask), torch.zeros_like(start.failed))
