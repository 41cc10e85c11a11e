"""How people stand and keep company, as two sums for every person, whose ratio is the measure.

P people numbered as in ``person``. Sums of people add up over rollouts, and weights of people resample them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics.realism.distances import sums
from pedzoo.metrics.realism.features import SampledRollout
from pedzoo.metrics.smoothness import STANDS
from pedzoo.sim.replay.companions import DRIFT, NEAR, TOGETHER


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


STRIP = 0.6
"""Metres: width of the strips in which lanes are looked for."""

TOUCHING = 0.2
"""Metres: CrowdES counts people as colliding whose centres are nearer."""

_AT_ONCE = 4_000_000
"""Pairs of people and moments that are looked at at once."""


def measured(steps: SampledRollout, people: int, axis: Tensor) -> dict[str, PersonSums]:
    """Return the measures of one rollout, by the names of their columns.

    * ``standing_share``: of scored steps, those slower than 0.1 m/s.
    * ``company_share``: those with a companion, a person within 1.5 m in each of the last 8 steps (2.8 s)
      whose relative place has changed by less than 0.5 m meanwhile.
    * ``crowdes_collision``: those with a person nearer than 0.2 m.
    * ``lane_order``: how much more often than in a mixed crowd two walkers in the same strip walk the same
      way, see `lane_order`.

    Args:
        steps: Every 0.4 s.
        people: P.
        axis: Unit vector along which most people walk (2,).
    """
    parts = []
    size = max(1, _AT_ONCE // (steps.person.shape[1] ** 2 * steps.person.shape[2]))
    for first in range(0, len(steps.person), size):
        some = SampledRollout(*(value[first : first + size] for value in steps))
        parts.append(_measured(some, people, axis))
    return added(parts)


def _measured(steps: SampledRollout, people: int, axis: Tensor) -> dict[str, PersonSums]:
    """Return the measures of a few episodes E; pairs are (E, S, A, A)."""
    scored, there = steps.scored, steps.person >= 0
    person = steps.person[scored]
    whole = sums(person, torch.ones(len(person)), people)

    def share(when: Tensor) -> PersonSums:
        """Return the share of scored steps (E, A, S)."""
        return PersonSums(sums(person, when[scored], people), whole)

    xy, here = steps.xy.transpose(1, 2), there.transpose(1, 2)
    apart = xy.unsqueeze(2) - xy.unsqueeze(3)
    pairs = here.unsqueeze(2) & here.unsqueeze(3) & ~torch.eye(here.shape[2], dtype=torch.bool)
    distance = apart.norm(dim=4).masked_fill(~pairs, torch.inf)
    return {
        "standing_share": share(steps.velocity.norm(dim=3) < STANDS),
        "company_share": share(_accompanied(steps, apart, distance).transpose(1, 2)),
        "crowdes_collision": share((distance < TOUCHING).any(3).transpose(1, 2)),
        "lane_order": lane_order(steps, pairs, axis, people),
    }


def _accompanied(steps: SampledRollout, apart: Tensor, distance: Tensor) -> Tensor:
    """Return which people have a companion (E, S, A) bool."""
    result = torch.zeros(distance.shape[:3], dtype=torch.bool)
    if distance.shape[1] < TOGETHER:
        return result
    person, last = steps.person.transpose(1, 2), TOGETHER - 1
    same = person[:, last:] == person[:, :-last]
    same = same.unsqueeze(2) & same.unsqueeze(3)
    for back in range(1, last):  # no other person was in their slots meanwhile
        between = person[:, last - back : person.shape[1] - back] == person[:, last:]
        same &= between.unsqueeze(2) & between.unsqueeze(3)
    near = (distance <= NEAR).unfold(1, TOGETHER, 1).all(-1)
    drift = (apart[:, last:] - apart[:, :-last]).norm(dim=4)
    result[:, last:] = (same & near & (drift < DRIFT)).any(3)
    return result


def lane_order(steps: SampledRollout, pairs: Tensor, axis: Tensor, people: int) -> PersonSums:
    """Return how far walkers are sorted into lanes: 0 as in a mixed crowd, 1 if no strip has both ways.

    Strips of 0.6 m lie along the axis. Of all pairs of people who walk in one strip at a moment, s walk the
    same way; of all pairs of that moment, m do. The order is ``sum(s - m) / sum(1 - m)``. A crowd that walks
    one way has none.

    Args:
        steps: Every 0.4 s.
        pairs: Which two people are there at each moment (E, S, A, A) bool.
        axis: Unit vector along which most people walk (2,).
        people: P.
    """
    xy, velocity = steps.xy.transpose(1, 2), steps.velocity.transpose(1, 2)
    walks = (steps.scored & (steps.velocity.norm(dim=3) > STANDS)).transpose(1, 2)
    strip = ((axis[0] * xy[..., 1] - axis[1] * xy[..., 0]) / STRIP).floor()
    way = (velocity * axis).sum(-1) > 0
    both = pairs & walks.unsqueeze(2) & walks.unsqueeze(3)
    alike = (way.unsqueeze(2) == way.unsqueeze(3)) & both
    mixed = alike.sum((2, 3), keepdim=True) / both.sum((2, 3), keepdim=True).clamp_min(1)
    strips = both & (strip.unsqueeze(2) == strip.unsqueeze(3))
    above = (alike & strips).sum(3) - mixed.squeeze(3) * strips.sum(3)
    below = (1 - mixed.squeeze(3)) * strips.sum(3)
    person = steps.person.transpose(1, 2)[walks]
    return PersonSums(*(sums(person, value[walks], people) for value in (above, below)))


def main_axis(start: Tensor, goal: Tensor) -> Tensor:
    """Return the unit vector (2,) along which most people walk, either way, from ends of walks (P, 2)."""
    way = (goal - start).double()
    angle = 2 * torch.atan2(way[:, 1], way[:, 0])
    weight = way.norm(dim=1)
    half = torch.atan2((weight * angle.sin()).sum(), (weight * angle.cos()).sum()) / 2
    return torch.stack((half.cos(), half.sin())).float()


def added(parts: list[dict[str, PersonSums]]) -> dict[str, PersonSums]:
    """Return the sums of several rollouts of the same people."""
    return {
        name: PersonSums(
            *(torch.stack(values).sum(0) for values in zip(*(p[name] for p in parts), strict=True))
        )
        for name in parts[0]
    }
