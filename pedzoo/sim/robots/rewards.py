"""What a decision of robots came to, and the table of terms of their reward, which are classes by name."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_REWARDS
from pedzoo.core.spec import build
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robots.scenes import RobotView
from pedzoo.sim.robots.sensors import shape_of

DEFAULT_WEIGHTS = {"progress": 1.0, "success": 5.0, "collision": 5.0, "discomfort": 1.0, "time": 0.1}
"""Default terms and weights."""


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

    @classmethod
    def none(cls, active: Tensor) -> Outcome:
        """Return the outcome of no decision, for robots that are ``active`` (B, R) bool."""
        return cls(active, *[torch.zeros_like(active)] * (len(cls._fields) - 1))

    def then(self, later: Outcome) -> Outcome:
        """Return the outcome of this decision and a later one."""
        return Outcome(self.active, *(one | other for one, other in zip(self[1:], later[1:], strict=True)))


class RobotReward(ABC):
    """A term of the reward: a class of this file, or ``file.py:Class``."""

    @abstractmethod
    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Return the term (B, R) for one decision; what it says of robots that had ended does not count.

        It sees the scenes ``before`` and ``after``, where all agents were every 0.1 s between, ``trace``
        (B, A, S, 2), metres, and what became of the robots.
        """


class Collision(RobotReward):
    """-1 for a robot that touched a person, a robot or a wall."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """See `RobotReward`."""
        return -(outcome.person_contact | outcome.robot_contact | outcome.wall_contact).float()


class Discomfort(RobotReward):
    """A cost of coming nearer to people than they like, as in CrowdNav.

    Equation 3 of Chen et al., "Crowd-Robot Interaction" (ICRA 2019): the metres that lack, times the seconds
    for which they lack, divided by the distance that people like.
    """

    def __init__(self, distance: float = 0.2) -> None:
        """Say how near that is: metres between bodies. Raises UserError: it is not above zero."""
        if not distance > 0:
            raise UserError(f"robot reward discomfort: distance {distance}: expected metres above 0")
        self.distance = distance

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """See `RobotReward`."""
        state, last = before.state, slice(-before.robots, None)
        between = torch.linalg.vector_norm(trace[:, last].unsqueeze(2) - trace.unsqueeze(1), dim=-1)
        bodies = state.radius.unsqueeze(1) + state.radius[:, last].unsqueeze(2)
        person = state.mask & (state.kind != ROBOT)
        gap = torch.where(person[:, None, :, None], between - bodies.unsqueeze(-1), torch.inf).amin(2)
        return -(self.distance - gap.clamp_min(0)).clamp_min(0).sum(-1) * TRACE_SECONDS / self.distance


class Progress(RobotReward):
    """Metres by which the planner's way to the goal got shorter; all of it where a goal was reached."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """See `RobotReward`."""
        last = slice(-before.robots, None)
        same_goal = before.state.goal_id[:, last] == after.state.goal_id[:, last]
        left = torch.where(same_goal, after.state.remaining_path[:, last], 0.0)
        return before.state.remaining_path[:, last] - left


class Success(RobotReward):
    """1 for a robot that has reached all its goals."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """See `RobotReward`."""
        return outcome.success.float()


class Time(RobotReward):
    """-1 for every second."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """See `RobotReward`."""
        return -TRACE_SECONDS * trace.shape[2] * outcome.active


Terms = Sequence[tuple[str, RobotReward, float]]
"""Names, terms and weights of a reward."""


def terms_of(weights: Mapping[str, float] | None = None) -> Terms:
    """Return the terms of weights by name with settings, ``{"progress": 1, "discomfort:distance=0.4": 2}``.

    Raises:
        UserError: An unknown name or setting, or weights that are no numbers by name.
    """
    given, terms = DEFAULT_WEIGHTS if weights is None else weights, []
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise UserError(f'reward {given!r:.60}: expected weights by name, such as {{"progress": 1.0}}')
    for name, weight in given.items():
        term = build(ROBOT_REWARDS, name, RobotReward)
        try:
            number = float(cast("Any", weight))
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            expected = f'a finite number, as in {{"{name}": 1.0}}'
            raise UserError(f"reward {name}: weight {weight!r:.60}: expected {expected}")
        terms.append((name, term, number))
    return terms


def weighted_sum(
    terms: Terms, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome
) -> Tensor:
    """Return the reward (B, R) of a decision, see `RobotReward`; 0 for robots that had ended.

    Raises:
        UserError: A term has another shape, or is no number for a robot that has not ended.
    """
    total, values = torch.zeros_like(after.heading), {}
    for name, term, weight in terms:
        value = term(before, after, trace, outcome)
        if (given := shape_of(value)) != total.shape:
            raise UserError(f"reward {name} returned {given}: expected (B, R) = {tuple(total.shape)}")
        values[name] = torch.where(outcome.active, value, 0.0)
        total = total + weight * values[name]
    if not bool(total.isfinite().all()):
        for name, value in values.items():
            if len(odd := value[~value.isfinite()]):
                raise UserError(f"reward {name} returned {float(odd[0])}: expected finite numbers")
        raise UserError(f"rewards {', '.join(values)}: their sum is no finite number")
    return total
