"""The reward of a robot: a weighted sum of terms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, cast

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_REWARDS
from pedzoo.core.spec import build
from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.view import RobotView, shape_of


class RobotReward(ABC):
    """A term of the reward: one file in `pedzoo.sim.robot_rewards`, or ``file.py:Class``."""

    @abstractmethod
    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Return the term (B, R) for one decision; what it says of robots that had ended does not count.

        Args:
            before: The scenes when the decision began.
            after: And when it ended.
            trace: Where all agents were every 0.1 s between (B, A, S, 2), metres.
            outcome: What became of the robots.
        """


USUAL: Mapping[str, float] = {
    "progress": 1.0,
    "success": 5.0,
    "collision": 5.0,
    "discomfort": 1.0,
    "time": 0.1,
}
"""Terms and weights where nothing else is said."""


class WeightedSum:
    """The reward of a decision: terms by name, each times its weight."""

    def __init__(self, weights: Mapping[str, float] | None = None) -> None:
        """Take weights by name with settings, ``{"progress": 1, "discomfort:distance=0.4": 2}``.

        Raises:
            UserError: An unknown name or setting, or weights that are no numbers by name.
        """
        given = USUAL if weights is None else weights
        if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
            raise UserError(f'reward {given!r:.60}: expected weights by name, such as {{"progress": 1.0}}')
        self.terms = [
            (name, build(ROBOT_REWARDS, name, RobotReward), _weight(name, weight))
            for name, weight in given.items()
        ]

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
            raise UserError(_odd(terms))
        return total


def _odd(terms: Mapping[str, Tensor]) -> str:
    """Return which term is no finite number."""
    for name, value in terms.items():
        if len(odd := value[~value.isfinite()]):
            return f"reward {name} returned {float(odd[0])}: expected finite numbers"
    return f"rewards {', '.join(terms)}: their sum is no finite number"


def _weight(name: str, weight: object) -> float:
    try:
        if math.isfinite(number := float(cast("Any", weight))):
            return number
    except (TypeError, ValueError):
        pass
    raise UserError(
        f'reward {name}: weight {weight!r:.60}: expected a finite number, as in {{"{name}": 1.0}}'
    )
