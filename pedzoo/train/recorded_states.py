"""States that people were in when they were recorded, as a policy in the scenario `replay` sees them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.observation import observed
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.recorded_people import people_of
from pedzoo.sim.scenario import rules_of
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay
from pedzoo.sim.script import Script, ScriptScenes
from pedzoo.sim.state import TRACE_PER_STEP


class RecordedScenes(NamedTuple):
    """B scenes at one moment of a recording, and how their people went on."""

    batch: TensorDict  # the scene batch (B,)
    mine: Tensor  # which people a policy moves, of whom the steps before and after are known (B, A) bool
    velocity: Tensor  # recorded velocities (B, A, 2), m/s: in the last step ...
    following: Tensor  # ... and in the next one


class RecordedStates:
    """One recording, at any frame of which scenes can begin."""

    def __init__(self, tracks: Tracks, map_id: int, weight: float, planner: Planner) -> None:
        """Take tracks at 0.4 s in the frame of their floor plan, -1 for none, and how much they count."""
        tables = torch.tensor([map_id])
        people, xy = people_of([tracks], planner.bank.index(tables).tolist(), planner)
        self.name, self.weight = tracks.name, weight
        self._script, self._physics = Script.of_recordings(people, xy), Compiled(planner.bank)
        self._whole = PreparedReplay(
            scenario=Replay(), planner=planner, tables=tables, script=self._script, home=torch.zeros(1, 2)
        )
        frame = torch.arange(int(people.last.max()))
        moved = people.controlled.unsqueeze(1) & (people.handover.unsqueeze(1) <= frame)
        count = (moved & (people.last.unsqueeze(1) > frame)).sum(0)
        self.frames = frame[count > 0]
        """Frames in which somebody can be moved (F,) long."""
        self.states = int(count.sum())
        """States of people in them."""

    def excerpts(self, begin: Tensor, steps: int) -> PreparedReplay:
        """Return a replay of scenes that begin at frames (B,) long and last for so many steps."""
        number = torch.arange(len(begin))
        ends = begin + steps + 1, begin, begin + steps
        scenes = ScriptScenes(0 * number, begin, *ends, 0 * number - 1, number >= 0)
        script = Script(self._script.people, self._script.xy, self._script.occupants, scenes)
        return dataclasses.replace(self._whole, script=script)

    def scenes(self, begin: Tensor) -> RecordedScenes:
        """Return the scenes at frames ``begin`` (B,) long."""
        prepared = self.excerpts(begin, 1)
        script, people = prepared.script, prepared.persons
        rules = rules_of(prepared, TRACE_PER_STEP, substeps(prepared.fastest_agent))
        episodes = Episodes(prepared, "recorded", self._physics, rules)
        state = episodes.begin(Draws.for_episodes(0, torch.arange(len(begin))))
        person, now = state.person, begin.unsqueeze(1).expand_as(state.person)
        batch = observed(state, rules.guidance(state), prepared.bank)
        first = people.first[person].unsqueeze(2) + torch.arange(OBS_LEN)
        batch["agents", "first_history"] = script.places(person.unsqueeze(2).expand_as(first), first)
        mine = state.decides & (person >= 0) & (people.first[person] < now) & (people.last[person] > now)
        before, here, after = (script.places(person, now + more) for more in (-1, 0, 1))
        return RecordedScenes(batch, mine, (here - before) / STEP_SECONDS, (after - here) / STEP_SECONDS)
