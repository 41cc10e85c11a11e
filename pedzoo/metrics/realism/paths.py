"""Simulated walks against the recorded ones of the same people: displacement and dynamic time warping."""

import torch
from torch import Tensor

_AT_ONCE = 4_000_000
"""Pairs of points that are compared at once."""


def closed_loop_error(walk: Tensor, true: Tensor, shared: Tensor) -> Tensor:
    """Return each walk's mean distance (W,) to the recorded one at the same times, metres; NaN of none.

    Nothing is ever set back to the recording: errors add up, as they do not in a forecast. Walks (W, L, 2)
    and (W, M, 2) have ``shared`` (W,) points in common.
    """
    length = min(walk.shape[1], true.shape[1])
    error = (walk[:, :length] - true[:, :length]).norm(dim=-1).double()
    within = torch.arange(length) < shared.unsqueeze(1)
    return error.where(within, 0.0).sum(1) / shared


def padded(xy: Tensor, walk: Tensor, walks: int) -> tuple[Tensor, Tensor]:
    """Return all positions (N, 2) as walks (W, L, 2), zero after each one's end, and their lengths (W,)."""
    length = torch.bincount(walk, minlength=walks)
    order = walk.argsort(stable=True)
    first = length.cumsum(0) - length
    place = torch.arange(len(walk)) - first[walk[order]]
    result = xy.new_zeros(walks, int(length.max()) if walks else 0, 2)
    result[walk[order], place] = xy[order]
    return result, length


def dtw(first: Tensor, points: Tensor, second: Tensor, others: Tensor) -> Tensor:
    """Return the dynamic time warping distance of pairs of walks (W,), metres; NaN where one has no points.

    Points are matched in order, each at least once, so that the sum of distances is least. A match that goes
    on in both walks counts twice: all weights add up to the number of points, by which the sum is divided.
    This is the symmetric form of Sakoe and Chiba ("Dynamic programming algorithm optimization for spoken word
    recognition", 1978) without a window. The same path at another pace is near 0. Walks (W, L, 2) have
    ``points`` (W,), the others (W, M, 2) ``others`` (W,).
    """
    result = torch.full((len(first),), torch.nan, dtype=torch.float64)
    order = (points + others).argsort()
    order = order[(points > 0)[order] & (others > 0)[order]]
    while len(order):  # walks of about the same length together, from the longest
        longest = int((points + others)[order[-1]])
        some = order[-max(1, _AT_ONCE // longest**2) :]
        order = order[: -len(some)]
        here, there = (int(count[some].max()) for count in (points, others))
        result[some] = _warped(first[some, :here], points[some], second[some, :there], others[some])
    return result


def _warped(first: Tensor, points: Tensor, second: Tensor, others: Tensor) -> Tensor:
    """Return `dtw` of walks that are compared at once, diagonal after diagonal of their distances."""
    walks, rows, columns = len(first), first.shape[1], second.shape[1]
    wide = rows + columns
    # columns beyond the last one are closed, so that a diagonal may run out of the matrix on either side
    between = torch.full((rows, wide, walks), torch.inf)
    apart = first.permute(1, 2, 0).float().unsqueeze(2) - second.permute(1, 2, 0).float().transpose(0, 1)
    between[:, :columns] = torch.hypot(apart[:, 0], apart[:, 1])
    # the cheapest paths to the cells of the last two diagonals, by row; with an entry before the first row
    last, earlier = torch.full((2, rows + 1, walks), torch.inf).unbind(0)
    earlier[0] = 0.0  # the corner before both first points
    result = torch.full((walks,), torch.nan, dtype=torch.float64)
    ends = points + others - 2
    for diagonal in range(wide - 1):
        distance = between.as_strided((rows, walks), ((wide - 1) * walks, 1), diagonal * walks)
        here = torch.full_like(last, torch.inf)
        here[1:] = torch.minimum(earlier[:-1] + distance, torch.minimum(last[:-1], last[1:])) + distance
        over = (ends == diagonal).nonzero().view(-1)
        result[over] = here[points[over], over].double() / (points + others)[over]
        last, earlier = here, last
    return result
