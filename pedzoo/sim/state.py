"""All that a simulation knows about its scenes between two steps."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.sim.step_result import CLOCK_ROUNDING

TRACE_PER_STEP = round(STEP_SECONDS / TRACE_SECONDS)
"""Trace points in one step of the networks' clock."""

PAST_LEN = (OBS_LEN - 1) * TRACE_PER_STEP + 1
"""Trace points that 8 observed steps span."""


class State(NamedTuple):
    """B scenes of A agents. Never written in place: states handed out stay as they were.

    Attributes:
        key: Key of each scene's draws (B,) long.
        map_id: Floor plan (B,) long, -1 for none.
        row: Its row in the bank (B,) long, -1 for none.
        wall_frame: How the walls lie in each scene, see `LocalWalls.frame` (B, 7).
        wall_place: See `LocalWalls.place` (B, 3) int32.
        pose: Scene poses (B, 4).
        scene: Which scene of the scenario's script is played (B,) long; 0 where there is none.
        clock: Time since the warm start (B,), seconds.
        failed: A policy gave no number (B,) bool.
        mask: Which agents are there (B, A) bool.
        controlled: Which of them a policy moves (B, A) bool; the others are played back or stay.
        person: Number of the person in each slot (B, A) long, -1 for none: noise is drawn by it.
        observed_points: How many of the latest trace points, up to 29, show an agent (B, A) long.
        past: Latest positions every 0.1 s (B, A, 29, 2), oldest first.
        velocity: Over the last 0.1 s (B, A, 2), m/s.
        heading: Where the body faces (B, A), radians.
        turn_rate: How fast wheels turn it (B, A), rad/s.
        radius: Of the body (B, A), metres.
        kind: Person or robot (B, A) long.
        group: Number of the company that an agent walks in (B, A) long, -1 for alone.
        drive: `HOLONOMIC`, `UNICYCLE` or `DIFF_DRIVE` (B, A) long.
        top_speed: No agent moves faster than this (B, A), m/s.
        acceleration: Greatest change of speed, of wheels or in any direction (B, A), m/s^2; ``inf`` for none.
        turn_acceleration: Greatest change of the turning rate (B, A), rad/s^2.
        track: Distance between the wheels (B, A), metres.
        pref_speed: The speed that agents like (B, A), m/s.
        goal_id: The planner's number of each agent's goal (B, A) long, -1 for none.
        later_goals: The goals after the first (B, A, G) long, used in turn; -1 for none.
        goal_point: Where the goal is (B, A, 2), metres.
        goal_since: When agents were given it (B, A), seconds on the clock; -inf where they were on their way
            when the scene began, or go as recorded.
        drawn: Goals that were taken after the first (B, A) long.
        reached: Goals reached since the warm start (B, A) long.
        deadline: When the goal has to be reached (B, A), seconds on the clock.
        overdue: A goal was not reached in time (B, A) bool.
        remaining_path: Length of the path to the goal (B, A), metres.
        planned: Paths of all goals up to this one, each as of when the goal was set and less its radius (B,
            A), metres.
        stands: Until when an agent stands where it began, or holds its place (B, A), seconds on the clock; 0
            where it does neither, infinite where no time says when.
    """

    key: Tensor
    map_id: Tensor
    row: Tensor
    wall_frame: Tensor
    wall_place: Tensor
    pose: Tensor
    scene: Tensor
    clock: Tensor
    failed: Tensor
    mask: Tensor
    controlled: Tensor
    person: Tensor
    observed_points: Tensor
    past: Tensor
    velocity: Tensor
    heading: Tensor
    turn_rate: Tensor
    radius: Tensor
    kind: Tensor
    group: Tensor
    drive: Tensor
    top_speed: Tensor
    acceleration: Tensor
    turn_acceleration: Tensor
    track: Tensor
    pref_speed: Tensor
    goal_id: Tensor
    later_goals: Tensor
    goal_point: Tensor
    goal_since: Tensor
    drawn: Tensor
    reached: Tensor
    deadline: Tensor
    overdue: Tensor
    remaining_path: Tensor
    planned: Tensor
    stands: Tensor

    @classmethod
    def of(cls, past: Tensor, mask: Tensor, pref_speed: Tensor, **given: Tensor | None) -> State:
        """Return people at their start; missing values are those of a person, without limits.

        Args:
            past: As in the class, like all others.
            mask: Which agents are there.
            pref_speed: The speed that agents like.
            given: All that differs between scenes, and every other unusual value.
        """
        nothing, none = torch.zeros_like(pref_speed), torch.zeros_like(mask, dtype=torch.long)
        endless, never = torch.full_like(nothing, torch.inf), torch.zeros_like(mask)
        usual = dict.fromkeys(("turn_rate", "remaining_path", "planned", "stands"), nothing)
        usual |= dict.fromkeys(("kind", "drive", "drawn", "reached"), none)
        usual |= {"group": none - 1}
        usual |= dict.fromkeys(("acceleration", "turn_acceleration", "deadline"), endless)
        usual |= {"goal_since": -endless}
        usual |= {
            "overdue": never,
            "failed": never.new_zeros(len(mask)),
            "clock": nothing.new_zeros(len(mask)),
        }
        usual |= {"track": torch.ones_like(nothing), "top_speed": TOP_SPEED_RATIO * pref_speed}
        usual |= {name: value for name, value in given.items() if value is not None}
        return cls(past=past, mask=mask, pref_speed=pref_speed, **usual)

    @property
    def position(self) -> Tensor:
        """Where agents are (B, A, 2), metres."""
        return self.past[:, :, -1]

    @property
    def history(self) -> Tensor:
        """Where they were every 0.4 s (B, A, 8, 2)."""
        return self.past[:, :, ::TRACE_PER_STEP]

    @property
    def valid(self) -> Tensor:
        """Which of these are known (B, A, 8) bool; unknown ones are the first known one."""
        age = torch.arange(PAST_LEN - 1, -1, -TRACE_PER_STEP, device=self.observed_points.device)
        return self.observed_points.unsqueeze(2) > age

    @property
    def decides(self) -> Tensor:
        """Which agents walk by a policy now (B, A) bool: those with a goal; others stand."""
        return self.controlled & (self.goal_id >= 0)

    @property
    def holds(self) -> Tensor:
        """Which agents wait at their goal, where their policy has to hold them (B, A) bool."""
        return self.controlled & (self.stands > self.clock.unsqueeze(1) + CLOCK_ROUNDING)

    @property
    def next_goal(self) -> Tensor:
        """The goals after the present ones (B, A) long, -1 for none."""
        number = (self.drawn % self.later_goals.shape[2]).unsqueeze(2)
        return self.later_goals.gather(2, number)[..., 0]

    def select(self, index: Tensor) -> State:
        """Return some of the scenes."""
        return State(*(value.index_select(0, index) for value in self))

    def to(self, device: torch.device | str) -> State:
        """Return the state on a device."""
        return (
            self if self.key.device == torch.device(device) else State(*(value.to(device) for value in self))
        )
