"""Which people can touch each other at all: bounds that spare most pairs the exact question."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.neighbors import Pairs, pairs_within


def farthest(path: Tensor, origin: Tensor) -> Tensor:
    """Return a bound (...) on how far anybody gets from ``origin`` (2, ...) on ``path`` (2, N, ...)."""
    return torch.hypot(*(path - origin.unsqueeze(1)).abs_().amax(1))


def near_pairs(start: Tensor, present: Tensor, far: Tensor, within: float) -> Pairs:
    """Return the pairs that can come closer than ``within`` when nobody goes farther than ``far``.

    Args:
        start: Where everybody is, or any other point (B, A, 2).
        present: Who takes part (B, A) bool.
        far: How far from it each person gets at most (B, A), metres.
        within: Metres between centres.
    """
    return pairs_within(start, present, far + within / 2)
