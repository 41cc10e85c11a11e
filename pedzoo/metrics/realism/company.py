"""How people stand and keep company, as two sums for every person, whose ratio is the measure.

P people numbered as in ``person``. Sums of people add up over rollouts, and weights of people resample them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics.realism.features import Steps
from pedzoo.metrics.smoothness import STANDS


class PersonSums(NamedTuple):
    """``above.sum() / below.sum()`` is the measure.

    Attributes:
        above: Of each person (P,) float64.
        below: Likewise.
    """

    above: Tensor
    below: Tensor

    def of(self, weights: Tensor) -> Tensor:
        """Return the measure (R,) for weights of people (R, P), NaN where nothing is below."""
        return weights.double() @ self.above / (weights.double() @ self.below)


Measure = Callable[[Steps, int], PersonSums]


def standing_share(steps: Steps, people: int) -> PersonSums:
    """Return the share of scored steps slower than 0.1 m/s."""
    person = steps.person[steps.scored]
    stands = steps.velocity[steps.scored].norm(dim=1) < STANDS
    return PersonSums(_sums(person, stands, people), _sums(person, torch.ones_like(stands), people))


MEASURES: dict[str, Measure] = {"standing_share": standing_share}
"""By the names of their columns."""


def measured(steps: Steps, people: int) -> dict[str, PersonSums]:
    """Return all of `MEASURES`."""
    return {name: measure(steps, people) for name, measure in MEASURES.items()}


def added(parts: list[dict[str, PersonSums]]) -> dict[str, PersonSums]:
    """Return the sums of several rollouts of the same people."""
    return {
        name: PersonSums(
            *(torch.stack(values).sum(0) for values in zip(*(p[name] for p in parts), strict=True))
        )
        for name in parts[0]
    }


def _sums(person: Tensor, value: Tensor, people: int) -> Tensor:
    return torch.bincount(person, value.double(), people)
