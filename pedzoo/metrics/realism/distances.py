"""Distributions of two crowds against each other: Wasserstein distances that can be resampled by people.

P people with N samples of a feature in all. Samples of one person are alike, so intervals come from drawing
*people*, each with all of their samples: R resamples are R rows of weights (R, P), how often each person was
drawn. Distances of all resamples at once are taken on a grid; the one that is reported is exact.
"""

from typing import NamedTuple

import numpy as np
import torch
from scipy.stats import wasserstein_distance
from torch import Tensor

EDGES = 512
"""Points at which distributions are compared while they are resampled; half of them follow the samples."""


class Samples(NamedTuple):
    """Values of a feature.

    Attributes:
        value: (N,) float64.
        person: Person of each value (N,) long, 0 to P - 1.
    """

    value: Tensor
    person: Tensor


class CumulativeCounts(NamedTuple):
    """Number of each person's samples below some edges: all that resampling needs.

    Attributes:
        until: Samples up to each edge, itself included (P, G) float64.
        before: Without it (P, G).
    """

    until: Tensor
    before: Tensor


def sums(place: Tensor, value: Tensor, size: int) -> Tensor:
    """Return the sums (size,) float64 of values (N,) by place (N,); of none `bincount` has whole numbers."""
    return torch.zeros(size, dtype=torch.float64).index_add_(0, place, value.double())


def wasserstein(first: Tensor, second: Tensor) -> float:
    """Return the Wasserstein-1 distance of two sets of values (N,) and (M,), in their unit; NaN of none.

    The area between the two cumulative distributions (Villani, "Optimal Transport", 2009, 2.18): how far
    a value has to be moved on average to make one set out of the other.
    """
    if not len(first) or not len(second):
        return float("nan")
    return float(wasserstein_distance(first.numpy(), second.numpy()))


def grid(first: Tensor, second: Tensor, size: int = EDGES) -> Tensor:
    """Return edges (G,), G at most ``size``, float64, increasing, from the least value to the largest.

    A quarter are evenly spaced over the range (they bound the error in tails), the others at even ranks of
    the first (N,) and of the second values (M,). All values are edges where there are not more, which is
    exact.
    """
    values = torch.cat((first, second)).double().unique()
    if len(values) <= size:
        return values
    even = np.linspace(float(values[0]), float(values[-1]), size // 4)
    ranks = np.linspace(0, 1, (size - len(even)) // 2)
    of_ranks = [np.quantile(side.numpy(), ranks, method="inverted_cdf") for side in (first, second)]
    return torch.from_numpy(np.unique(np.concatenate((even, *of_ranks)))).double()


def counted(samples: Samples, edges: Tensor, people: int) -> CumulativeCounts:
    """Return how many samples of each of P ``people`` lie below ``edges`` (G,), and on them.

    Raises:
        ValueError: A value lies beyond the last edge.
    """
    if len(samples.value) and float(samples.value.max()) > float(edges[-1]):
        raise ValueError(f"a value of {float(samples.value.max())} lies beyond the last edge {edges[-1]:g}")
    shape, result = (people, len(edges) + 1), []
    for right in (False, True):  # the first edge that is not below the value; the first above it
        place = torch.searchsorted(edges, samples.value.double(), right=right)
        each = torch.bincount(samples.person * shape[1] + place, minlength=shape[0] * shape[1])
        result.append(each.view(shape)[:, :-1].cumsum(1).double())
    return CumulativeCounts(*result)


def resampled(
    first: CumulativeCounts, second: CumulativeCounts, edges: Tensor, mine: Tensor, theirs: Tensor
) -> Tensor:
    """Return the Wasserstein-1 distance (R,) of two crowds in every resample, NaN where one is empty.

    Between two edges the cumulative distributions are taken to differ evenly. The error is at most the larger
    crowd's share between them. ``mine`` and ``theirs`` (R, P): how often each person counts.
    """
    until = _shares(first.until, first.until, mine) - _shares(second.until, second.until, theirs)
    before = _shares(first.before, first.until, mine) - _shares(second.before, second.until, theirs)
    return (until[:, :-1].abs() + before[:, 1:].abs()) @ edges.diff() / 2


def drawn_people(people: int, resamples: int = 2000, seed: int = 0) -> Tensor:
    """Return how often each person is drawn (R, P), float64: P of P with replacement, R times."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randint(people, (resamples, people), generator=generator)
    return torch.zeros(resamples, people, dtype=torch.float64).scatter_add_(
        1, chosen, torch.ones_like(chosen).double()
    )


def halves(people: int, splits: int = 200) -> Tensor:
    """Return which people are in the first half of a crowd (R, P), 1 or 0, split at random R times."""
    generator = torch.Generator().manual_seed(0)
    rank = torch.rand(splits, people, generator=generator).argsort(1)
    return torch.zeros(splits, people, dtype=torch.float64).scatter_(1, rank[:, : people // 2], 1.0)


def _shares(part: Tensor, whole: Tensor, weights: Tensor) -> Tensor:
    """Return shares (R, G) of the weighted samples; NaN where no person that was drawn has any."""
    return weights @ part / (weights @ whole[:, -1:])
