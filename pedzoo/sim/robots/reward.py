"""What a decision of robots came to, and the reward for it: a weighted sum of terms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, cast

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT, other_agents
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_REWARDS
from pedzoo.core.spec import build
from pedzoo.sim.robots.sensor import RobotView, shape_of
from pedzoo.sim.state import Events, State

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


def outcome_of(
    before: State,
    after: State,
    events: Events,
    robots: int,
    goals: int,
    time_limit: float | None,
    ends_at: str,
) -> Outcome:
    """Return the outcome of a decision for the last R ``robots``, of the scenes ``before`` and ``after`` it.

    Each robot has to reach so many ``goals`` within the ``time_limit``, seconds; None for the deadlines of
    `pedzoo.sim.rules.deadline`. For ``ends_at`` see `EndsAt`.
    """
    last = slice(-robots, None)
    active = before.controlled[:, last]
    touched = active & events.agent_contact[:, last].any(-1)
    wall = active & events.wall_contact[:, last].any(-1)
    person = touched
    if robots > 1:  # of which kind is the nearest body on the way
        gap = torch.linalg.vector_norm(events.trace[:, last].unsqueeze(2) - events.trace.unsqueeze(1), dim=-1)
        gap = gap.amin(-1) - before.radius.unsqueeze(1) - before.radius[:, last].unsqueeze(2)
        nearest = gap.masked_fill(~other_agents(before.mask, robots), torch.inf).argmin(-1)
        person = touched & (before.kind.gather(1, nearest) != ROBOT)
    late = after.overdue[:, last] if time_limit is None else (after.clock >= time_limit - 1e-3).unsqueeze(1)
    hit = {"any": touched | wall, "agent": touched, "none": torch.zeros_like(touched)}[ends_at]
    failed = active & after.failed.unsqueeze(1)
    success = active & (events.reached[:, last, -1] >= goals) & ~hit
    timeout = active & (late | ~after.mask[:, last]) & ~success & ~hit & ~failed
    ended = active & (success | hit | timeout | failed)
    return Outcome(active, success, person, touched & ~person, wall, timeout, failed, ended)


class RobotReward(ABC):
    """A term of the reward: a class of `pedzoo.sim.robots.rewards`, or ``file.py:Class``."""

    @abstractmethod
    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Return the term (B, R) for one decision; what it says of robots that had ended does not count.

        Args:
            before: The scenes when the decision began.
            after: And when it ended.
            trace: Where all agents were every 0.1 s between (B, A, S, 2), metres.
            outcome: What became of the robots.
        """


DEFAULT_WEIGHTS = {"progress": 1.0, "success": 5.0, "collision": 5.0, "discomfort": 1.0, "time": 0.1}
"""Default terms and weights."""


class WeightedSum:
    """The reward of a decision: terms by name, each times its weight."""

    def __init__(self, weights: Mapping[str, float] | None = None) -> None:
        """Take weights by name with settings, ``{"progress": 1, "discomfort:distance=0.4": 2}``.

        Raises:
            UserError: An unknown name or setting, or weights that are no numbers by name.
        """
        given = DEFAULT_WEIGHTS if weights is None else weights
        if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
            raise UserError(f'reward {given!r:.60}: expected weights by name, such as {{"progress": 1.0}}')
        self.terms: list[tuple[str, RobotReward, float]] = []
        for name, weight in given.items():
            term = build(ROBOT_REWARDS, name, RobotReward)
            try:
                number = float(cast("Any", weight))
            except (TypeError, ValueError):
                number = math.nan
            if not math.isfinite(number):
                expected = f'a finite number, as in {{"{name}": 1.0}}'
                raise UserError(f"reward {name}: weight {weight!r:.60}: expected {expected}")
            self.terms.append((name, term, number))

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Return the reward (B, R); 0 for robots that had ended.

        Raises:
            UserError: A term has another shape, or is no number for a robot that has not ended.
        """
        total, terms = torch.zeros_like(after.heading), {}
        for name, term, weight in self.terms:
            value = term(before, after, trace, outcome)
            if (given := shape_of(value)) != total.shape:
                raise UserError(f"reward {name} returned {given}: expected (B, R) = {tuple(total.shape)}")
            terms[name] = torch.where(outcome.active, value, 0.0)
            total = total + weight * terms[name]
        if not bool(total.isfinite().all()):
            for name, value in terms.items():
                if len(odd := value[~value.isfinite()]):
                    raise UserError(f"reward {name} returned {float(odd[0])}: expected finite numbers")
            raise UserError(f"rewards {', '.join(terms)}: their sum is no finite number")
        return total
