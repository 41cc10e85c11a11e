"""The crowds of a score: recorded people, a policy in their place, or the people of a file; P people."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.data.recordings import OwnFiles
from pedzoo.data.tracks import WALKED, Tracks, brisk, check_walks, distance, rows_apart, say
from pedzoo.metrics.realism.crowds import CrowdSums, added, crowd, main_axis, measured, together
from pedzoo.metrics.realism.features import (
    Clips,
    clips,
    coarse,
    every_step,
    surroundings,
    to_millimetres,
)
from pedzoo.metrics.realism.walks import ScoredSteps
from pedzoo.sim.recorded_people import CONTROLLED, SHORT, RecordedPeople, without_goals
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay

ALIKE = 0.6
"""Where no clock is stated, fast steps of the slower crowd are at least so many of those of the other one."""


class NothingToScoreError(UserError):
    """A file of people without steps that could be scored: its row is empty, and others keep theirs."""


class CrowdView(NamedTuple):
    """A crowd as it is, or over coarse positions: samples and contacts, and clips for the classifier."""

    crowd: CrowdSums
    clips: Clips


class ScoredCrowd(NamedTuple):
    """One crowd, as it is and over coarse positions.

    Attributes:
        name: Its row.
        fine: As it is.
        coarse: Over coarse positions.
        sums: Of `pedzoo.metrics.realism.crowds.measured`.
        walks: Their scored steps; frames count from the recording's first row, recordings one after another.
        people: Its people.
        twin: The recorded person that each of them is (P,) long, -1 for strangers.
        rounds: How often they walked.
    """

    name: str
    fine: CrowdView
    coarse: CrowdView
    sums: dict[str, Tensor]
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
    goal: Tensor | None = None,
    twin: Tensor | None = None,
    rounds: int = 1,
) -> ScoredCrowd:
    """Return a crowd, given as rollouts of scenes 0, 1, ... one after the other, ``rounds`` times.

    Only one part at a time has to be in memory. Without ``goal`` (P, 2), metres, people have the exits of the
    scenario; without ``twin`` (P,) they are the recorded people themselves.
    """
    assert scenario.script is not None
    people, scenes, first, cat = scenario.persons, scenario.script.scenes, 0, torch.cat
    apart = int(people.removal.max()) + 1  # people of two recordings are never there together
    start, goal = people.start, people.goal if goal is None else goal
    views: tuple[list[tuple[CrowdSums, Clips]], ...] = ([], [])
    sums, rows, axis = [], [], main_axis(start, goal)
    for part in parts:
        steps = every_step(part)
        for view, seen in zip(views, (to_millimetres(steps), coarse(to_millimetres(steps))), strict=True):
            around = surroundings(seen)
            sides = crowd(part, seen, around, first, scenario.scenes, start, goal)
            view.append((sides, clips(seen, around, start, goal)))
        sums.append(measured(steps, len(start), axis))
        episode, _, step = steps.scored.nonzero().unbind(1)
        number, scene = (episode + first) // scenario.scenes, (episode + first) % scenario.scenes
        frame = scenes.origin[scene] + step - 1 + apart * scenes.table[scene]
        rows.append((number, steps.person[steps.scored], frame, steps.xy[steps.scored]))
        first += len(part.failed)
    both = (zip(*view, strict=True) for view in views)
    fine, rough = (
        CrowdView(together(sides), Clips(*map(cat, zip(*some, strict=True)))) for sides, some in both
    )
    twin = torch.arange(len(start)) if twin is None else twin
    walks = ScoredSteps(*map(cat, zip(*rows, strict=True)))
    return ScoredCrowd(name, fine, rough, added(sums), walks, people, twin, rounds)


def recorded_crowd(scenario: PreparedReplay) -> ScoredCrowd:
    """Return the recorded crowd."""
    return scored_crowd("real", scenario.real_parts(), scenario)


def file_crowd(path: str, real: PreparedReplay, dt: float | None = None) -> ScoredCrowd:
    """Return the people of a simulator's file.

    The first 8 rows (3.2 s) of each person are not scored, as in the recording. People whom `twins` finds in
    the recording have its roles and exits. All others are scored from there to their last row, where their
    exit is taken to be: also people who only stand.

    Args:
        path: The file, in any form that `pedzoo.data.tracks` reads.
        real: The recording.
        dt: Seconds between consecutive frame numbers; None for what the file says, or rows 0.4 s apart.

    Raises:
        UserError: The file is refused.
        NothingToScoreError: No person in it can be scored.
    """
    if np.isnan(rows_apart(Tracks.read(path))):
        raise NothingToScoreError(f"{path}: no agent has two rows, expected walks")
    source = OwnFiles([path], _assumed(path, real) if dt is None else dt, "0,0,1", option="--dt")
    tracks = source.recordings("test")[0].tracks
    people, xy = without_goals([tracks])
    recorded, scenario = real.persons, cast(Replay, real.scenario)
    assert real.script is not None
    there = _begin(recorded, real.script.xy) + real.home[recorded.recording]
    twin, recording = twins(people, _begin(people, xy), recorded, there)
    people, xy = without_goals([replace(tracks, xy=tracks.xy - real.home[recording].numpy())])
    known, short = twin >= 0, people.last - people.first < OBS_LEN
    role = torch.where(known, recorded.what[twin], CONTROLLED)
    role = torch.where(short & (role == CONTROLLED), SHORT, role)
    if not (role == CONTROLLED).any():
        raise NothingToScoreError(
            f"{path}: expected walks of more than {OBS_LEN} rows 0.4 s apart: is --dt right?"
        )
    goal = torch.where(known.unsqueeze(1), recorded.goal[twin], people.exit)
    never = torch.where(known.unsqueeze(1), goal, torch.inf)  # strangers have arrived when they leave
    people, place = people._replace(what=role, goal=never), slice(recording, recording + 1)
    name = Path(path).name
    made = scenario.with_slots(real.planner, real.tables[place], real.home[place], people, xy, name)
    return scored_crowd(name, made.real_parts(), made, goal, twin)


def twins(
    people: RecordedPeople, begin: Tensor, recorded: RecordedPeople, there: Tensor
) -> tuple[Tensor, int]:
    """Return who each person of a file is in the recording (P,) long, -1 for strangers, and in which one.

    The same people have the same numbers, come at the same time (but for one offset of the clock that all of
    them share) and begin within 0.5 m of the same place. The recording is the one that has most of them.
    ``begin`` (P, 2) and ``there`` (Q, 2) are the first places of the file's and the recorded people, metres.
    """
    best = torch.full_like(people.agent, -1), 0
    for number in recorded.recording.unique().tolist():
        mine = (recorded.recording == number).nonzero()[:, 0]
        agents = recorded.agent[mine]
        order = agents.argsort()
        place = torch.searchsorted(agents[order], people.agent).clamp_max(len(mine) - 1)
        twin = mine[order[place]]
        same = (recorded.agent[twin] == people.agent) & ((begin - there[twin]).norm(dim=1) <= 0.5)
        offset = people.first - recorded.first[twin]
        if same.any():
            same &= offset == offset[same].mode().values
        if int(same.sum()) > int((best[0] >= 0).sum()):
            best = torch.where(same, twin, -1), number
    return best


def _begin(people: RecordedPeople, xy: Tensor) -> Tensor:
    """Return where each person is first (P, 2), given all rows of their tracks (N, 2)."""
    rows = people.last - people.first + 1
    return xy[rows.cumsum(0) - rows]


def _assumed(path: str, real: PreparedReplay) -> float | None:
    """Return the seconds between frame numbers for rows 0.4 s apart; None where the file says its own."""
    tracks = Tracks.read(path)
    if tracks.source.seconds is not None:
        return None
    seconds = STEP_SECONDS / rows_apart(tracks)
    check_walks(tracks, seconds, "--dt")
    assert real.script is not None
    rows = (real.persons.last - real.persons.first + 1).numpy()
    person = np.repeat(np.arange(len(rows)), rows)
    recorded = Tracks("", np.arange(len(person)), person, real.script.xy.numpy())
    mine, theirs = brisk(tracks, seconds), brisk(recorded, STEP_SECONDS)
    if theirs and distance(tracks) > WALKED and not ALIKE < mine / theirs < 1 / ALIKE:
        raise UserError(
            f"{path}: with rows 0.4 s apart people walk at {mine:.2g} m/s, the recorded ones at "
            f"{theirs:.2g}: give --dt, the seconds between frame numbers; "
            f"{seconds * mine / theirs:.2g} is likely"
        )
    say(f"{path} does not say its frame rate: its rows are taken to be 0.4 s apart (--dt)")
    return seconds


def blocks_of(people: RecordedPeople) -> tuple[Tensor, int]:
    """Return the block of time in which each person is taken over (P,) long, and how many blocks there are.

    Each recording has at most 20 blocks of at least 30 s.
    """
    block, before = torch.zeros_like(people.handover), 0
    for number in people.recording.unique().tolist():
        mine = people.recording == number
        taken = people.handover[mine] - people.handover[mine].min()
        frames = max(int(taken.max()) + 1, 1)
        length = max(frames / 20, 30.0 / STEP_SECONDS)
        block[mine] = before + (taken / length).long()
        before = int(block[mine].max()) + 1
    return block, before
