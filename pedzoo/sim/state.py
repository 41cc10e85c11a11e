"""All that an environment knows about its scenes between two steps."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.types import OBS_LEN, STEP_SECONDS, TRACE_SECONDS

TRACE_PER_STEP = round(STEP_SECONDS / TRACE_SECONDS)
"""Trace points in one step of the networks' clock."""

PAST_LEN = (OBS_LEN - 1) * TRACE_PER_STEP + 1
"""Trace points that 8 observed steps span."""


TURNS_FROM = 0.05
"""m/s: the body faces where it moves if it is faster; else it keeps its heading."""


class State(NamedTuple):
    """B scenes of A people. Never written in place: what a rollout was given stays as it was.

    Attributes:
        key: Key of each scene's draws (B,) long.
        map_id: Floor plan (B,) long, -1 for none.
        pose: Scene poses (B, 4).
        scene: Which scene of the scenario's script is played (B,) long; 0 where there is none.
        clock: Time since the warm start (B,), seconds.
        failed: A policy gave no number (B,) bool.
        mask: Who is there (B, A) bool.
        controlled: Whom the policy moves (B, A) bool; others who are there are played back.
        person: Who is in each slot (B, A) long, -1 where nobody is: noise is drawn by it.
        known: For how many of the latest trace points, up to 29, somebody was seen (B, A) long.
        past: Everybody's latest positions every 0.1 s (B, A, 29, 2), oldest first.
        velocity: Over the last 0.1 s (B, A, 2), m/s.
        heading: Direction in which the body faces (B, A), radians from the x axis.
        radius: Radius of the body (B, A), metres.
        kind: `pedzoo.batch.PERSON` or `ROBOT` (B, A) long.
        pref_speed: The speed that people like (B, A), m/s.
        goal_id: The planner's number of everybody's goal (B, A) long, -1 for none.
        goal_point: Where it is (B, A, 2), metres.
        drawn: Goals that were drawn after the first (B, A) long.
        reached: Goals reached since the warm start (B, A) long.
        deadline: When the goal has to be reached (B, A), seconds on the clock.
        late: A goal was not reached in time (B, A) bool.
        way: Length of the way to the goal (B, A), metres.
        planned: Ways of all goals up to this one, as long as they were when the goal was set and without what
            a goal's radius saves (B, A), metres.
        stands: Until when somebody stands where they began (B, A), seconds on the clock; 0 for who does not.
    """

    key: Tensor
    map_id: Tensor
    pose: Tensor
    scene: Tensor
    clock: Tensor
    failed: Tensor
    mask: Tensor
    controlled: Tensor
    person: Tensor
    known: Tensor
    past: Tensor
    velocity: Tensor
    heading: Tensor
    radius: Tensor
    kind: Tensor
    pref_speed: Tensor
    goal_id: Tensor
    goal_point: Tensor
    drawn: Tensor
    reached: Tensor
    deadline: Tensor
    late: Tensor
    way: Tensor
    planned: Tensor
    stands: Tensor

    @property
    def position(self) -> Tensor:
        """Where people are (B, A, 2), metres."""
        return self.past[:, :, -1]

    @property
    def history(self) -> Tensor:
        """Where they were every 0.4 s (B, A, 8, 2)."""
        return self.past[:, :, ::TRACE_PER_STEP]

    @property
    def valid(self) -> Tensor:
        """Which of these are known (B, A, 8) bool; unknown ones are the first known one."""
        age = torch.arange(PAST_LEN - 1, -1, -TRACE_PER_STEP, device=self.known.device)
        return self.known.unsqueeze(2) > age

    def rows(self, index: Tensor) -> State:
        """Return some of the scenes."""
        return State(*(value[index] for value in self))

    def with_rows(self, index: Tensor, other: State) -> State:
        """Return a state in which the scenes at ``index`` are those of ``other``."""
        if len(index) == len(self.key):
            return other.rows(index.argsort())
        pairs = zip(self, other, strict=True)
        return State(*(mine.index_copy(0, index, theirs) for mine, theirs in pairs))
