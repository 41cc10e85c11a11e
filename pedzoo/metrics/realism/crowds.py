"""Two crowds of the same people against each other: every number of realism, for many resamples at once.

A crowd is K rounds of P people. R resamples are weights (R, P), see `pedzoo.metrics.realism.distances`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.contacts import begins
from pedzoo.metrics.ratios import Interval, quantiles, ratio_interval
from pedzoo.metrics.realism.distances import Samples, counted, grid, resampled, sums, wasserstein
from pedzoo.metrics.realism.features import CLOSE, FEATURES, SampledRollout, Surroundings, features
from pedzoo.metrics.smoothness import STANDS
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
    """Sums over the walks of P people in K rounds."""

    samples: dict[str, Samples]  # of every feature
    minutes: Tensor  # for how long each person was on the way (P,)
    agent_contact: Tensor  # minutes in contact with another person, and contacts that began (2, P)
    wall_contact: Tensor
    round: Tensor  # in which each sample of speed was taken (N,) long
    speeds_at: Tensor  # sums of speeds (P, C) by the number of others within `CLOSE`, m/s
    steps_at: Tensor  # how many steps these are (P, C)


def ratios(sums: Tensor, weights: Tensor) -> Tensor:
    """Return the ratio (R,) of two sums over people (2, P), for weights (R, P); NaN of nothing."""
    above, below = (weights.double() @ sums.T).unbind(1)
    return above / below


def crowd(
    rollout: Rollout,
    steps: SampledRollout,
    around: Surroundings,
    first: int,
    scenes: int,
    start: Tensor,
    goal: Tensor,
) -> CrowdSums:
    """Return the crowd of a rollout, episodes ``first``, ... of a replay with so many ``scenes`` in a round.

    The line of each person is from ``start`` to ``goal`` (P, 2), metres.
    """
    people, underway = len(start), rollout.underway
    place = around.close.clamp(max=MOST_CLOSE) + (MOST_CLOSE + 1) * steps.person[steps.scored]
    speed = steps.velocity[steps.scored].norm(dim=1)
    speeds, counts = (
        sums(place, value, people * (MOST_CLOSE + 1)).view(people, -1)
        for value in (speed, torch.ones_like(speed))
    )

    def points(when: Tensor) -> Tensor:
        return torch.bincount(rollout.person[when], minlength=people).double()

    agents, walls = (
        torch.stack((points(when & underway) * MINUTES, points(begins(when & underway))))
        for when in (rollout.agent_contact, rollout.wall_contact)
    )
    rounds = (steps.scored.nonzero()[:, 0] + first) // scenes
    samples = features(steps, around, start, goal)
    return CrowdSums(samples, points(underway) * MINUTES, agents, walls, rounds, speeds, counts)


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


def spread(samples: Samples) -> float:
    """Return the standard deviation of a feature, the unit of its distances; NaN of fewer than two."""
    return float(samples.value.double().std()) if len(samples.value) > 1 else math.nan


def distance(first: Samples, second: Samples, mine: Tensor, theirs: Tensor, exact: bool) -> Tensor:
    """Return the Wasserstein-1 distance of a feature (R,) for weights (R, P) and (R, Q), NaN without samples.

    ``exact``: the first weights count each person once, and no grid is needed.
    """
    if not (len(first.value) and len(second.value)):
        return torch.full((len(mine),), torch.nan, dtype=torch.float64)
    edges = grid(first.value, second.value)
    ours, real = counted(first, edges, mine.shape[1]), counted(second, edges, theirs.shape[1])
    result = resampled(ours, real, edges, mine, theirs)
    if exact:
        result[0] = wasserstein(first.value.double(), second.value.double())
    return result


def compared(
    crowd: CrowdSums, real: CrowdSums, mine: Tensor, theirs: Tensor, exact: bool = True
) -> dict[str, Tensor]:
    """Return every number of a crowd beside the real one, for weights (R, P) of both; (R,), NaN for none.

    * ``w1_speed_m_per_s``, ...: Wasserstein-1 distances; ``w1_speed``, ...: by the real crowd's standard
      deviation; ``realism``: the mean of the latter. Lower is better.
    * ``agent_contact_share``: of the time; ``agent_contacts_per_min``: contacts that begin. ``..._excess``:
      less those of the real crowd, where friends touch. The same of ``wall_contact``.
    * ``speed_std_m_per_s``: between people, of their mean speeds.
    * ``density_speed_rmse_m_per_s``: of the curves of `density_speed`, weighted by the real crowd's steps.
    * ``acceleration_p95_m_per_s2``, ``acceleration_p99_m_per_s2``: quantiles of all samples; with ``_ratio``
      instead of the unit divided by those of the real crowd.

    ``exact``: the first weights count each person once.
    """
    result: dict[str, Tensor] = {}
    for name, unit in FEATURES.items():
        one, other = crowd.samples[name], real.samples[name]
        result[f"w1_{name}_{unit}"] = distance(one, other, mine, theirs, exact)
        result[f"w1_{name}"] = result[f"w1_{name}_{unit}"] / (spread(other) or math.nan)
    result["realism"] = torch.stack([result[f"w1_{name}"] for name in FEATURES]).nanmean(0)
    for kind in ("agent_contact", "wall_contact"):
        own = mine @ getattr(crowd, kind).T / (mine @ crowd.minutes).unsqueeze(1)
        excess = own - theirs @ getattr(real, kind).T / (theirs @ real.minutes).unsqueeze(1)
        result[f"{kind}_share"], result[f"{kind}s_per_min"] = own.unbind(1)
        result[f"{kind}_excess"], result[f"{kind}_excess_per_min"] = excess.unbind(1)
    result["speed_std_m_per_s"] = _speed_spread(crowd, mine)
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
    """Return the intervals of contacts, which are rare, as of `compared`, over groups of people.

    Differences to the real crowd have none where fewer than `FEW` people of both touch. ``group`` (P,) long
    is which of the ``groups`` each person of the first crowd is in.
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
    """Return the mean speed (R, C) at each of the `densities`, m/s, NaN without people, and the steps.

    The density is that of the circle of 2 m around a person. ``weights`` (R, P): how often each one counts.
    """
    steps = weights @ crowd.steps_at
    return weights @ crowd.speeds_at / steps, steps


def densities() -> Tensor:
    """Return the density of every bin (C,), people per square metre, the person at its centre included."""
    return torch.arange(1, MOST_CLOSE + 2) / (math.pi * CLOSE**2)


def _speed_spread(crowd: CrowdSums, weights: Tensor) -> Tensor:
    """Return the standard deviation between people (R,) of their mean speeds in a round, mean over rounds."""
    speed, people = crowd.samples["speed"], len(crowd.minutes)
    rounds = int(crowd.round.max()) + 1 if len(crowd.round) else 1
    place = crowd.round * people + speed.person
    steps = torch.bincount(place, minlength=rounds * people)
    value = (sums(place, speed.value, rounds * people) / steps).view(rounds, people)
    there, value = (~value.isnan()).double(), value.nan_to_num()
    count = weights @ there.T
    mean = weights @ value.T / count
    variance = weights @ value.square().T / count - mean.square()
    return variance.clamp_min(0).sqrt().nanmean(1)


def measured(steps: SampledRollout, people: int, axis: Tensor) -> dict[str, Tensor]:
    """Return two sums (2, P) of one rollout for each measure, which is their ratio; by names of columns.

    * ``standing_share``: of scored steps, those slower than 0.1 m/s.
    * ``company_share``: those with a companion, a person within 1.5 m in each of the last 8 steps (2.8 s)
      whose relative place has changed by less than 0.5 m meanwhile.
    * ``crowdes_collision``: those with a person nearer than 0.2 m.
    * ``lane_order``: see `lane_order`, for the ``axis`` (2,) along which most people walk.
    """
    size = max(1, _AT_ONCE // (steps.person.shape[1] ** 2 * steps.person.shape[2]))
    some = (SampledRollout(*part) for part in zip(*(value.split(size) for value in steps), strict=True))
    return added([_measured(part, people, axis) for part in some])


def added(parts: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Return the sums of several rollouts of the same people."""
    return {name: torch.stack([part[name] for part in parts]).sum(0) for name in parts[0]}


def _measured(steps: SampledRollout, people: int, axis: Tensor) -> dict[str, Tensor]:
    """Return the measures of a few episodes E; pairs are (E, S, A, A)."""
    scored, person = steps.scored, steps.person[steps.scored]
    whole = sums(person, torch.ones(len(person)), people)
    xy, here = steps.xy.transpose(1, 2), (steps.person >= 0).transpose(1, 2)
    apart = xy.unsqueeze(2) - xy.unsqueeze(3)
    pairs = here.unsqueeze(2) & here.unsqueeze(3) & ~torch.eye(here.shape[2], dtype=torch.bool)
    distance = apart.norm(dim=4).masked_fill(~pairs, torch.inf)
    company = torch.zeros(distance.shape[:3], dtype=torch.bool)
    if distance.shape[1] >= TOGETHER:
        slots, last = steps.person.transpose(1, 2), TOGETHER - 1
        # no other person was in their slots meanwhile
        same = (slots.unfold(1, TOGETHER, 1) == slots[:, last:].unsqueeze(-1)).all(-1)
        near = (distance <= NEAR).unfold(1, TOGETHER, 1).all(-1)
        drift = (apart[:, last:] - apart[:, :-last]).norm(dim=4)
        both = same.unsqueeze(2) & same.unsqueeze(3)
        company[:, last:] = (both & near & (drift < DRIFT)).any(3)
    shares = {
        "standing_share": steps.velocity.norm(dim=3) < STANDS,
        "company_share": company.transpose(1, 2),
        "crowdes_collision": (distance < TOUCHING).any(3).transpose(1, 2),
    }
    result = {name: (sums(person, when[scored], people), whole) for name, when in shares.items()}
    result["lane_order"] = lane_order(steps, pairs, axis, people)
    return {name: torch.stack(both) for name, both in result.items()}


def lane_order(steps: SampledRollout, pairs: Tensor, axis: Tensor, people: int) -> tuple[Tensor, Tensor]:
    """Return how far walkers are sorted into lanes: 0 as in a mixed crowd, 1 if no strip has both ways.

    Strips of 0.6 m lie along the unit vector ``axis`` (2,). Of all ``pairs`` (E, S, A, A) bool who walk in
    one strip at a moment, s walk the same way; of all pairs of that moment, m do. The order is
    ``sum(s - m) / sum(1 - m)``. A crowd that walks one way has none.
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
    return sums(person, above[walks], people), sums(person, below[walks], people)


def main_axis(start: Tensor, goal: Tensor) -> Tensor:
    """Return the unit vector (2,) along which most people walk, either way, from ends of walks (P, 2)."""
    way = (goal - start).double()
    angle = 2 * torch.atan2(way[:, 1], way[:, 0])
    weight = way.norm(dim=1)
    half = torch.atan2((weight * angle.sin()).sum(), (weight * angle.cos()).sum()) / 2
    return torch.stack((half.cos(), half.sin())).float()
