"""Measures of crowds that are the recorded people: how far they get from themselves and from companions.

K rounds of P people, R resamples.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.eval.scoring.crowds import ScoredCrowd
from pedzoo.metrics.realism.crowdes import ScoredSteps
from pedzoo.metrics.realism.distances import sums
from pedzoo.metrics.realism.paths import closed_loop_error, padded
from pedzoo.metrics.realism.walks import person_mean
from pedzoo.sim.replay.companions import NEAR, TOGETHER


def same_people(side: ScoredCrowd, real: ScoredCrowd, weights: Tensor) -> dict[str, Tensor]:
    """Return the measures (R,), for weights of the side's people (R, P); none if all are strangers.

    * ``closed_loop_ade_m``: mean distance to where the person really was at that time, until either arrives;
      mean over people. ``closed_loop_min_ade_K_m``: of each person's best of K rounds.
    * ``companions_near_share``: of the steps in which recorded companions are both there, those within 1.5 m
      of each other. `companions` says who they are.
    """
    known = side.twin >= 0
    if not known.any() or not len(side.walks.round):
        return {}
    true, length = padded(real.walks.xy, real.walks.person, len(real.seen))
    walk = side.walks.round * len(side.twin) + side.walks.person
    rounds = int(side.walks.round.max()) + 1
    xy, points = padded(side.walks.xy, walk, rounds * len(side.twin))
    twin = side.twin.clamp_min(0).repeat(rounds)
    shared = torch.minimum(points, length[twin])
    error = closed_loop_error(xy, true[twin], shared).view(rounds, -1)
    error[:, ~known] = torch.nan
    result = {"closed_loop_ade_m": person_mean(error.nanmean(0), weights)}
    if rounds > 1:
        best = error.nan_to_num(torch.inf).amin(0)
        best = best.where(best.isfinite(), torch.nan)
        result[f"closed_loop_min_ade_{rounds}_m"] = person_mean(best, weights)
    if len(pairs := companions(real.walks)):
        result["companions_near_share"] = _near(side, pairs, weights)
    return result


def companions(real: ScoredSteps) -> Tensor:
    """Return the pairs of recorded people who keep company (Q, 2) long.

    They are within 1.5 m of each other in at least 8 steps, and in four of five steps that they share.
    """
    pair, near, count = _pairs(real)
    both = torch.stack((near, count), 1)
    return pair[(both[:, 0] >= TOGETHER) & (both[:, 0] >= 0.8 * both[:, 1])]


def _pairs(walks: ScoredSteps) -> tuple[Tensor, Tensor, Tensor]:
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


def _near(side: ScoredCrowd, pairs: Tensor, weights: Tensor) -> Tensor:
    """Return ``companions_near_share`` (R,); each pair counts for both of its people."""
    own = torch.full((int(pairs.max()) + 1,), -1)
    known = side.twin >= 0
    fits = known & (side.twin <= int(pairs.max()))
    own[side.twin[fits]] = fits.nonzero()[:, 0]
    mine = own[pairs]
    mine = mine[(mine >= 0).all(1)].sort(1).values
    above = torch.zeros(len(side.twin), dtype=torch.float64)
    below = above.clone()
    for number in side.walks.round.unique().tolist():
        pair, near, count = _pairs(ScoredSteps(*(value[side.walks.round == number] for value in side.walks)))
        size = len(side.twin)
        chosen = torch.isin(pair[:, 0] * size + pair[:, 1], mine[:, 0] * size + mine[:, 1])
        for end in (0, 1):
            above.index_add_(0, pair[chosen, end], near[chosen])
            below.index_add_(0, pair[chosen, end], count[chosen].double())
    return weights @ above / (weights @ below)
