"""Which people can touch each other at all: bounds that spare most pairs the exact question."""

from __future__ import annotations

from torch import Tensor

from pedzoo.sim.neighbors import Pairs, pairs_within


def farthest(path: Tensor, start: Tensor) -> Tensor:
    """Return a bound (B, A) on how far anybody gets from ``start`` (B, A, 2) on ``path`` (B, A, S, M, 2)."""
    # coordinates one by one: on the CPU half as fast again as pairs of them
    apart = path.flatten(2, 3).transpose(2, 3).contiguous() - start.unsqueeze(3)
    return apart.abs().amax(3).norm(dim=2)


def near_pairs(start: Tensor, present: Tensor, far: Tensor, within: float) -> Pairs:
    """Return the pairs that can come closer than ``within`` when nobody goes farther than ``far``.

    Args:
        start: Where everybody is (B, A, 2).
        present: Who takes part (B, A) bool.
        far: How far each person gets at most (B, A), metres.
        within: Metres between centres.
    """
    return pairs_within(start, present, far + within / 2)


def mark(touching: Tensor, pairs: Pairs, hit: Tensor) -> None:
    """Set ``touching`` (B, A, S) for both people of each pair wherever ``hit`` (N, S)."""
    which, point = hit.nonzero(as_tuple=True)
    for person in (pairs.first, pairs.second):
        touching[pairs.scene[which], person[which], point] = True
