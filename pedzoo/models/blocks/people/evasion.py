"""How people evade others who will come too close, long before a safety layer has to."""

import torch
from torch import Tensor

from pedzoo.core.geometry import smooth_norm
from pedzoo.models.blocks.people.nearest import Neighbours

MIDDLE = 0.1
"""Metres: by how much others count as farther to one side, so that two who meet have a way to evade."""

_AT_ONCE = 0.05
"""Metres: a closest approach within which the way to evade gets shorter."""


def evasion(others: Neighbours, side: Tensor) -> tuple[Tensor, Tensor]:
    """Return which way people evade (B, A, 2), in the frame of each person's way, and how urgently (B, A, 1).

    Away from the place of the closest approach, as people do by the time that is left until then (Karamouzas,
    Skinner and Guy, Physical Review Letters 2014). One touch at once has a length of 1 and an urgency of 1;
    both fall by e within 2 s and within 0.5 m of free space.

    Args:
        others: The nearest others.
        side: Whether others that are met in the middle count as on the left (positive) or right (B, A).
    """
    closest, (soon, miss) = 2 * others.features[..., 6:8], others.features[..., 10:12].unbind(-1)
    comes_closer = (soon < 1) & ~others.absent
    urgent = torch.where(comes_closer, soon * miss * others.share, 0.0).unsqueeze(-1)
    closest = closest + torch.stack((torch.zeros_like(side), MIDDLE * side.sign()), -1).unsqueeze(2)
    away = -closest / smooth_norm(closest).unsqueeze(-1).clamp_min(_AT_ONCE)
    return (urgent * away).sum(2), urgent.amax(2)
