"""Which agents touch each other on their paths."""

from __future__ import annotations

import torch
from torch import Tensor

_AT_ONCE = 1 << 24
"""Pairs of agents that are compared at once: bounds the memory."""


def agent_contacts(path: Tensor, present: Tensor, radius: Tensor) -> Tensor:
    """Return which agents touch another one at each point of their paths (N, B, A) bool.

    Args:
        path: Points (2, N, B, A), metres.
        present: Which agents are there (B, A) bool.
        radius: Of their bodies (B, A), metres.
    """
    both = radius.unsqueeze(1) + radius.unsqueeze(2)
    valid = present.unsqueeze(1) & present.unsqueeze(2)
    valid = valid & ~torch.eye(radius.shape[1], dtype=torch.bool, device=radius.device)
    least = torch.where(valid, both * both, -1.0)
    parts = path.split(max(1, _AT_ONCE // max(1, least.numel())), dim=1)
    return torch.cat([_touching(part, least) for part in parts])


def _touching(path: Tensor, least: Tensor) -> Tensor:
    x, y = path.unsqueeze(-1) - path.unsqueeze(-2)
    return (torch.addcmul(x * x, y, y) < least).any(-1)
