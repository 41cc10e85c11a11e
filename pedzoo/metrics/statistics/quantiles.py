"""Quantiles over episodes or people: they cannot be added up, so whole groups are resampled.

N values of G groups (episodes, people); R resamples are weights (R, G), how often each group counts.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

_AT_ONCE = 4_000_000
"""Weights of values that are added up at once: several such tensors fit memory."""


def quantiles(value: Tensor, group: Tensor, weights: Tensor, at: Sequence[float]) -> Tensor:
    """Return quantiles (R, Q) of values (N,) of groups (N,), float64; NaN for a resample without any.

    Each is the least value at which the share of the values up to it is no smaller than asked for: the
    inverse of the cumulative distribution. ``weights`` (R, G): how often each group counts.
    """
    shares = torch.tensor(at, dtype=torch.float64)
    if not len(value):
        return torch.full((len(weights), len(shares)), torch.nan, dtype=torch.float64)
    order = value.argsort()
    ordered, owner = value[order].double(), group[order]
    result = []
    for part in weights.double().split(max(1, _AT_ONCE // len(value))):
        until = part[:, owner].cumsum(1)
        total = until[:, -1:]
        # a share of a whole number of values may be rounded up to just above it
        place = torch.searchsorted(until, total * shares - 1e-9 * total).clamp_max(len(value) - 1)
        result.append(ordered[place].where(total > 0, torch.nan))
    return torch.cat(result)
