"""Walks of people: beside recorded ones, with companions, through an opening, and by CrowdES's columns.

P people, K rounds of the R scenes of a recording; W walks: one for each person and episode with a policy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.metrics.arrival import stuck
from pedzoo.metrics.door import flow, passing_seconds
from pedzoo.metrics.ratios import quantiles
from pedzoo.metrics.realism.distances import closed_loop_error, dtw, padded, sums, wasserstein
from pedzoo.metrics.realism.features import SampledRollout, every_step
from pedzoo.sim.recorded_people import NEAR, TOGETHER
from pedzoo.sim.rollout import Rollout

QUADRATS = 10
"""On each side of the scene."""

HEADWAYS = {"p5": 0.05, "p50": 0.5, "p95": 0.95}
"""Quantiles of the time between two who follow each other through an opening."""


class ScoredSteps(NamedTuple):
    """N scored steps of people, in the order of time for each: places in metres, frames of 0.4 s."""

    round: Tensor
    person: Tensor
    frame: Tensor
    xy: Tensor

    def rounds(self) -> list[ScoredSteps]:
        """Return the steps of each round."""
        which = [self.round == number for number in self.round.unique().tolist()]
        return [ScoredSteps(*(value[mine] for value in self)) for mine in which]

    def walks(self) -> tuple[Tensor, Tensor]:
        """Return the places of all people with steps as `padded` walks, and their lengths."""
        person, where = self.person.unique(return_inverse=True)
        return padded(self.xy, where, len(person))


class RecordedWalks(NamedTuple):
    """The recorded walks of P people, from where a policy takes over."""

    scene: Tensor  # of each person (P,) long, -1 for people that no policy moves
    seconds: Tensor  # until they are within 0.3 m of their goal (P,), NaN likewise
    xy: Tensor  # positions every 0.4 s (P, L, 2), metres
    points: Tensor  # how many (P,) long


def tracks_of(parts: Sequence[Rollout], people: int) -> RecordedWalks:
    """Return the tracks of a recorded crowd of P ``people``, given as rollouts of scenes 0, 1, ..."""
    scene = torch.full((people,), -1)
    seconds = torch.full((people,), torch.nan, dtype=torch.float64)
    scored, before = [], 0
    for part in parts:
        steps = every_step(part)
        scene[part.person[part.controlled]] = part.controlled.nonzero()[:, 0] + before
        result = _seconds(part, torch.arange(people).expand(len(part.failed), people), people)
        seconds = torch.where(result.isnan(), seconds, result)
        scored.append((steps.xy[steps.scored], steps.person[steps.scored]))
        before += len(part.failed)
    xy, person = (torch.cat(values) for values in zip(*scored, strict=True))
    return RecordedWalks(scene, seconds, *padded(xy, person, people))


def walks_of(
    rollout: Rollout, steps: SampledRollout, first: int, scenes: int, tracks: RecordedWalks
) -> dict[str, Tensor]:
    """Return the walks (W,) of episodes ``first``, ... of a replay; episode i is scene i modulo ``scenes``.

    * ``episode`` and ``person``: long.
    * ``seconds``: from when the policy took over until within 0.3 m of the goal; NaN for never, where
      ``success`` is false. A replay takes out people who need more than twice the recorded time.
    * ``deadlock``: whether the person was once `stuck`, see `pedzoo.metrics.arrival`.
    * ``ade``: mean distance to the recorded positions of the same times, metres; NaN without any.
    * ``dtw``: dynamic time warping distance to the recorded walk, metres; NaN likewise.
    """
    scene = (first + torch.arange(len(rollout.failed))) % scenes
    episode, person = (scene.unsqueeze(1) == tracks.scene).nonzero().unbind(1)
    count = len(person)
    number = torch.full((len(scene), len(tracks.scene)), -1)
    number[episode, person] = torch.arange(count)
    still = stuck(rollout.trace, rollout.goal, rollout.controlled)
    deadlock = torch.zeros(count, dtype=torch.bool)
    deadlock[number[still.nonzero()[:, 0], rollout.person[still]]] = True
    walk = number[steps.scored.nonzero()[:, 0], steps.person[steps.scored]]
    xy, points = padded(steps.xy[steps.scored], walk, count)
    true, others = tracks.xy[person], tracks.points[person]
    seconds = _seconds(rollout, number, count)
    return {
        "episode": episode + first,
        "person": person,
        "success": ~seconds.isnan(),
        "deadlock": deadlock,
        "seconds": seconds,
        "ade": closed_loop_error(xy, true, torch.minimum(points, others)),
        "dtw": dtw(xy, points, true, others, torch.arange(count).expand(2, -1)),
    }


def by_person(walks: Mapping[str, Tensor], scenes: int, people: int) -> dict[str, Tensor]:
    """Return values of `walks_of` as tables (K, P) of rounds of ``scenes``, NaN where there was no walk."""
    rounds, tables = walks["episode"] // scenes, {}
    for name in ("success", "deadlock", "seconds", "ade", "dtw"):
        tables[name] = torch.full((int(rounds.max()) + 1, people), torch.nan, dtype=torch.float64)
        tables[name][rounds, walks["person"]] = walks[name].double()
    return tables


def of_people(tables: Mapping[str, Tensor], real_seconds: Tensor, weights: Tensor) -> dict[str, Tensor]:
    """Return means and medians over people (R,) of `by_person`, for weights (R, P); real seconds are (P,)."""
    walks = weights @ (~tables["success"].isnan()).sum(0).double()
    result = {name: weights @ tables[name].nansum(0) / walks for name in ("success", "deadlock")}
    ratio = (tables["seconds"] / real_seconds).nanmedian(0).values
    (person,) = (~ratio.isnan()).nonzero(as_tuple=True)
    result["time_ratio_median"] = quantiles(ratio[person], person, weights, (0.5,))[:, 0]
    result["dtw_m"] = person_mean(tables["dtw"].nanmean(0), weights)
    return result | person_errors(tables["ade"], weights)


def person_errors(error: Tensor, weights: Tensor) -> dict[str, Tensor]:
    """Return the means over people of errors (K, P), for weights (R, P): of all rounds, and of the best."""
    result = {"closed_loop_ade_m": person_mean(error.nanmean(0), weights)}
    if len(error) > 1:
        best = error.nan_to_num(torch.inf).amin(0)
        best = best.where(best.isfinite(), torch.nan)
        result[f"closed_loop_min_ade_{len(error)}_m"] = person_mean(best, weights)
    return result


def _seconds(rollout: Rollout, number: Tensor, count: int) -> Tensor:
    """Return when people reached their goals (W,), s, NaN for never; ``number`` (E, P) is of their walks."""
    first = []
    for when in (rollout.controlled, rollout.controlled & (rollout.reached > 0)):
        episode, _, point = when.nonzero().unbind(1)
        never = torch.full((count,), torch.nan, dtype=torch.float64)
        walk = number[episode, rollout.person[when]]
        first.append(never.scatter_reduce(0, walk, point.double(), "amin", include_self=False))
    return (first[1] - first[0] + 1) * TRACE_SECONDS


def person_mean(value: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted mean (R,) of the values (P,) that are not NaN."""
    return weights @ value.nan_to_num() / (weights @ (~value.isnan()).double())


def companions(real: ScoredSteps) -> Tensor:
    """Return the pairs (Q, 2) long within 1.5 m in 8 steps or more, and in four of five that they share."""
    pair, near, count = meetings(real)
    both = torch.stack((near, count), 1)
    return pair[(both[:, 0] >= TOGETHER) & (both[:, 0] >= 0.8 * both[:, 1])]


def meetings(walks: ScoredSteps) -> tuple[Tensor, Tensor, Tensor]:
    """Return pairs of people who meet (Q, 2), the steps in which they are near, and all that they share."""
    order = walks.frame.argsort(stable=True)
    person, xy = walks.person[order], walks.xy[order]
    _, present = walks.frame[order].unique_consecutive(return_counts=True)
    most, rows = int(present.max()), torch.arange(len(order))
    moment = torch.arange(len(present)).repeat_interleave(present)
    place = rows - (present.cumsum(0) - present)[moment]
    table = torch.full((len(present), most), -1)
    table[moment, place] = rows
    first, second = torch.triu_indices(most, most, 1)
    one, other = table[:, first].flatten(), table[:, second].flatten()
    there = (one >= 0) & (other >= 0)
    one, other = one[there], other[there]
    ends = torch.stack((person[one], person[other]), 1).sort(1).values
    near = (xy[one] - xy[other]).norm(dim=1) <= NEAR
    pair, which = ends.unique(dim=0, return_inverse=True)
    return pair, sums(which, near, len(pair)), torch.bincount(which, minlength=len(pair))


def through(walks: ScoredSteps, opening: Tensor) -> dict[str, float]:
    """Return how people pass an opening, of several rounds the means; flow and headways of two and more.

    * ``opening_through_share``: share of the scored people who end up on the other side.
    * ``specific_flow_per_m_s``: as of rollouts, see `pedzoo.metrics.door.flow`.
    * ``opening_headway_p5_s``, ``_p50_s``, ``_p95_s``: quantiles of the times between two in a row.

    The ``opening`` (5,) is like a gate in `pedzoo.metrics.door`. People have to be seen behind it.
    """
    return _over_rounds([_through(one, opening) for one in walks.rounds()])


def _over_rounds(rounds: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for one in rounds for name in one)
    return {name: sum(one.get(name, 0.0) for one in rounds) / len(rounds) for name in names}


def _through(walks: ScoredSteps, opening: Tensor) -> dict[str, float]:
    people, who = walks.person.unique(return_inverse=True)
    place, length = padded(torch.cat((walks.xy, walks.frame.unsqueeze(1)), 1).double(), who, len(people))
    there = torch.arange(1, place.shape[1]) < length.unsqueeze(1)
    gate = opening.double().unsqueeze(0)
    at = passing_seconds(place[None, ..., :2], there.unsqueeze(0), gate)[0] / TRACE_SECONDS  # in steps
    (got,) = at.isfinite().nonzero(as_tuple=True)
    step = (at[got].ceil().long() - 1).clamp(0, place.shape[1] - 2)
    frame, after = place[got, step, 2], place[got, step + 1, 2]
    passed = (frame + (at[got] - step) * (after - frame)).sort().values * STEP_SECONDS
    result = {"opening_through_share": len(passed) / len(people)}
    if len(passed) > 1 and passed[-1] > passed[0]:
        number, room = flow(passed.unsqueeze(0), gate)
        result["specific_flow_per_m_s"] = float(number / room)
        for name, share in HEADWAYS.items():
            result[f"opening_headway_{name}_s"] = float(passed.diff().quantile(share))
    return result


def columns(mine: ScoredSteps, real: ScoredSteps) -> dict[str, float]:
    """Return the columns of CrowdES, means over rounds; NaN where a crowd has no walk of three steps.

    Bae et al., "Continuous Locomotive Crowd Behavior Generation", CVPR 2025. A scene is the rectangle of the
    real crowd's places. With people of one kind its column "frequency" equals "coverage", and is left out.
    Lower is better, but for ``crowdes_diversity``.
    """
    return _over_rounds([_columns(one, real) for one in mine.rounds()])


def _columns(mine: ScoredSteps, real: ScoredSteps) -> dict[str, float]:
    low, high = real.xy.amin(0), real.xy.amax(0)
    steps = int(real.frame.max() - real.frame.min()) + 1
    (density, coverage), (true, covered) = (_quadrats(side, low, high, steps) for side in (mine, real))
    population, people = (side.frame.unique(return_counts=True)[1].double() for side in (mine, real))
    (xy, points), (true_xy, others) = mine.walks(), real.walks()
    kinematics = [
        wasserstein(*(value / theirs.mean().clamp_min(1e-9) for value in (own, theirs)))
        if len(own) and len(theirs)
        else torch.nan
        for own, theirs in zip(_of_walks(xy, points), _of_walks(true_xy, others), strict=True)
    ]
    every = torch.cartesian_prod(torch.arange(len(points)), torch.arange(len(others))).T
    warped = dtw(xy, points, true_xy, others, every, squares=True).view(len(points), len(others))
    ways = [(warped.amin(dim).mean(), warped.argmin(dim).unique(), warped.shape[dim]) for dim in (0, 1)]
    return {
        "crowdes_density": float(wasserstein(density, true)),
        "crowdes_coverage": float(wasserstein(coverage, covered)),
        "crowdes_population": float(wasserstein(population / people.mean(), people / people.mean())),
        "crowdes_kinematics": float(sum(kinematics)) / len(kinematics),
        "crowdes_dtw": float(sum(least for least, _, _ in ways)) / 2 * STEP_SECONDS,
        "crowdes_diversity": sum(len(chosen) / count for _, chosen, count in ways) / 2,
    }


def _quadrats(side: ScoredSteps, low: Tensor, high: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Return people and occupied quadrats at every step (S,), divided by the number of quadrats."""
    place = ((side.xy - low) / (high - low).clamp_min(1e-9) * QUADRATS).long().clamp(0, QUADRATS - 1)
    frame, at = side.frame.unique(return_inverse=True)
    counts = torch.zeros(max(steps, len(frame)), QUADRATS**2, dtype=torch.float64)
    index = at * QUADRATS**2 + place[:, 0] * QUADRATS + place[:, 1]
    counts.view(-1).index_add_(0, index, torch.ones(len(index)).double())
    return counts.sum(1) / QUADRATS**2, (counts > 0).sum(1) / QUADRATS**2


def _of_walks(xy: Tensor, points: Tensor) -> tuple[Tensor, ...]:
    """Return distance, mean speed, mean change of it and duration of the walks of three steps and more."""
    xy, points = xy[points > 2].double(), points[points > 2]
    inside = torch.arange(1, xy.shape[1]) < points.unsqueeze(1)
    step = xy.diff(dim=1)
    way = step.norm(dim=2).where(inside, 0.0).sum(1)
    bend = step.diff(dim=1).norm(dim=2).where(inside[:, 1:], 0.0).sum(1)
    return way, way / (points - 1), bend / (points - 2), (points - 1).double()
