"""The columns of CrowdES, for walks that are sampled every 0.4 s, in metres.

Bae et al., "Continuous Locomotive Crowd Behavior Generation", CVPR 2025. A scene is the rectangle of the real
crowd's places. With people of one kind its column "frequency" equals "coverage", and is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.compiled import jit
from pedzoo.core.errors import need
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.realism.distances import sums, wasserstein

QUADRATS = 10
"""On each side of the scene."""


class ScoredSteps(NamedTuple):
    """Scored steps of people, in the order of time for each.

    Attributes:
        round: (N,) long.
        person: (N,) long.
        frame: Steps of 0.4 s (N,) long, on one clock.
        xy: (N, 2), metres.
    """

    round: Tensor
    person: Tensor
    frame: Tensor
    xy: Tensor


def columns(mine: ScoredSteps, real: ScoredSteps) -> dict[str, float]:
    """Return the columns, of several rounds their means; NaN where a crowd has no walk of three steps.

    ``crowdes_density``, ``crowdes_coverage``, ``crowdes_population``, ``crowdes_kinematics`` and
    ``crowdes_dtw``: lower is better. ``crowdes_diversity``: higher is better.
    """
    need("fast", "a score of realism")
    rounds = [
        _columns(ScoredSteps(*(value[mine.round == number] for value in mine)), real)
        for number in mine.round.unique().tolist()
    ]
    names = dict.fromkeys(name for one in rounds for name in one)
    return {name: float(np.mean([one[name] for one in rounds])) for name in names}


def _columns(mine: ScoredSteps, real: ScoredSteps) -> dict[str, float]:
    low, high = real.xy.amin(0), real.xy.amax(0)
    steps = int(real.frame.max() - real.frame.min()) + 1
    (density, coverage), (true, covered) = (_quadrats(side, low, high, steps) for side in (mine, real))
    population, people = (side.frame.unique(return_counts=True)[1].double() for side in (mine, real))
    kinematics = [
        wasserstein(*(value / others.mean().clamp_min(1e-9) for value in (own, others)))
        for own, others in zip(_of_walks(mine), _of_walks(real), strict=True)
    ]
    warped = torch.from_numpy(_all_dtw(*_flat(mine), *_flat(real)))
    ways = [(warped.amin(dim).mean(), warped.argmin(dim).unique(), warped.shape[dim]) for dim in (0, 1)]
    return {
        "crowdes_density": wasserstein(density, true),
        "crowdes_coverage": wasserstein(coverage, covered),
        "crowdes_population": wasserstein(population / people.mean(), people / people.mean()),
        "crowdes_kinematics": float(np.mean(kinematics)),
        "crowdes_dtw": float(sum(least for least, _, _ in ways)) / 2 * STEP_SECONDS,
        "crowdes_diversity": sum(len(chosen) / count for _, chosen, count in ways) / 2,
    }


def _quadrats(side: ScoredSteps, low: Tensor, high: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Return people and occupied quadrats at every step (S,), divided by the number of quadrats."""
    place = ((side.xy - low) / (high - low).clamp_min(1e-9) * QUADRATS).long().clamp(0, QUADRATS - 1)
    frame, at = side.frame.unique(return_inverse=True)
    counts = torch.zeros(max(steps, len(frame)), QUADRATS**2)
    index = at * QUADRATS**2 + place[:, 0] * QUADRATS + place[:, 1]
    counts.view(-1).index_add_(0, index, torch.ones(len(index)))
    return counts.sum(1) / QUADRATS**2, (counts > 0).sum(1) / QUADRATS**2


def _of_walks(side: ScoredSteps) -> tuple[Tensor, ...]:
    """Return distance, mean speed, mean change of it and duration of the walks of three steps and more."""
    person, where = side.person.unique(return_inverse=True)
    order = torch.argsort(where, stable=True)
    xy, where = side.xy[order].double(), where[order]
    moved = where[1:] == where[:-1]
    step = xy.diff(dim=0)
    change = step.diff(dim=0).norm(dim=1)
    turned = moved[1:] & moved[:-1]
    count = len(person)

    def of(value: Tensor, which: Tensor, owner: Tensor) -> tuple[Tensor, Tensor]:
        return sums(owner[which], value[which], count), torch.bincount(owner[which], minlength=count)

    way, steps = of(step.norm(dim=1), moved, where[1:])
    bend, bends = of(change, turned, where[2:])
    long = bends > 0
    way, steps, bend, bends = (value[long] for value in (way, steps, bend, bends))
    return way, way / steps, bend / bends, steps.double()


def _flat(side: ScoredSteps) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (N, 2) walk after walk, and where each walk begins (W + 1,)."""
    _, where = side.person.unique(return_inverse=True)
    order = torch.argsort(where, stable=True)
    begin = torch.cat((torch.zeros(1, dtype=torch.long), torch.bincount(where).cumsum(0)))
    return side.xy[order].double().numpy(), begin.numpy()


@jit
def _all_dtw(first, begin, second, start):
    """Return the dynamic time warping distance of all pairs of walks (W, V): root of the sum of squares."""
    walks, others = len(begin) - 1, len(start) - 1
    result = np.zeros((walks, others))
    longest = 0
    for other in range(others):
        longest = max(longest, start[other + 1] - start[other])
    for walk in range(walks):
        for other in range(others):
            last = np.full(longest + 1, np.inf)
            last[0] = 0.0
            for row in range(begin[walk], begin[walk + 1]):
                before, last[0] = last[0], np.inf
                for column in range(start[other], start[other + 1]):
                    place = column - start[other] + 1
                    dx = first[row, 0] - second[column, 0]
                    dy = first[row, 1] - second[column, 1]
                    least = min(before, last[place], last[place - 1])
                    before = last[place]
                    last[place] = least + dx * dx + dy * dy
            result[walk, other] = np.sqrt(last[start[other + 1] - start[other]])
    return result
