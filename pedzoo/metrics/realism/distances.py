"""Distances of two crowds: of their distributions, which people resample, and of walk from walk.

P people with N samples of a feature in all. R resamples draw people with all of their samples: weights (R, P)
say how often. Distances of resamples are taken on a grid; the one that is reported is exact.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

EDGES = 512
"""Points at which distributions are compared while they are resampled; half of them follow the samples."""

_AT_ONCE = 4_000_000
"""Pairs of points of walks that are compared at once."""


class Samples(NamedTuple):
    """Values of a feature (N,) float64, and the person of each (N,) long, 0 to P - 1."""

    value: Tensor
    person: Tensor


def sums(place: Tensor, value: Tensor, size: int) -> Tensor:
    """Return the sums (size,) float64 of values (N,) by place (N,); of none `bincount` has whole numbers."""
    return torch.zeros(size, dtype=torch.float64).index_add_(0, place, value.double())


def wasserstein(first: Tensor, second: Tensor) -> Tensor:
    """Return the Wasserstein-1 distance () of two sets of values (N,) and (M,), in their unit; 0 of none.

    It is the area between the two inverse distribution functions (Villani, "Optimal Transport", 2009, 2.18).
    Gradients flow through both.
    """
    m, n = len(first), len(second)
    if not m or not n:
        return first.sum() * 0 + second.sum() * 0
    first, second = first.sort().values, second.sort().values
    if m == n:
        return (first - second).abs().mean()
    # in units of 1 / (m n): where either distribution function has a step
    ends = torch.cat((torch.arange(1, m + 1) * n, torch.arange(1, n) * m)).to(first.device).sort().values
    widths = ends.diff(prepend=ends.new_zeros(1))
    begins = ends - widths
    gap = first[begins // n] - second[begins // m]
    return (gap.abs() * widths).sum() / (m * n)


def grid(first: Tensor, second: Tensor, size: int = EDGES) -> Tensor:
    """Return edges (G,), G at most ``size``, float64, increasing, from the least value to the largest.

    A quarter are evenly spaced, the others at even ranks of the values (N,), (M,). Few values are all edges.
    """
    values = torch.cat((first, second)).double().unique()
    if len(values) <= size:
        return values
    even = np.linspace(float(values[0]), float(values[-1]), size // 4)
    ranks = np.linspace(0, 1, (size - len(even)) // 2)
    of_ranks = [np.quantile(side.numpy(), ranks, method="inverted_cdf") for side in (first, second)]
    return torch.from_numpy(np.unique(np.concatenate((even, *of_ranks)))).double()


def counted(samples: Samples, edges: Tensor, people: int) -> tuple[Tensor, Tensor]:
    """Return each person's samples up to each of ``edges`` (G,), itself included, and before it (P, G)."""
    shape, result = (people, len(edges) + 1), []
    for right in (False, True):  # the first edge that is not below the value; the first above it
        place = torch.searchsorted(edges, samples.value.double(), right=right)
        each = torch.bincount(samples.person * shape[1] + place, minlength=shape[0] * shape[1])
        result.append(each.view(shape)[:, :-1].cumsum(1).double())
    return result[0], result[1]


def resampled(
    first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor], edges: Tensor, mine: Tensor, theirs: Tensor
) -> Tensor:
    """Return the Wasserstein-1 distance (R,) of two crowds, as `counted`, for weights (R, P); NaN of none.

    Between two edges the cumulative distributions are taken to differ evenly.
    """
    until, before = (
        mine @ ours / (mine @ first[0][:, -1:]) - theirs @ real / (theirs @ second[0][:, -1:])
        for ours, real in zip(first, second, strict=True)
    )
    return (until[:, :-1].abs() + before[:, 1:].abs()) @ edges.diff() / 2


def halves(people: int, splits: int = 200) -> Tensor:
    """Return which people are in the first half of a crowd (R, P), 1 or 0, split at random R times."""
    generator = torch.Generator().manual_seed(0)
    rank = torch.rand(splits, people, generator=generator).argsort(1)
    return torch.zeros(splits, people, dtype=torch.float64).scatter_(1, rank[:, : people // 2], 1.0)


def displacement(simulated: Tensor, true: Tensor, known: Tensor) -> Tensor:
    """Return the mean distance of the ``known`` positions (..., S, 2) to the true ones (...), metres."""
    error = (simulated - true).norm(dim=-1).double()
    return error.where(known, 0.0).sum(-1) / known.sum(-1)


def closed_loop_error(walk: Tensor, true: Tensor, shared: Tensor) -> Tensor:
    """Return each walk's mean distance (W,) to the recorded one at the same times, metres; NaN of none.

    Walks (W, L, 2) and (W, M, 2) have ``shared`` (W,) points in common.
    """
    length = min(walk.shape[1], true.shape[1])
    within = torch.arange(length) < shared.unsqueeze(1)
    return displacement(walk[:, :length], true[:, :length], within)


def padded(xy: Tensor, walk: Tensor, walks: int) -> tuple[Tensor, Tensor]:
    """Return all rows (N, D) as walks (W, L, D), zero after each one's end, and their lengths (W,)."""
    length = torch.bincount(walk, minlength=walks)
    if not walks:
        return xy.new_zeros(0, 0, *xy.shape[1:]), length
    parts = [*xy[walk.argsort(stable=True)].split(length.tolist())]
    return pad_sequence(parts, batch_first=True), length


def dtw(
    first: Tensor, points: Tensor, second: Tensor, others: Tensor, pairs: Tensor, squares: bool = False
) -> Tensor:
    """Return the dynamic time warping distance of pairs of walks (Q,), metres; NaN where one has no points.

    This is the symmetric form of Sakoe and Chiba ("Dynamic programming algorithm optimization for spoken word
    recognition", 1978) without a window: a match that goes on in both walks counts twice, and the sum is
    divided by the number of points. The same path at another pace is near 0.

    Walks are (W, L, 2) and (V, M, 2), of so many points (W,) and (V,); ``pairs`` (2, Q) long are one of each.
    With ``squares`` it is the root of the least sum of squares, in which each match counts once.
    """
    mine, theirs = pairs
    result = torch.full((len(mine),), torch.nan, dtype=torch.float64)
    total = points[mine] + others[theirs]
    order = total.argsort()
    order = order[(points[mine] > 0)[order] & (others[theirs] > 0)[order]]
    while len(order):  # walks of about the same length together, from the longest
        some = order[-max(1, _AT_ONCE // int(total[order[-1]]) ** 2) :]
        order = order[: -len(some)]
        one, two = mine[some], theirs[some]
        here, there = (int(count.max()) for count in (points[one], others[two]))
        result[some] = _warped(first[one, :here], points[one], second[two, :there], others[two], squares)
    return result


def _warped(first: Tensor, points: Tensor, second: Tensor, others: Tensor, squares: bool) -> Tensor:
    """Return `dtw` of walks that are compared at once, diagonal after diagonal of their distances."""
    walks, rows, columns = len(first), first.shape[1], second.shape[1]
    wide = rows + columns
    # columns beyond the last one are closed, so that a diagonal may run out of the matrix on either side
    between = torch.full((rows, wide, walks), torch.inf)
    apart = first.permute(1, 2, 0).float().unsqueeze(2) - second.permute(1, 2, 0).float().transpose(0, 1)
    between[:, :columns] = apart.square().sum(1) if squares else torch.hypot(apart[:, 0], apart[:, 1])
    # the cheapest paths to the cells of the last two diagonals, by row; with an entry before the first row
    last, earlier = torch.full((2, rows + 1, walks), torch.inf).unbind(0)
    earlier[0] = 0.0  # the corner before both first points
    result = torch.full((walks,), torch.nan, dtype=torch.float64)
    ends = points + others - 2
    for diagonal in range(wide - 1):
        distance = between.as_strided((rows, walks), ((wide - 1) * walks, 1), diagonal * walks)
        here = torch.full_like(last, torch.inf)
        both = earlier[:-1] if squares else earlier[:-1] + distance
        here[1:] = torch.minimum(both, torch.minimum(last[:-1], last[1:])) + distance
        over = (ends == diagonal).nonzero().view(-1)
        least = here[points[over], over].double()
        result[over] = least.sqrt() if squares else least / (points + others)[over]
        last, earlier = here, last
    return result
