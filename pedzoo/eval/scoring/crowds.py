"""The crowds of a score: recorded people, a policy in their place, or people of a simulator's file.

All become the same: what each person did every 0.4 s, as it is and over coarse positions. P people.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.eval.rollout import Progress, prepare, walk
from pedzoo.metrics.realism.clips import Clips, clips
from pedzoo.metrics.realism.crowdes import ScoredSteps
from pedzoo.metrics.realism.crowds import CrowdSums, crowd, together
from pedzoo.metrics.realism.features import SampledRollout, coarse, every_step, to_millimetres
from pedzoo.metrics.realism.groups import PersonSums, added, main_axis, measured
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise
from pedzoo.sim.replay.people import RecordedPeople
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay

BLOCKS, BLOCK_SECONDS = 20, 30.0
"""Intervals come from at most so many blocks of time, of at least so many seconds."""


class CrowdView(NamedTuple):
    """A crowd as it is, or over coarse positions.

    Attributes:
        crowd: Samples of features, and contacts.
        clips: For the classifier.
    """

    crowd: CrowdSums
    clips: Clips


class ScoredCrowd(NamedTuple):
    """One crowd.

    Attributes:
        name: Its row.
        fine: As it is.
        coarse: Over coarse positions.
        sums: Of `pedzoo.metrics.realism.groups`.
        walks: Their scored steps; frames count from the recording's first row, recordings one after another.
        people: Its people.
        twin: The recorded person that each of them is (P,) long, -1 for strangers.
        rounds: How often they walked.
    """

    name: str
    fine: CrowdView
    coarse: CrowdView
    sums: dict[str, PersonSums]
    walks: ScoredSteps
    people: RecordedPeople
    twin: Tensor
    rounds: int = 1

    @property
    def seen(self) -> Tensor:
        """Which people were scored (P,) bool."""
        return self.fine.crowd.minutes > 0


def scored_crowd(
    name: str,
    parts: Iterable[Rollout],
    scenario: PreparedReplay,
    start: Tensor,
    goal: Tensor,
    twin: Tensor | None = None,
    rounds: int = 1,
) -> ScoredCrowd:
    """Return a crowd, given as rollouts of scenes 0, 1, ... one after the other.

    Args:
        name: Its row.
        parts: Only one of them has to be in memory at a time.
        scenario: Where they walked.
        start: Where the lines of people begin (P, 2), metres.
        goal: Their exits (P, 2), metres.
        twin: The recorded people that they are; None for the recorded people themselves.
        rounds: How often the scenes are walked.
    """
    people, first = scenario.persons, 0
    views: tuple[list[tuple[CrowdSums, Clips]], ...] = ([], [])
    sums, rows, axis = [], [], main_axis(start, goal)
    for part in parts:
        steps = every_step(part)
        for view, seen in zip(views, (to_millimetres(steps), coarse(to_millimetres(steps))), strict=True):
            walked = crowd(part, seen, first, scenario.scenes, start, goal)
            view.append((walked, clips(seen, start, goal)))
        sums.append(measured(steps, len(start), axis))
        rows.append(_scored_rows(steps, first, scenario))
        first += len(part.failed)
    fine, rough = map(_joined, views)
    twin = torch.arange(len(start)) if twin is None else twin
    walks = ScoredSteps(*(torch.cat(values) for values in zip(*rows, strict=True)))
    return ScoredCrowd(name, fine, rough, added(sums), walks, people, twin, rounds)


def recorded_crowd(scenario: PreparedReplay) -> ScoredCrowd:
    """Return the recorded crowd."""
    people = scenario.persons
    return scored_crowd("real", scenario.real_parts(), scenario, people.start, people.goal)


def policy_crowd(
    policy: str,
    scenario: PreparedReplay,
    rounds: int,
    seed: int,
    physics: str,
    progress: Progress | None = None,
) -> ScoredCrowd:
    """Return what a policy makes of the recorded people: in ``rounds`` if it has noise, else once.

    Raises:
        UserError: Unknown policy or setting.
    """
    rounds = rounds if has_noise(load_policy(policy)) else 1
    episodes, people = rounds * scenario.scenes, scenario.persons
    walks, env = prepare(policy, scenario, physics, episodes, seed)
    try:
        parts = walk(walks, env, episodes, progress=progress)
        return scored_crowd(policy, parts, scenario, people.start, people.goal, rounds=rounds)
    finally:
        env.physics.close()


def blocks_of(people: RecordedPeople) -> tuple[Tensor, int]:
    """Return the block of time in which each person is taken over (P,) long, and how many blocks there are.

    A block lies within one recording.
    """
    block, before = torch.zeros_like(people.handover), 0
    for number in people.recording.unique().tolist():
        mine = people.recording == number
        taken = people.handover[mine] - people.handover[mine].min()
        frames = max(int(taken.max()) + 1, 1)
        length = max(frames / BLOCKS, BLOCK_SECONDS / STEP_SECONDS)
        block[mine] = before + (taken / length).long()
        before = int(block[mine].max()) + 1
    return block, before


def _scored_rows(steps: SampledRollout, first: int, scenario: PreparedReplay) -> ScoredSteps:
    """Return the scored steps of episodes ``first``, ... of a replay."""
    assert scenario.script is not None
    scenes, people = scenario.script.scenes, scenario.persons
    episode, slot, step = steps.scored.nonzero().unbind(1)
    scene = (episode + first) % scenario.scenes
    # people of two recordings are never there together
    apart = (int(people.removal.max()) + 1) * scenes.table[scene]
    frame = scenes.origin[scene] + step - 1 + apart
    person = steps.person[episode, slot, step]
    return ScoredSteps((episode + first) // scenario.scenes, person, frame, steps.xy[episode, slot, step])


def _joined(parts: list[tuple[CrowdSums, Clips]]) -> CrowdView:
    crowds, pieces = zip(*parts, strict=True)
    return CrowdView(together(crowds), Clips(*(torch.cat(values) for values in zip(*pieces, strict=True))))
