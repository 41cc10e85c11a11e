"""The state of scenes between two decisions, and what a decision gives: motion, contacts, events."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import heading_of, identity_pose
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS

TRACE_PER_STEP = round(STEP_SECONDS / TRACE_SECONDS)
"""Trace points in one step of the networks' clock."""

PAST_LEN = (OBS_LEN - 1) * TRACE_PER_STEP + 1
"""Trace points that 8 observed steps span."""

SLOWEST = 0.3
"""Least preferred speed, m/s."""

CONTACT_COST = 1.0
"""Metres of progress that a decision with a contact costs in the reward."""

CLOCK_ROUNDING = 1e-3
"""Seconds: clocks are sums of decisions."""


class State(NamedTuple):
    """B scenes of A agents. Never written in place: states handed out stay as they were.

    Attributes:
        key: Key of each scene's draws (B,) long.
        map_id: Floor plan (B,) long, -1 for none.
        row: Its row in the bank (B,) long, -1 for none.
        wall_frame: How the walls lie in scenes (B, 7), with ``wall_place`` (B, 3) int32: see `LocalWalls`.
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
        goal_index: Which of its goals each agent walks to (B, A) long, 0 for the first.
        reached: Goals reached since the warm start (B, A) long.
        deadline: When the goal has to be reached (B, A), seconds on the clock.
        overdue: A goal was not reached in time (B, A) bool.
        remaining_path: Length of the path to the goal (B, A), metres.
        planned: Paths of all goals up to this one (B, A), metres, each as of then and less the goal's radius.
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
    goal_index: Tensor
    reached: Tensor
    deadline: Tensor
    overdue: Tensor
    remaining_path: Tensor
    planned: Tensor
    stands: Tensor

    @classmethod
    def of(cls, past: Tensor, mask: Tensor, pref_speed: Tensor, **given: Tensor | None) -> State:
        """Return people at their start, without limits and in scenes that lie as their map.

        ``given`` is all that differs between scenes, and every other unusual value.
        """
        nothing, none = torch.zeros_like(pref_speed), torch.zeros_like(mask, dtype=torch.long)
        endless, begin = torch.full_like(nothing, torch.inf), nothing.new_zeros(len(mask))
        velocity = (past[:, :, -1] - past[:, :, -2]) / TRACE_SECONDS
        usual = dict.fromkeys(("turn_rate", "remaining_path", "planned", "stands"), nothing)
        usual |= dict.fromkeys(("kind", "drive", "goal_index", "reached", "goal_id"), none)
        usual |= dict.fromkeys(("acceleration", "turn_acceleration", "deadline"), endless)
        usual |= {"group": none - 1, "goal_since": -endless, "track": torch.ones_like(nothing)}
        usual |= {"overdue": torch.zeros_like(mask), "failed": begin > 0, "clock": begin}
        usual |= {"top_speed": TOP_SPEED_RATIO * pref_speed, "scene": begin.long(), "controlled": mask}
        usual |= {"person": torch.where(mask, torch.arange(mask.shape[1], device=mask.device), -1)}
        usual |= {"velocity": velocity, "heading": heading_of(velocity), "goal_point": past[:, :, -1]}
        usual |= {"observed_points": none + PAST_LEN, "pose": identity_pose(len(mask), mask.device)}
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
        number = (self.goal_index % self.later_goals.shape[2]).unsqueeze(2)
        return self.later_goals.gather(2, number)[..., 0]

    def select(self, index: Tensor) -> State:
        """Return some of the scenes."""
        return State(*(value.index_select(0, index) for value in self))

    def to(self, device: torch.device | str) -> State:
        """Return the state on a device."""
        if self.key.device == torch.device(device):
            return self
        return State(*(value.to(device) for value in self))


class Contacts(NamedTuple):
    """Whether another ``agent``, and whether a ``wall`` is touched at each trace point (B, A, S) bool."""

    agent: Tensor
    wall: Tensor


class OwnedMotion(NamedTuple):
    """How bodies that a physics backend owns move in a decision.

    Attributes:
        path: Positions at all sub-steps (B, A, S, M, 2), metres.
        heading: Where they face at the end (B, A), radians.
        turn_rate: How fast they turn at the end (B, A), rad/s.
    """

    path: Tensor
    heading: Tensor
    turn_rate: Tensor


class MotionInput(NamedTuple):
    """How agents are to move in a decision of S trace points of M ``substeps``.

    Attributes:
        command: What policies want (B, A, 2), as the agent's drive has it, not limited; 0 without a goal.
        velocity: On the common path in each 0.1 s (2, S, B, A), m/s, limits respected already.
        moving: Which agents move (B, A) bool; others are played back, or stay where they are.
        wanted: Which agents may reach their goals (B, A) bool.
        played: Paths of those who are played back (B, A, S, M, 2); None for none.
        owned: How agents move that the backend owns, whose paths are among those played back; None for none.
    """

    command: Tensor
    velocity: Tensor
    moving: Tensor
    wanted: Tensor
    substeps: int
    played: Tensor | None = None
    owned: OwnedMotion | None = None


class Motion(NamedTuple):
    """What bodies do in a decision of S trace points.

    Attributes:
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        agent_contact: Another agent is touched in that 0.1 s (B, A, S) bool.
        wall_contact: A wall is (B, A, S) bool.
        reached: The agent that walks has come within 0.3 m of its goal until then (B, A, S) bool.
        heading: Where bodies that the physics backend owns face at the end (B, A), radians, NaN for other
            agents; None where it owns none.
        turn_rate: How fast these bodies turn at the end (B, A), rad/s; None where it owns none.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    heading: Tensor | None = None
    turn_rate: Tensor | None = None


class Decision(NamedTuple):
    """What a decision of S trace points has done to the scenes, before the planner is asked again.

    Attributes:
        state: The scenes after it, with paths and times to goals as before.
        motion: What the bodies did.
        moving: Which agents a policy moved (B, A) bool.
        hits: Which agents have reached a goal until each trace point (B, A, S) bool.
        sets_out: Which agents set out, or were taken over by the policy, at its end (B, A) bool.
    """

    state: State
    motion: Motion
    moving: Tensor
    hits: Tensor
    sets_out: Tensor


class Events(NamedTuple):
    """The events of one decision of S trace points.

    Attributes:
        trace: As in `Motion`, like both contacts.
        reached: Goals reached until then (B, A, S) long.
        reward: Metres of path that got shorter, less `CONTACT_COST` for a contact (B, A).
        terminated: All agents have reached all goals (B,) bool.
        truncated: No other agent can in time, or the policy failed (B,) bool.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
