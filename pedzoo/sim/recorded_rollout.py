"""A recorded crowd in the form of a rollout, so that it is measured like everything else."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from pedzoo.core.geometry import passes_goal
from pedzoo.core.randomness import Draws
from pedzoo.core.types import GOAL_RADIUS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim import kernel
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.replay.script import Script
from pedzoo.sim.rollout import Rollout, rollout_of
from pedzoo.sim.rules import Rules, rules_of
from pedzoo.sim.scenario import PreparedScenario, Scenario
from pedzoo.sim.state import TRACE_PER_STEP, State

_AT_ONCE = 64
"""Scenes: as many as are walked together."""


def real_parts(prepared: PreparedScenario, scenes: int) -> Iterator[Rollout]:
    """Yield the first ``scenes`` of a scenario with a script, as people really walked in them.

    Slots and trace are those of any rollout of them. ``controlled`` are the people that a policy would
    move, for as long as it would move them if it walked as they did: until they come within 0.3 m of their
    goal. From there on they have ``reached`` it. Others meet them until they really leave, so people may
    stand about at the exit where no policy controls an agent. Some never come so near, because the goal is
    not quite where they left: they reach it by leaving.
    """
    assert prepared.script is not None
    fine, physics = substeps(prepared.fastest_agent), Compiled(prepared.bank)
    planned = rules_of(prepared, TRACE_PER_STEP, fine)
    episodes = Episodes(prepared, "recorded", physics, planned)
    rules = Rules(_still, TRACE_PER_STEP, fine, script=prepared.script.as_recorded())
    for number in torch.arange(scenes).split(_AT_ONCE):
        start = episodes.begin(Draws.for_episodes(0, number))
        yield _walked(prepared.scenario, prepared.script, physics, rules, start)


def _still(state: State) -> Guidance:
    """Return goals where people are, so that all stand."""
    position = state.position
    still, remaining_path = torch.zeros_like(position), torch.zeros_like(state.remaining_path)
    return Guidance(position, still, position, state.goal_point, remaining_path)


def _walked(scenario: Scenario, script: Script, physics: Physics, rules: Rules, start: State) -> Rollout:
    """Return the recorded continuation of scenes that begin so."""
    assert rules.script is not None
    people, scene = script.people, start.scene
    goal_point = people.goal.float()
    planned = (people.path_length.float() - GOAL_RADIUS).clamp_min(0)
    origin = script.scenes.origin[scene]
    scheduled = rules.script.people_in_slots(scene, origin)
    state = start._replace(
        person=scheduled,
        mask=scheduled >= 0,
        controlled=torch.zeros_like(start.mask),
        goal_id=torch.full_like(scheduled, -1),
    )
    still = torch.zeros_like(state.position)
    steps: list[dict[str, Tensor]] = []
    before, done = start.person, torch.zeros_like(start.mask)
    for frame in range(int((script.scenes.last_exit[scene] - origin).max())):
        person, there = state.person, state.mask
        at = (origin + frame).unsqueeze(1).expand_as(person)
        begin = script.places(person, at)
        state, _, events = kernel.step(state, still, physics, rules)
        had = script.scored(scene, person) & there & (at >= people.handover[person])
        done = done & (person == before)
        leaves = had & (at + 1 == people.last[person])
        reached = _arrived(begin, events.trace, goal_point[person], had) | done.unsqueeze(2)
        reached[..., -1] |= leaves
        walks = had.unsqueeze(2) & ~torch.cat((done.unsqueeze(2), reached[..., :-1]), dim=2)
        before, done = person, reached[..., -1]
        step = {
            "trace": events.trace,
            "agent_contact": events.agent_contact,
            "wall_contact": events.wall_contact,
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


def _arrived(begin: Tensor, trace: Tensor, goal: Tensor, wanted: Tensor) -> Tensor:
    """Return which agents have come within 0.3 m of the goal until each trace point (B, A, S) bool."""
    points = torch.cat((begin.unsqueeze(2), trace), dim=2)
    near = passes_goal(points[:, :, :-1], points[:, :, 1:], goal.unsqueeze(2))
    return (near & wanted.unsqueeze(2)).cummax(2).values
