"""Rows of a score: every measure of a crowd beside the recorded one, with intervals by blocks of time.

P people, R resamples. A resample draws blocks of time with replacement, each with all the people who were
taken over in it. The same people are drawn in both crowds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from pedzoo.eval.scoring.crowds import CrowdView, ScoredCrowd, blocks_of
from pedzoo.metrics.ratios import Interval, drawn_people, percentile_interval, ratio_interval
from pedzoo.metrics.realism.crowds import compared, contact_intervals, only, ratios
from pedzoo.metrics.realism.distances import closed_loop_error, halves, padded, sums
from pedzoo.metrics.realism.features import Clips
from pedzoo.metrics.realism.two_sample import FOLDS, Verdict, auc, nearest_parts, two_sample
from pedzoo.metrics.realism.walks import columns, companions, meetings, person_errors

HALVES = "real halves"
"""The row of one half of the recorded people against the other: what a perfect crowd would score."""

SPLITS, TESTS = 200, 5
"""Random halves of the real crowd, and how many of them a classifier is trained on."""

RESAMPLES = 500
"""Of blocks of time."""

_VIEWS = {"": "fine", "coarse_": "coarse"}
"""Prefix of measures, and the view of a crowd that they are of."""

_ONCE_ONLY = ("_share", "_per_min", "_excess", "speed_std", "density_speed")
"""Measures that coarse positions do not have: contacts come from the paths themselves."""

Weights = tuple[Tensor, Tensor]
"""Of two crowds' people (1 + R, P) each: the first row counts each once, the others are resamples."""


def row(side: ScoredCrowd, real: ScoredCrowd, more: Mapping[str, Tensor], windows: int = 0) -> dict[str, Any]:
    """Return a crowd's row beside the recorded one; ``more`` are values (1 + R,) of resampled ``windows``."""
    drawn, block, blocks = _drawn(side, real)
    values, telling = {}, {}
    for prefix, name in _VIEWS.items():
        mine, theirs = getattr(side, name), getattr(real, name)
        values |= _of_view(mine, theirs, drawn, prefix)
        verdict = _verdict(side, real, mine.clips, theirs.clips)
        values[f"{prefix}classifier_auc"] = auc(verdict, *drawn)
        telling[f"{prefix}classifier_auc"] = verdict.telling
    values |= {name: ratios(both, drawn[0]) for name, both in side.sums.items()}
    values |= {**same_people(side, real, drawn[0]), **more}
    exact = {name: percentile_interval(value[1:], windows) for name, value in more.items()}
    exact |= _exact(side, real, block, blocks)
    values |= {name: torch.tensor([value]) for name, value in columns(side.walks, real.walks).items()}
    row = values_row(side.name, int(side.seen.sum()), side.rounds, values, blocks, exact)
    return row | {"telling": telling}


def real_rows(real: ScoredCrowd) -> list[dict[str, Any]]:
    """Return the recorded crowd's own row, and that of its halves against each other.

    A policy's people are judged beside themselves, and halves are of different people: the bound can be
    beaten, chiefly in speed, nearest distance and lateral deviation.
    """
    drawn, block, blocks = _drawn(real, real)
    values = _of_view(real.fine, real.fine, drawn, "") | same_people(real, real, drawn[0])
    own = {name: ratios(both, drawn[0]) for name, both in real.sums.items()}
    ours = "_share", "_per_min"
    own |= {key: one for key, one in values.items() if key.endswith(ours) or key.startswith("companions")}
    count, splits, floor = int(real.seen.sum()), split_in_halves(real.seen), {}
    for prefix, name in _VIEWS.items():
        view = getattr(real, name)
        floor |= _of_view(view, view, splits, prefix, exact=False)
        tests = zip(*(half[:TESTS] > 0 for half in splits), strict=True)
        floor[f"{prefix}classifier_auc"] = torch.cat(
            [_halves_auc(view.clips, number, *halves) for number, halves in enumerate(tests)]
        )
    floor |= {name: ratios(both, splits[0]) for name, both in real.sums.items()}
    exact = _exact(real, real, block, blocks)
    return [values_row(real.name, count, 1, own, blocks, exact), halves_row(count, floor)]


def _exact(side: ScoredCrowd, real: ScoredCrowd, block: Tensor, blocks: int) -> dict[str, Interval | None]:
    """Return the intervals of a crowd's contacts and sums, by the block of time of each person (P,)."""
    result = contact_intervals(side.fine.crowd, real.fine.crowd, block, blocks)
    for name, both in side.sums.items():
        result[name] = ratio_interval(*(sums(block, value, blocks) for value in both), part=True)
    return result


def _of_view(
    mine: CrowdView, theirs: CrowdView, drawn: Weights, prefix: str, exact: bool = True
) -> dict[str, Tensor]:
    """Return the numbers of `compared` of a view, with its prefix."""
    real = only(theirs.crowd, theirs.crowd.minutes > 0)
    return {
        f"{prefix}{key}": value
        for key, value in compared(mine.crowd, real, *drawn, exact).items()
        if not (prefix and any(part in key for part in _ONCE_ONLY))
    }


def _verdict(side: ScoredCrowd, real: ScoredCrowd, mine: Clips, theirs: Clips) -> Verdict:
    """Return what the classifiers say; people are split at random, the same people of both sides together."""
    split = _split(len(real.seen), 0)
    own = split[side.twin]
    if (side.twin < 0).any():
        own = torch.where(side.twin >= 0, own, nearest_parts(mine, theirs, split, len(own)))
    return two_sample(mine, theirs, own, split)


def _split(people: int, seed: int) -> Tensor:
    """Return the classifier's part of each person (P,): as many in each, at random."""
    return torch.randperm(people, generator=torch.Generator().manual_seed(seed)) % FOLDS


def _halves_auc(clips: Clips, seed: int, first: Tensor, second: Tensor) -> Tensor:
    """Return the AUC (1,) of classifiers for halves (P,) bool of the people, split at random into parts."""
    parts, weights = _split(len(first), seed), torch.ones(1, len(first))
    mine, theirs = (Clips(*(value[half[clips.person]] for value in clips)) for half in (first, second))
    return auc(two_sample(mine, theirs, parts, parts), weights, weights)


def _drawn(side: ScoredCrowd, real: ScoredCrowd) -> tuple[Weights, Tensor, int]:
    """Return weights of both crowds' people, by resampled blocks of time, and the side's blocks (P,).

    People of the recording have its blocks: there is one clock.
    """
    (own, others), (block, blocks) = blocks_of(side.people), blocks_of(real.people)
    times = theirs = drawn_people(blocks, RESAMPLES)
    if bool((side.twin >= 0).any()):
        own, others = block[side.twin].where(side.twin >= 0, own.clamp_max(blocks - 1)), blocks
    else:
        times = drawn_people(others, RESAMPLES, seed=1)
    first = torch.ones(1, 1, dtype=torch.float64)
    mine, theirs = (
        torch.cat((first.expand(1, len(who)), weights)) * who
        for weights, who in ((times[:, own], side.seen), (theirs[:, block], real.seen))
    )
    return (mine, theirs), own, max(blocks, others)


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
    error = closed_loop_error(xy, true[twin], torch.minimum(points, length[twin])).view(rounds, -1)
    error[:, ~known] = torch.nan
    result = person_errors(error, weights)
    if len(pairs := companions(real.walks)):
        result["companions_near_share"] = _near(side, pairs, weights)
    return result


def _near(side: ScoredCrowd, pairs: Tensor, weights: Tensor) -> Tensor:
    """Return ``companions_near_share`` (R,); each pair counts for both of its people."""
    own, size = torch.full((int(pairs.max()) + 1,), -1), len(side.twin)
    fits = (side.twin >= 0) & (side.twin < len(own))
    own[side.twin[fits]] = fits.nonzero()[:, 0]
    mine = own[pairs]
    mine = mine[(mine >= 0).all(1)].sort(1).values
    above, below = torch.zeros(2, size, dtype=torch.float64)
    for walks in side.walks.rounds():
        pair, near, count = meetings(walks)
        chosen = torch.isin(pair[:, 0] * size + pair[:, 1], mine[:, 0] * size + mine[:, 1])
        for end in (0, 1):
            above.index_add_(0, pair[chosen, end], near[chosen])
            below.index_add_(0, pair[chosen, end], count[chosen].double())
    return weights @ above / (weights @ below)


def weights_of(seen: Tensor, of_seen: Tensor) -> Tensor:
    """Return weights (R, P) of all people, given those (R, N) of the N who were ``seen`` (P,) bool."""
    weights = torch.zeros(len(of_seen), len(seen), dtype=torch.float64)
    weights[:, seen] = of_seen.double()
    return weights


def split_in_halves(seen: Tensor) -> Weights:
    """Return who of those ``seen`` (P,) bool is in either half of `SPLITS` random splits (SPLITS, P)."""
    first = weights_of(seen, halves(int(seen.sum()), SPLITS))
    return first, seen.double() - first


def halves_row(n: int, values: Mapping[str, Tensor]) -> dict[str, Any]:
    """Return the row `HALVES` of values (R,) of splits of ``n`` people: means, and what holds 95 %."""
    means = {key: torch.cat((value.nanmean().view(1), value)) for key, value in values.items()}
    return values_row(HALVES, n, 1, means)


def values_row(
    name: str,
    n: int,
    rounds: int,
    values: Mapping[str, Tensor],
    groups: int | None = None,
    exact: Mapping[str, Interval | None] | None = None,
) -> dict[str, Any]:
    """Return the row of a crowd of ``n`` people who walked ``rounds`` times.

    Of ``values`` (1 + R,) the first is the column's number. The others give its interval, as of
    `percentile_interval`, unless that is one of the ``exact`` ones.
    """
    known = {key: value for key, value in values.items() if not value[0].isnan()}
    found = {key: percentile_interval(value[1:], groups) for key, value in known.items()} | dict(exact or {})
    intervals = {key: ends for key, ends in found.items() if ends and key in known}
    numbers = {key: float(value[0]) for key, value in known.items()}
    return {"name": name, "case": {}, "n": n, "rounds": rounds, "metrics": numbers, "ci95": intervals}
