"""Positions of all agents every 0.1 s, for closed-loop metrics and pictures; those of robots, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self, TypeVar

import torch
from torch import Tensor

from pedzoo.core.bodies import Fleet
from pedzoo.core.randomness import Draws
from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.state import State


class _Episodes:
    """What can be cut into episodes."""

    def episodes(self, index: slice) -> Self:
        """Return some of the episodes."""
        this: Any = self
        values = {field.name: getattr(self, field.name) for field in fields(this)}
        some = {name: value[index] for name, value in values.items() if isinstance(value, Tensor)}
        some |= {name: value.episodes(index) for name, value in values.items() if isinstance(value, Rollout)}
        return replace(this, **some)


@dataclass(frozen=True, eq=False, repr=False)
class Rollout(_Episodes):
    """E episodes of A people, on a trace of T points every 0.1 s after the warm start.

    After an episode's end positions and counts stay as they were, and no agent is present. Only
    ``controlled`` agents are scored; other present agents can be touched. In a replay people are played back
    before the policy takes them over, and people who come later take the slots of people who have left.

    Attributes:
        trace: Positions (E, A, T, 2), metres.
        goal: Goals of that moment (E, A, T, 2), metres.
        present: Which agents are there, in a running episode (E, A, T) bool.
        controlled: Which agents are there and moved by the policy (E, A, T) bool.
        person: Person in the slot (E, A, T) long, -1 for none; the slot's number in ordinary scenes.
        planned: Length of the planner's paths of all goals until the one being walked to (E, A, T), metres:
            each as of when the goal was set, less the goal's radius and not below 0.
        agent_contact: A body was touched in that 0.1 s (E, A, T) bool; false in empty slots.
        wall_contact: A wall was (E, A, T) bool.
        reached: Goals that the person in the slot has reached until then (E, A, T) long.
        overdue: A goal was not reached in time (E, A) bool.
        failed: The policy returned NaN or infinity (E,) bool.
        mask: Which agents were there at the beginning (E, A) bool.
        past: The warm start (E, A, 29, 2), its last point is where the episode begins.
        pref_speed: The speed that people like (E, A), m/s.
        first_path_length: Length of the path to the first goal (E, A), metres.
        radius: Radii of the bodies (E, A), metres.
        kind: `pedzoo.core.batch.PERSON` or `ROBOT` (E, A) long.
        map_id: Floor plan (E,) long.
        pose: Scene poses (E, 4).
        goals: Goals that each agent had to reach.
        gate: The scene's door (E, 5): centre x and y, unit normal x and y of its wall, clear width; metres.
            None where the scenario has none.
        decision_dt: Seconds between two decisions of the policy.
        changed: By how many metres a safety layer changed the step of which a point is part (E, A, T); None
            where the policy has no layer, or is a mixed crowd.
    """

    trace: Tensor
    goal: Tensor
    present: Tensor
    controlled: Tensor
    person: Tensor
    planned: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    overdue: Tensor
    failed: Tensor
    mask: Tensor
    past: Tensor
    pref_speed: Tensor
    first_path_length: Tensor
    radius: Tensor
    kind: Tensor
    map_id: Tensor
    pose: Tensor
    goals: int
    gate: Tensor | None = None
    decision_dt: float = STEP_SECONDS
    changed: Tensor | None = None

    def __repr__(self) -> str:
        episodes, people, points = self.present.shape
        return f"Rollout({episodes} episodes of {people} people, at most {points * TRACE_SECONDS:.1f} s)"

    @property
    def length(self) -> Tensor:
        """Number of trace points that each episode has (E,) long."""
        return self.present.any(1).sum(1)

    @property
    def path(self) -> Tensor:
        """Positions from where the episode begins (E, A, 1 + T, 2), metres: the trace with its start."""
        return torch.cat((self.past[:, :, -1:], self.trace), dim=2)

    @cached_property
    def scored(self) -> Tensor:
        """Which agents are scored (E, A, T) bool: controlled, and in the slot already at the point before."""
        return self.controlled & self._same_agent

    @property
    def underway(self) -> Tensor:
        """Which agents are controlled and had goals left at the point before (E, A, T) bool.

        After arriving people are there until the end of the decision.
        """
        arrived = torch.zeros_like(self.controlled)
        same = self.person[..., 1:] == self.person[..., :-1]
        arrived[..., 1:] = same & (self.reached[..., :-1] >= self.goals)
        return self.controlled & ~arrived

    @property
    def stood(self) -> Tensor:
        """How long people were there before a policy moved them (E, A), seconds."""
        return TRACE_SECONDS * (self.present & ~self.controlled).sum(2)

    @property
    def continuous(self) -> Tensor:
        """Same agent present at this and the previous point (E, A, T) bool."""
        return self.present & self._same_agent

    @property
    def _same_agent(self) -> Tensor:
        there = torch.cat((self.mask.unsqueeze(2), self.present[..., :-1]), dim=2)
        before = torch.cat((self.person[..., :1], self.person[..., :-1]), dim=2)
        return there & (self.person == before)

    @cached_property
    def replayed(self) -> bool:
        """Whether people are played back, come later or take others' slots, as in recorded scenes.

        People who stand where the episode began are not played back.
        """
        stands = (self.trace == self.past[:, :, -1:]).all(-1).cummin(2).values
        theirs = self.mask.unsqueeze(2) & (self.controlled | stands) & (self.person == self.person[..., :1])
        return not bool((theirs | ~self.present).all())

    def stays(self, episode: int) -> list[tuple[int, int, int]]:
        """Return slot, first and last point of each person's stay in an episode, points as in `path`.

        In a replay a slot has several people, one after the other.
        """
        there = torch.cat((self.mask[episode].unsqueeze(1), self.present[episode]), dim=1)
        occupant = torch.cat((self.person[episode, :, :1], self.person[episode]), dim=1)
        occupant = torch.nn.functional.pad(torch.where(there, occupant, -1), (1, 1), value=-1)
        change = occupant[:, 1:] != occupant[:, :-1]
        begins, ends = change & (occupant[:, 1:] >= 0), change & (occupant[:, :-1] >= 0)
        result = zip(begins.nonzero().tolist(), ends.nonzero().tolist(), strict=True)
        return [(slot, first, last - 1) for (slot, first), (_, last) in result]


@dataclass(frozen=True, eq=False)
class RobotRollout(_Episodes):
    """E episodes with R robots among N people, and the same ones without them; T points every 0.1 s.

    Attributes:
        walked: All agents, robots in the last R slots, until the last robot's episode ends. ``controlled``
            says when a robot was on its way.
        alone: The same scenes of the same seed without robots, for as long.
        heading: Where robots face (E, R, 1 + T), radians, from where the episode begins.
        person_contact: A robot touched a person in that 0.1 s (E, R, T) bool.
        robot_contact: Another robot (E, R, T) bool.
        wall_contact: A wall (E, R, T) bool.
        success: The robot reached all its goals (E, R) bool.
        timeout: Its time was up (E, R) bool.
        failed: Its action, or that of a person, was no number (E, R) bool.
        progress: Metres of the planner's ways that each agent had covered at the end (E, N + R).
        progress_alone: Likewise without robots.
        goals: That each robot had to reach.
        bodies: The limits of the robots.
    """

    walked: Rollout
    alone: Rollout
    heading: Tensor
    person_contact: Tensor
    robot_contact: Tensor
    wall_contact: Tensor
    success: Tensor
    timeout: Tensor
    failed: Tensor
    progress: Tensor
    progress_alone: Tensor
    goals: int
    bodies: Fleet

    @property
    def robots(self) -> int:
        """R."""
        return self.heading.shape[1]

    @property
    def there(self) -> Tensor:
        """When robots were on their way (E, R, T) bool: not after arriving, until their decision ends."""
        reached, scored = (value[:, -self.robots :] for value in (self.walked.reached, self.walked.scored))
        before = torch.cat((torch.zeros_like(reached[..., :1]), reached[..., :-1]), dim=2)
        return scored & (before < self.goals)

    @property
    def seconds(self) -> Tensor:
        """How long each episode took (E,), seconds."""
        return self.walked.length * TRACE_SECONDS


OVER_TIME = tuple(field.name for field in fields(Rollout))[:9]
"""Fields of a `Rollout` that always have a value for every trace point."""

_GROWING = (*OVER_TIME, "changed", "heading", "person_contact", "robot_contact")

AnyRollout = TypeVar("AnyRollout", Rollout, RobotRollout)


def joined(parts: Sequence[AnyRollout]) -> AnyRollout:
    """Join rollouts of the same scenario; shorter ones stand still, absent, until the longest ends."""
    result: dict[str, Any] = {}
    for name in (field.name for field in fields(parts[0])):
        values = [getattr(part, name) for part in parts]
        if isinstance(values[0], Rollout):
            result[name] = joined(values)
        elif isinstance(values[0], Tensor):
            longest = max(value.shape[2] for value in values) if name in _GROWING else 0
            result[name] = torch.cat([grown(value, longest) if longest else value for value in values])
    return replace(parts[0], **result)


def grown(value: Tensor, points: int) -> Tensor:
    """Return values of trace points (E, A, T, ...) grown to ``points``: the last stays, flags are false."""
    last = value[:, :, -1:].expand(*value.shape[:2], points - value.shape[2], *value.shape[3:])
    return torch.cat((value, torch.zeros_like(last) if value.dtype == torch.bool else last), dim=2)


def rollout_of(
    scenario: Scenario,
    start: State,
    steps: Sequence[Mapping[str, Tensor]],
    overdue: Tensor,
    failed: Tensor,
    decision_dt: float = STEP_SECONDS,
) -> Rollout:
    """Return the rollout of scenes of a scenario that began in a state.

    ``steps`` have values for every trace point, piece by piece (E, A, S, ...). All else is as of `Rollout`.
    """
    known = [*OVER_TIME, *(["changed"] if "changed" in steps[0] else [])]
    as_begun = ("mask", "past", "pref_speed", "radius", "kind", "map_id", "pose")
    return Rollout(
        **{key: torch.cat([step[key] for step in steps], dim=2) for key in known},
        **{key: getattr(start, key) for key in as_begun},
        overdue=overdue,
        failed=failed,
        first_path_length=start.remaining_path,
        goals=scenario.goals,
        gate=scenario.gate(Draws(start.key)),
        decision_dt=decision_dt,
    )
