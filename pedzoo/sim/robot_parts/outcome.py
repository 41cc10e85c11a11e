"""The outcome of a decision for robots: arrival, contacts, timeout."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT, other_agents
from pedzoo.core.errors import unknown
from pedzoo.sim.state import State
from pedzoo.sim.step_result import Events

EndsAt = Literal["any", "agent", "none"]
"""Which contacts end a robot's episode: with anything, with people and other robots, or none."""


class Outcome(NamedTuple):
    """What happened to R robots in one decision (B, R) bool; false for robots that had ended before.

    Attributes:
        active: The robot was on its way when the decision began.
        success: It has reached all its goals.
        person_contact: It touched a person.
        robot_contact: It touched another robot.
        wall_contact: It touched a wall.
        timeout: Its time is up.
        failed: Its action was no number, or that of a person in its scene.
        ended: Its episode is over.
    """

    active: Tensor
    success: Tensor
    person_contact: Tensor
    robot_contact: Tensor
    wall_contact: Tensor
    timeout: Tensor
    failed: Tensor
    ended: Tensor

    @property
    def collision(self) -> Tensor:
        """It touched anything (B, R) bool."""
        return self.person_contact | self.robot_contact | self.wall_contact

    @classmethod
    def none(cls, active: Tensor) -> Outcome:
        """Return the outcome of no decision, for robots that are ``active`` (B, R) bool."""
        return cls(active, *[torch.zeros_like(active)] * (len(cls._fields) - 1))

    def then(self, later: Outcome) -> Outcome:
        """Return the outcome of this decision and a later one."""
        return Outcome(self.active, *(one | other for one, other in zip(self[1:], later[1:], strict=True)))


def check_ends_at(ends_at: str) -> None:
    """Check which contacts end an episode.

    Raises:
        UserError: There is no such choice.
    """
    if ends_at not in get_args(EndsAt):
        raise unknown("ends_at", ends_at, get_args(EndsAt))


def outcome_of(
    before: State,
    after: State,
    events: Events,
    robots: int,
    goals: int,
    time_limit: float | None,
    ends_at: str,
) -> Outcome:
    """Return the outcome of a decision for the last ``robots`` agents.

    Args:
        before: The scenes at its beginning.
        after: And at its end.
        events: What happened.
        robots: R.
        goals: That each robot has to reach.
        time_limit: Seconds; None for the deadlines of `pedzoo.sim.arrival.deadline`.
        ends_at: See `EndsAt`.
    """
    last = slice(-robots, None)
    active = before.controlled[:, last]
    success = active & (events.reached[:, last, -1] >= goals)
    touched = active & events.agent_contact[:, last].any(-1)
    wall = active & events.wall_contact[:, last].any(-1)
    person = touched
    if robots > 1:
        person = touched & _nearest_is_person(events.trace, before, robots)
    late = after.overdue[:, last] if time_limit is None else (after.clock >= time_limit - 1e-3).unsqueeze(1)
    hit = {"any": touched | wall, "agent": touched, "none": torch.zeros_like(touched)}[ends_at]
    failed = active & after.failed.unsqueeze(1)
    success = success & ~hit
    timeout = active & (late | ~after.mask[:, last]) & ~success & ~hit & ~failed
    ended = active & (success | hit | timeout | failed)
    return Outcome(active, success, person, touched & ~person, wall, timeout, failed, ended)


def _nearest_is_person(trace: Tensor, state: State, robots: int) -> Tensor:
    """Return whose (B, R) bool nearest body on a trace (B, A, S, 2) is a person's."""
    mine = trace[:, -robots:].unsqueeze(2)
    gap = torch.linalg.vector_norm(mine - trace.unsqueeze(1), dim=-1).amin(-1)
    gap = gap - state.radius.unsqueeze(1) - state.radius[:, -robots:].unsqueeze(2)
    nearest = gap.masked_fill(~other_agents(state.mask, robots), torch.inf).argmin(-1)
    return state.kind.gather(1, nearest) != ROBOT
