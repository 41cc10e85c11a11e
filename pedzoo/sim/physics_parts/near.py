"""What agents touch on their paths."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.motion import Contacts

_AT_ONCE = 1 << 24
"""Pairs of agents that are compared at once: bounds the memory."""


@torch.no_grad()
def contacts_of(path: Tensor, gap: Tensor | None, present: Tensor, radius: Tensor) -> Contacts:
    """Return which agents touch another one or a wall in each trace step.

    Args:
        path: Sub-steps (2, S, M, B, A), metres.
        gap: Distances to walls there (S, M, B, A), metres; None without walls.
        present: Which agents are there (B, A) bool.
        radius: Of their bodies (B, A), metres.
    """
    wall = torch.zeros_like(path[0, :, 0], dtype=torch.bool)
    if gap is not None:
        wall = (gap.amin(1) < radius) & present
    both = radius.unsqueeze(1) + radius.unsqueeze(2)
    valid = present.unsqueeze(1) & present.unsqueeze(2)
    valid = valid & ~torch.eye(radius.shape[1], dtype=torch.bool, device=radius.device)
    least, others = torch.where(valid, both * both, -1.0), -1
    if len(radius) > radius.shape[1]:  # whichever are more come last: long runs of numbers
        path, least, others = path.mT.contiguous(), least.permute(1, 2, 0).contiguous(), -2
    parts = path.split(max(1, _AT_ONCE // max(1, path.shape[2] * least.numel())), dim=1)
    agent = torch.cat([_touching(part, least, others) for part in parts])
    agent = agent if others == -1 else agent.mT
    return Contacts(agent.permute(1, 2, 0), wall.permute(1, 2, 0))


def _touching(path: Tensor, least: Tensor, others: int) -> Tensor:
    """Return which agents touch another one in each trace step; agents of ``path`` are before ``others``."""
    x, y = path.unsqueeze(others) - path.unsqueeze(others - 1)
    return (torch.addcmul(x * x, y, y).amin(1) < least).any(others)
