"""Which people can touch each other at all: bounds that spare most pairs the exact question."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.neighbors import Pairs, pairs_within


def farthest(path: Tensor, origin: Tensor) -> Tensor:
    """Return a bound (B, A) on how far anybody gets from ``origin`` (2, B, A) on ``path`` (2, B, A, S, M)."""
    apart = path.flatten(3) - origin.unsqueeze(3)
    return torch.hypot(*apart.abs_().amax(3))


def near_pairs(start: Tensor, present: Tensor, far: Tensor, within: float) -> Pairs:
    """Return the pairs that can come closer than ``within`` when nobody goes farther than ``far``.

    Args:
        start: Where everybody is, or any other point (B, A, 2).
        present: Who takes part (B, A) bool.
        far: How far from it each person gets at most (B, A), metres.
        within: Metres between centres.
    """
    return pairs_within(start, present, far + within / 2)


def mark(touching: Tensor, pairs: Pairs, hit: Tensor) -> None:
    """Set ``touching`` (B, A, S) for both people of each pair wherever ``hit`` (N, S)."""
    which, point = hit.nonzero(as_tuple=True)
    for person in (pairs.first, pairs.second):
        touching[pairs.scene[which], person[which], point] = True
