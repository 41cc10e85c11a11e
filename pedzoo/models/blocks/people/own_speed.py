"""The speed at which people walk alone: the one that they like, whatever a model has learned of it.

Recorded people differ in ways that their noise stands for. Few walk as slowly or as fast as hosts may want.
So a model's speed alone is off by -7 to +30 %. How others change it is what it has learned.
"""

import torch
from torch import Tensor
from torch.nn import functional

CATCHING_UP = 0.5
"""Of the difference from that speed, in a step: about as the model itself gets faster and slower."""

TURNED, FACING = 0.5, 0.9
"""Cosines between the way and a step: those who turn farther away walk as the model says, as they turn."""


def at_own_speed(step: Tensor, alone: Tensor, last: Tensor, wanted: Tensor) -> Tensor:
    """Return steps (P, 2) of people who would walk at their own speed if they were alone.

    As much of a step as others leave of a step alone, they leave of it at that speed, too.

    Args:
        step: What the model says (P, 2), metres, as all that follow.
        alone: What it would say if there were no others.
        last: Their last steps.
        wanted: Along the way, at the speed that they like.
    """
    ahead = functional.normalize(alone + 0.1 * wanted, dim=-1)
    facing = (ahead * functional.normalize(wanted, dim=-1)).sum(-1, keepdim=True)
    # some walk at an angle to their way: as much too fast on their path as they are too slow on the way
    own = wanted.norm(dim=-1, keepdim=True) / facing.clamp_min(FACING).sqrt()
    speed = torch.lerp((last * ahead).sum(-1, keepdim=True), own, CATCHING_UP)
    left = (step * ahead).sum(-1, keepdim=True) / (alone * ahead).sum(-1, keepdim=True).clamp_min(1e-3)
    share = ((facing - TURNED) / (FACING - TURNED)).clamp(0, 1) * left.clamp(0, 1)
    return step + share * (speed * ahead - alone)
