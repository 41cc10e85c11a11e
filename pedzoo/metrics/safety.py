"""Who touches and comes near whom: pure functions over the 0.1 s trace of closed-loop episodes.

E episodes of A people (padded), T trace points, see `pedzoo.metrics.navigation`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.types import TRACE_SECONDS

_AT_ONCE = 4_000_000
"""Pairs of positions that are compared at once."""


def contact_events(contact: Tensor) -> Tensor:
    """Return how often each person begins to touch (E, A) long; a touch that lasts counts once.

    Two people who touch each other have one event each.

    Args:
        contact: Touching within each 0.1 s (E, A, T) bool, false where nobody is.
    """
    before = torch.cat((torch.zeros_like(contact[..., :1]), contact[..., :-1]), dim=-1)
    return (contact & ~before).sum(-1)


def person_minutes(present: Tensor) -> Tensor:
    """Return how long each person took part (E, A), minutes.

    Args:
        present: Who is there in a running episode (E, A, T) bool.
    """
    return present.sum(-1) * TRACE_SECONDS / 60


def least_distance(trace: Tensor, present: Tensor) -> Tensor:
    """Return how near the nearest other ever came (E, A), metres between centres; infinite for who is alone.

    Args:
        trace: Positions (E, A, T, 2), metres.
        present: Who is there in a running episode (E, A, T) bool.
    """
    episodes, agents = trace.shape[:2]
    least = trace.new_full((episodes, agents), torch.inf)
    alone = torch.eye(agents, dtype=torch.bool, device=trace.device)
    size = max(1, _AT_ONCE // max(1, episodes * agents**2))
    for some, there in zip(trace.split(size, 2), present.split(size, 2), strict=True):
        position, there = some.transpose(1, 2), there.transpose(1, 2)
        between = torch.cdist(position, position, compute_mode="donot_use_mm_for_euclid_dist")
        both = there.unsqueeze(2) & there.unsqueeze(3) & ~alone
        between = between.masked_fill(~both, torch.inf)
        least = torch.minimum(least, between.amin(-1).amin(1))
    return least
