"""Two crowds of the same people against each other: every number of realism, for many resamples at once.

A crowd is K rounds of P people. R resamples are weights (R, P), see `pedzoo.metrics.realism.distances`. How
people stand, keep company and sort into lanes are two sums for every person, whose ratio is the measure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.contacts import begins
from pedzoo.metrics.realism.distances import Samples, counted, grid, resampled, sums, wasserstein
from pedzoo.metrics.realism.features import CLOSE, FEATURES, SampledRollout, Surroundings, features
from pedzoo.metrics.smoothness import STANDS
from pedzoo.metrics.statistics import Interval, quantiles, ratio_interval
from pedzoo.sim.recorded_people import DRIFT, NEAR, TOGETHER
from pedzoo.sim.rollout import Rollout

MOST_CLOSE = 20
"""Places with more others close by count as if they had this many."""

FEW = 10
"""People who touch: of fewer a bootstrap of their contacts is too narrow."""

TAIL = {"p95": 0.95, "p99": 0.99}
"""Quantiles of acceleration: means hide people who brake hard now and then."""

STRIP = 0.6
"""Metres: width of the strips in which lanes are looked for."""

TOUCHING = 0.2
"""Metres: CrowdES counts people as colliding whose centres are nearer."""

_AT_ONCE = 4_000_000
"""Pairs of people and moments that are looked at at once."""

MINUTES = TRACE_SECONDS / 60
"""Of one trace point."""


class CrowdSums(NamedTuple):
    """Sums over the walks of P people in K rounds.

    Attributes:
        samples: Of every feature, all rounds together.
        minutes: For how long each person was on the way (P,), all rounds together.
        agent_contact: Minutes in contact with another person, and number of contacts that began (2, P).
        wall_contact: Likewise a wall.
        round: In which round each sample of speed was taken (N,) long.
        speeds_at: Sums of speeds (P, C) by the number of others within `CLOSE`, m/s.
        steps_at: How many steps these are (P, C).
    """

    samples: dict[str, Samples]
    minutes: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    round: Tensor
    speeds_at: Tensor
    steps_at: Tensor


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


def crowd(
    rollout: Rollout,
    steps: SampledRollout,
    around: Surroundings,
    first: int,
    scenes: int,
    start: Tensor,
    goal: Tensor,
) -> CrowdSums:
    """Return the crowd of a rollout.

    Args:
        rollout: Episodes ``first``, ``first + 1``, ... of a replay.
        steps: The same every 0.4 s.
        around: The surroundings of its people.
        first: Number of the first one.
        scenes: Episodes in a round.
        start: Where the line of each person begins (P, 2), metres.
        goal: Where it ends (P, 2), metres.
    """
    people, underway, person = len(start), rollout.underway, steps.person[steps.scored]
    close = around.close.clamp(max=MOST_CLOSE) + (MOST_CLOSE + 1) * person
    speed = steps.velocity[steps.scored].norm(dim=1)

    def at(weights: Tensor) -> Tensor:
        """Return sums (P, C) by person and number of others."""
        return sums(close, weights, people * (MOST_CLOSE + 1)).view(people, -1)

    def points(when: Tensor) -> Tensor:
        return torch.bincount(rollout.person[when], minlength=people).double()

    def contact(when: Tensor) -> Tensor:
        when = when & underway
        return torch.stack((points(when) * MINUTES, points(begins(when))))

    return CrowdSums(
        samples=features(steps, around, start, goal),
        minutes=points(underway) * MINUTES,
        agent_contact=contact(rollout.agent_contact),
        wall_contact=contact(rollout.wall_contact),
        round=(steps.scored.nonzero()[:, 0] + first) // scenes,
        speeds_at=at(speed),
        steps_at=at(torch.ones_like(speed)),
    )


def together(crowds: Sequence[CrowdSums]) -> CrowdSums:
    """Return one crowd of several of the same people, such as those of different rounds."""
    samples = {
        name: Samples(*(torch.cat(values) for values in zip(*(c.samples[name] for c in crowds), strict=True)))
        for name in FEATURES
    }
    total = {
        name: torch.stack([getattr(one, name) for one in crowds]).sum(0)
        for name in ("minutes", "agent_contact", "wall_contact", "speeds_at", "steps_at")
    }
    return CrowdSums(samples=samples, round=torch.cat([one.round for one in crowds]), **total)


def only(crowd: CrowdSums, seen: Tensor) -> CrowdSums:
    """Return the crowd without the samples of people who were not ``seen`` (P,) bool."""
    keep = {name: seen[samples.person] for name, samples in crowd.samples.items()}
    samples = {name: Samples(*(value[keep[name]] for value in crowd.samples[name])) for name in keep}
    return crowd._replace(samples=samples, round=crowd.round[keep["speed"]])


def spreads(real: CrowdSums) -> dict[str, float]:
    """Return the standard deviation of every feature in the real crowd: the unit of distances.

    It is NaN for fewer than two samples: a person who walks alone is near nobody.
    """
    values = {name: samples.value.double() for name, samples in real.samples.items()}
    return {name: float(value.std()) if len(value) > 1 else math.nan for name, value in values.items()}


def distances(first: CrowdSums, second: CrowdSums) -> dict[str, Tensor]:
    """Return the exact Wasserstein-1 distance (1,) of every feature, each person counting once."""
    return {
        name: wasserstein(*values).view(1) if all(map(len, values)) else values[0].new_tensor([math.nan])
        for name in FEATURES
        for values in [[side.samples[name].value.double() for side in (first, second)]]
    }


def resampled_distances(
    first: CrowdSums, second: CrowdSums, mine: Tensor, theirs: Tensor
) -> dict[str, Tensor]:
    """Return the Wasserstein-1 distance (R,) of every feature, NaN without samples.

    Weights of people are (R, P) for the first crowd, and (R, Q) for the second.
    """
    result = {}
    for name in FEATURES:
        one, other = first.samples[name], second.samples[name]
        result[name] = torch.full((len(mine),), torch.nan, dtype=torch.float64)
        if len(one.value) and len(other.value):
            edges = grid(one.value, other.value)
            both = zip((one, other), (mine, theirs), strict=True)
            ours, real = (counted(samples, edges, weights.shape[1]) for samples, weights in both)
            result[name] = resampled(ours, real, edges, mine, theirs)
    return result


def compared(
    crowd: CrowdSums,
    real: CrowdSums,
    mine: Tensor,
    theirs: Tensor,
    distance: dict[str, Tensor],
    spread: dict[str, float],
) -> dict[str, Tensor]:
    """Return every number of a crowd beside the real one, of R resamples (R,) each, NaN for none.

    * ``w1_speed_m_per_s``, ...: Wasserstein-1 distances. ``w1_speed``, ...: divided by the real crowd's
      standard deviation. ``realism``: the mean of the latter over the features that both crowds have (a
      person who never walks has no heading). Lower is better in all.
    * ``agent_contact_share``: share of the time in contact with another person; ``agent_contacts_per_min``:
      contacts that begin. ``agent_contact_excess``, ``agent_contact_excess_per_min``: less those of the real
      crowd, which are not 0: friends touch, and people lean on walls. The same of ``wall_contact``.
    * ``speed_std_m_per_s``: between people, of their mean speeds. Pooled distributions hide whether all
      people walk at the same mixed speed.
    * ``density_speed_rmse_m_per_s``: see `density_speed`.
    * ``acceleration_p95_m_per_s2``, ``acceleration_p99_m_per_s2``: quantiles of all samples; with ``_ratio``
      instead of the unit divided by those of the real crowd.

    Args:
        crowd: The simulated one.
        real: The recorded one.
        mine: How often each person counts in the first (R, P).
        theirs: In the second.
        distance: Of every feature (R,), of the same resamples.
        spread: Of every feature, see `spreads`.
    """
    result: dict[str, Tensor] = {}
    for name, unit in FEATURES.items():
        result[f"w1_{name}_{unit}"] = distance[name]
        result[f"w1_{name}"] = distance[name] / (spread[name] or math.nan)
    normalised = torch.stack([result[f"w1_{name}"] for name in FEATURES])
    result["realism"] = normalised.nanmean(0)
    for kind in ("agent_contact", "wall_contact"):
        own = mine @ getattr(crowd, kind).T / (mine @ crowd.minutes).unsqueeze(1)
        excess = own - theirs @ getattr(real, kind).T / (theirs @ real.minutes).unsqueeze(1)
        result[f"{kind}_share"], result[f"{kind}s_per_min"] = own.unbind(1)
        result[f"{kind}_excess"], result[f"{kind}_excess_per_min"] = excess.unbind(1)
    result["speed_std_m_per_s"] = _between(_mean_speeds(crowd), mine)
    (speed, steps), (true, weight) = density_speed(crowd, mine), density_speed(real, theirs)
    both = (steps > 0) & (weight > 0)
    square = ((speed - true).square() * weight).where(both, 0.0).sum(1)
    result["density_speed_rmse_m_per_s"] = (square / weight.where(both, 0.0).sum(1)).sqrt()
    ours, recorded = (
        quantiles(*side.samples["acceleration"], weights, tuple(TAIL.values()))
        for side, weights in ((crowd, mine), (real, theirs))
    )
    for name, own, true in zip(TAIL, ours.T, recorded.T, strict=True):
        result[f"acceleration_{name}_m_per_s2"] = own
        result[f"acceleration_{name}_ratio"] = own / true
    return result


def contact_intervals(
    crowd: CrowdSums, real: CrowdSums, group: Tensor, groups: int
) -> dict[str, Interval | None]:
    """Return the intervals of the numbers of contacts of `compared`, which are rare, over groups of people.

    Differences to the real crowd have none here where fewer than `FEW` people of both touch: a bootstrap
    knows too little then. All others keep theirs.

    Args:
        crowd: The simulated one.
        real: The recorded one.
        group: Which group each person of the first is in (P,) long.
        groups: How many there are.
    """
    result: dict[str, Interval | None] = {}
    for kind in ("agent_contact", "wall_contact"):
        share, begun = (sums(group, row, groups) for row in getattr(crowd, kind))
        minutes = sums(group, crowd.minutes, groups)
        result[f"{kind}_share"] = ratio_interval(share, minutes, part=True)
        result[f"{kind}s_per_min"] = ratio_interval(begun, minutes)
        if sum(int((getattr(side, kind)[0] > 0).sum()) for side in (crowd, real)) < FEW:
            result |= {f"{kind}_excess": None, f"{kind}_excess_per_min": None}
    return result


def density_speed(crowd: CrowdSums, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean speed (R, C) at every density, m/s, NaN for a density without people, and the steps.

    The density is that of the circle of 2 m around a person, see `densities`, with a bin for every number of
    others in it. Real and simulated people are counted alike: people outside the camera's view lower both. In
    the RMSE of two curves a density weighs as much as it occurs in the real crowd. Densities that only one
    crowd has do not count. ``weights`` (R, P): how often each person counts.
    """
    steps = weights @ crowd.steps_at
    return weights @ crowd.speeds_at / steps, steps


def densities() -> Tensor:
    """Return the density of every bin (C,), people per square metre, the person at its centre included."""
    return torch.arange(1, MOST_CLOSE + 2) / (math.pi * CLOSE**2)


def _mean_speeds(crowd: CrowdSums) -> Tensor:
    """Return the mean speed of each person in each round (K, P), m/s, NaN where they were not scored."""
    speed, people = crowd.samples["speed"], len(crowd.minutes)
    rounds = int(crowd.round.max()) + 1 if len(crowd.round) else 1
    place = crowd.round * people + speed.person
    total = sums(place, speed.value, rounds * people)
    return (total / torch.bincount(place, minlength=rounds * people)).view(rounds, people)


def _between(value: Tensor, weights: Tensor) -> Tensor:
    """Return the standard deviation between people (R,) of values (K, P), the mean over rounds."""
    there = (~value.isnan()).double()
    value = value.nan_to_num()
    count = weights @ there.T
    mean = weights @ value.T / count
    variance = weights @ value.square().T / count - mean.square()
    return variance.clamp_min(0).sqrt().nanmean(1)


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
