"""When people come and go: they are played back from a recording, and taken over by the policy."""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import cached_property
from heapq import heappop, heappush
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.sim.recorded_people import SHORT, RecordedPeople, top_speed_of
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP, State

Simulated = Literal["all", "one", "around"]

_NOTHING_YET = ("goal_index", "stands", "reached", "remaining_path", "planned")
"""Fields of a state that are 0 for people who come."""


class ScriptScenes(NamedTuple):
    """The R scenes of a script. Frames are those of recordings, 0.4 s.

    Attributes:
        table: Which row of the script's table each has (R,) long.
        origin: Frame at which its clock is 0 (R,) long.
        until: Frame from which on none of its people are there (R,) long.
        last: Frame in which the policy takes a person over for the last time (R,) long.
        last_exit: Frame in which the last of them really leaves (R,) long.
        lead: The person that it takes over first (R,) long, -1 for none.
        others: Whether it takes over all others that it can, too (R,) bool.
    """

    table: Tensor
    origin: Tensor
    until: Tensor
    last: Tensor
    last_exit: Tensor
    lead: Tensor
    others: Tensor

    @classmethod
    def of_excerpts(cls, table: Tensor, begin: Tensor, steps: int) -> ScriptScenes:
        """Return scenes that begin at frames (R,) long, last for so many steps, and have no lead."""
        no_lead, all_others = torch.full_like(begin, -1), torch.ones_like(begin, dtype=torch.bool)
        return cls(table, begin, begin + steps + 1, begin, begin + steps, no_lead, all_others)


class Script:
    """Moves people as they were recorded, and says which are there.

    People are played back first. The policy takes over in the frame that `RecordedPeople` says, and moves
    them until they arrive or their time is up. Their slot is theirs until then, so which person is in which
    slot depends on the script alone. Everything happens in step with the frames of 0.4 s, except that
    people leave with the decision in which they arrive.
    """

    def __init__(self, people: RecordedPeople, xy: Tensor, occupants: Tensor, scenes: ScriptScenes) -> None:
        """Take people with the rows of their tracks (N, 2), person after person, one for each frame.

        ``occupants`` is the person in each slot in each frame (tables, A, frames) long, -1 for none.
        """
        self.people, self.xy, self.occupants, self.scenes = people, xy, occupants, scenes
        rows = people.last - people.first + 1
        self._begin = torch.cumsum(rows, 0) - rows
        self.goals, self._pause = people.goals, torch.nn.functional.pad(people.pauses, (0, 1))

    def to(self, device: torch.device | str) -> Script:
        """Return the script on a device: itself where it is there already."""
        if self.xy.device == torch.device(device):
            return self
        scenes = ScriptScenes(*(value.to(device) for value in self.scenes))
        return type(self)(self.people.to(device), self.xy.to(device), self.occupants.to(device), scenes)

    @classmethod
    def of_recordings(cls, people: RecordedPeople, xy: Tensor, simulated: Simulated = "all") -> Script:
        """Return the script of whole recordings, cut where no person is left that can be simulated.

        With ``one`` each person has a scene of their own, those who stay shortest first; with ``around`` the
        policy takes over others there, too.
        """
        removal, pieces = people.removal, []
        if simulated == "all":
            apart = people.recording * (int(removal.max()) + 1)  # people of two recordings never meet
            order = (people.first + apart).argsort(stable=True)
            gone = (removal + apart)[order].cummax(0).values
            cuts = ((people.first + apart)[order][1:] >= gone[:-1]).nonzero()[:, 0] + 1
            pieces = [
                (people.first[group].min() + OBS_LEN - 1, group, -1) for group in order.tensor_split(cuts)
            ]
        else:
            leads = people.controlled.nonzero()[:, 0]
            leads = leads[(people.last - people.first)[leads].argsort(stable=True)]
            pieces = [(people.handover[lead], lead.view(1), int(lead)) for lead in leads]
        scenes = []
        for origin, group, lead in pieces:
            if len(scored := group[people.controlled[group]]):
                ends = removal[group], people.handover[scored], people.last[scored]
                scenes.append((people.recording[group[0]], origin, *(end.max() for end in ends), lead))
        columns = torch.tensor(scenes).unbind(1)
        others = torch.full_like(columns[0], simulated != "one") > 0
        ends = people.last if simulated == "one" else removal
        occupants = occupants_of(people.recording, people.first, ends, more=int(simulated != "all"))
        return cls(people, xy, occupants, ScriptScenes(*columns, others=others))

    @classmethod
    def of_windows(cls, here: Tensor, future: Tensor, there: Tensor, group: Tensor) -> Script:
        """Return the script of B recorded windows whose A people are in their slots from the beginning.

        Nobody comes or is taken over later. Person a of scene b is number b * A + a.

        Args:
            here: Where people are at the beginning (B, A, 2), metres.
            future: Where they are at the end of each of T steps (B, A, T, 2), metres.
            there: Which people are present from begin to end of each step (B, A, T) bool.
            group: Numbers of their companies (B, A) long, -1 for alone.
        """
        scenes, agents, steps = there.shape
        number = torch.arange(scenes * agents, device=there.device)
        zeros, place = torch.zeros_like(number), here.flatten(0, 1)
        people = RecordedPeople(
            recording=number // agents,
            agent=number % agents,
            first=zeros,
            last=torch.full_like(number, steps),
            what=torch.full_like(number, SHORT),
            **dict.fromkeys(("start", "exit", "goal"), place),
            **dict.fromkeys(("path_length", "pref_speed"), place[:, 0] * 0),
            goal_id=zeros,
            group=group.flatten(),
            grouped=zeros,
            stops=zeros[:, None][:, :0],
            pauses=place[:, :0],
        )
        xy = torch.cat((here.unsqueeze(2), future), 2).reshape(-1, 2)
        occupants = torch.where(there, number.view(scenes, agents, 1), -1)
        row = torch.arange(scenes, device=there.device)
        none, end = torch.full_like(row, -1), torch.full_like(row, steps + 1)
        return cls(people, xy, occupants, ScriptScenes(row, zeros[:scenes], end, end, end, none, none > 0))

    def as_recorded(self) -> Script:
        """Return the script in which no policy takes an agent over: people come and go as they really did."""
        people = self.people._replace(what=torch.full_like(self.people.what, SHORT))
        return Script(people, self.xy, self.occupants, self.scenes._replace(until=self.scenes.last_exit))

    @cached_property
    def fastest(self) -> float:
        """The largest preferred speed, m/s, or a faster one that was recorded: it decides about sub-steps."""
        people = self.people
        person = torch.arange(len(people.first), device=self.xy.device)
        person = person.repeat_interleave(people.last - people.first + 1)
        recorded = (self.xy[1:] - self.xy[:-1])[person[1:] == person[:-1]].norm(dim=1)
        fastest = max(float(recorded.max()) / STEP_SECONDS, 0.0) if len(recorded) else 0.0
        return max(fastest, float(top_speed_of(people.pref_speed).max())) / TOP_SPEED_RATIO

    def people_in_slots(self, scene: Tensor, frame: Tensor) -> Tensor:
        """Return the person in each slot (B, A) long at a recording's frame (B,); -1 for none."""
        table, until, lead = (
            values[scene] for values in (self.scenes.table, self.scenes.until, self.scenes.lead)
        )
        scheduled = self.occupants[table, :, frame.clamp_max(self.occupants.shape[2] - 1)]
        # the last slot is kept for the lead, which is not met a second time
        leads = (lead >= 0) & (frame < self.people.removal[lead])
        scheduled = torch.where(scheduled == lead.unsqueeze(1), -1, scheduled)
        scheduled[:, -1] = torch.where(leads, lead, scheduled[:, -1])
        there = (frame < until).unsqueeze(1) & (frame.unsqueeze(1) < self.people.removal[scheduled])
        return torch.where(there, scheduled, -1)

    def places(self, person: Tensor, frame: Tensor) -> Tensor:
        """Return where people (..., ) are at frames (..., ), in their first or last place before or after."""
        first, last = self.people.first[person], self.people.last[person]
        return self.xy[self._begin[person] + frame.clamp(first, last) - first]

    def opening(self, scene: Tensor) -> dict[str, Tensor]:
        """Return how scenes (B,) begin, as fields of a `pedzoo.sim.scenario.Layout`."""
        frame = self.scenes.origin[scene]
        person = self.people_in_slots(scene, frame)
        there, at = person >= 0, frame.unsqueeze(1).expand_as(person)
        frames = at.unsqueeze(2) + torch.arange(1 - OBS_LEN, 1, device=at.device)
        history = self.places(person.unsqueeze(2).expand_as(frames), frames)
        seen = (at - self.people.first[person]).clamp_max(OBS_LEN - 1)
        # people who enter now are walking already
        came = (seen < 1).unsqueeze(2)
        last = torch.where(came, history[:, :, -1], history[:, :, -2])
        following = torch.where(came, self.places(person, at + 1), history[:, :, -1])
        return {
            "scene": scene,
            "person": person,
            "mask": there,
            "controlled": self.scored(scene, person) & (self.people.handover[person] <= at),
            "observed_points": torch.where(there, seen * TRACE_PER_STEP + 1, PAST_LEN),
            "group": self._group(person, at),
            "velocity": (following - last) / STEP_SECONDS,
            "deadline": self._deadline(scene, person),
            "goal": torch.where(there, self.goals[person, 0], -1),
            "later": self.goals[person, 1:],
            "history": torch.where(there[..., None, None], history, 0.0),
        }

    def scored(self, scene: Tensor, person: Tensor) -> Tensor:
        """Return which people the policy has at some time (B, A) bool."""
        lead, others = self.scenes.lead[scene].unsqueeze(1), self.scenes.others[scene].unsqueeze(1)
        return self.people.controlled[person] & (person >= 0) & (others | (person == lead))

    def _group(self, person: Tensor, frame: Tensor) -> Tensor:
        """Return the companies of people (B, A) long as far as frames until this one show them."""
        shown = (person >= 0) & (self.people.grouped[person] <= frame)
        return torch.where(shown, self.people.group[person], -1)

    def _deadline(self, scene: Tensor, person: Tensor) -> Tensor:
        steps = self.people.removal[person] - self.scenes.origin[scene].unsqueeze(1)
        return (steps * TRACE_PER_STEP) * TRACE_SECONDS

    def pauses(self, state: State) -> Tensor:
        """Return how long people wait where their present goal is (B, A), seconds; 0 at exits."""
        pause = self._pause[state.person, state.goal_index.clamp_max(self._pause.shape[1] - 1)]
        return torch.where(state.person >= 0, pause, 0.0)

    def playback(self, state: State, failed: Tensor, points: int, substeps: int) -> Tensor:
        """Return the recorded ways (B, A, S, M, 2) of people: straight from frame to frame.

        In scenes that ``failed`` (B,) they stay; ways of nobody mean nothing. The S ``points`` do not go
        beyond the end of a frame; each has M ``substeps``.
        """
        person = state.person
        at = self.scenes.origin[state.scene] * TRACE_PER_STEP + _tick(state.clock)
        frame, part = (at // TRACE_PER_STEP).unsqueeze(1).expand_as(person), at % TRACE_PER_STEP
        here, there = self.places(person, frame), self.places(person, frame + 1)
        share = part.unsqueeze(1) + torch.arange(1, points * substeps + 1, device=at.device) / substeps
        share = (share / TRACE_PER_STEP)[:, None, :, None]
        recorded = torch.lerp(here.unsqueeze(2), there.unsqueeze(2), share).unflatten(2, (points, substeps))
        return torch.where(failed.view(-1, 1, 1, 1, 1), state.position[:, :, None, None], recorded)

    def update_presence(self, before: State, after: State, points: int) -> tuple[State, Tensor]:
        """Let people come, go and be taken over at the end of a decision of S ``points``.

        Returns:
            The state ``after`` with them, and which people were taken over just now (B, A) bool.
        """
        tick = _tick(before.clock) + points
        at = self.scenes.origin[after.scene] * TRACE_PER_STEP + tick
        frame, sharp = at // TRACE_PER_STEP, (at % TRACE_PER_STEP == 0).unsqueeze(1)
        observed_points = (after.observed_points + points).clamp_max(PAST_LEN)
        after = after._replace(clock=tick * TRACE_SECONDS, observed_points=observed_points)
        scheduled = self.people_in_slots(after.scene, frame)
        now = frame.unsqueeze(1).expand_as(scheduled)
        there = scheduled >= 0
        comes = there & sharp & (self.people.first[scheduled] == now)
        stays = after.mask & (after.person == scheduled)
        mask = comes | stays
        overdue = after.overdue | (after.mask & after.controlled & ~stays)
        taken = stays & sharp & self.scored(after.scene, scheduled) & (self.people.handover[scheduled] == now)
        here = self.places(scheduled, now)
        velocity = (self.places(scheduled, now + 1) - here) / STEP_SECONDS
        come, person = comes.unsqueeze(2), torch.where(mask, scheduled, -1)
        pref_speed = self.people.pref_speed[scheduled]
        return after._replace(
            mask=torch.where(sharp, mask, after.mask),
            controlled=torch.where(sharp, (after.controlled & stays) | taken, after.controlled),
            person=torch.where(sharp, person, after.person),
            group=torch.where(sharp, self._group(person, now), after.group),
            observed_points=observed_points.masked_fill(comes, 1),
            past=torch.where(come.unsqueeze(3), here.unsqueeze(2), after.past),
            velocity=torch.where(come, velocity, after.velocity),
            pref_speed=torch.where(comes, pref_speed, after.pref_speed),
            top_speed=torch.where(comes, top_speed_of(pref_speed), after.top_speed),
            goal_id=torch.where(comes, self.goals[scheduled, 0], after.goal_id),
            later_goals=torch.where(come, self.goals[scheduled, 1:], after.later_goals),
            deadline=torch.where(comes, self._deadline(after.scene, scheduled), after.deadline),
            overdue=torch.where(sharp, overdue & ~comes, after.overdue),
            **{name: getattr(after, name).masked_fill(comes, 0) for name in _NOTHING_YET},
        ), taken

    def ended(self, state: State) -> Tensor:
        """Return the scenes without controlled people, now or later (B,) bool."""
        frame = self.scenes.origin[state.scene] + _tick(state.clock) // TRACE_PER_STEP
        return ~state.controlled.any(1) & (frame >= self.scenes.last[state.scene])


def _tick(clock: Tensor) -> Tensor:
    """Return how many trace points lie before the times (B,), seconds, long."""
    return (clock / TRACE_SECONDS).round().long()


def occupants_of(group: Tensor, begin: Tensor, end: Tensor, more: int = 0) -> Tensor:
    """Return the person in each of A slots in each frame of G groups (G, A, frames) long, -1 for none.

    People (P,) of a ``group`` long are there from ``begin`` to before ``end`` long. Each gets the free slot
    with the smallest number, so that there are as few as possible; A is ``more`` than that.
    """
    free, leaving = defaultdict[int, list[int]](list), defaultdict[int, list[tuple[int, int]]](list)
    used, stays = Counter[int](), []
    for person in begin.argsort(stable=True).tolist():
        where, comes, goes = (int(values[person]) for values in (group, begin, end))
        if goes <= comes:
            continue
        while leaving[where] and leaving[where][0][0] <= comes:
            heappush(free[where], heappop(leaving[where])[1])
        if not free[where]:
            free[where].append(used[where])
            used[where] += 1
        slot = heappop(free[where])
        heappush(leaving[where], (goes, slot))
        stays.append((person, where, slot, slice(comes, goes)))
    result = torch.full((int(group.max()) + 1, max(used.values()) + more, int(end.max()) + 1), -1)
    for person, *place in stays:
        result[tuple(place)] = person
    return result
