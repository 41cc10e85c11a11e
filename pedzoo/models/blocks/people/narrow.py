"""Narrow places, where people look up: they turn faster, and set out again where somebody stopped them."""

import torch
from torch import Tensor

from pedzoo.models.blocks.people.step_features import RAYS

NEAR_WALL, AT_WALL = 0.3, 0.05
"""Metres from a person, or from what they reach, to a wall: from the first on a place gets narrow."""


def narrowness(walls: Tensor) -> Tensor:
    """Return how narrow it is around people (B, A), 0 to 1, for their distances to walls (B, A, N), metres.

    Of these `pedzoo.models.blocks.people.step_features.Situation` says where they are measured.
    """
    return ((NEAR_WALL - walls.amin(-1)) / (NEAR_WALL - AT_WALL)).clamp(0, 1)


def confinement(walls: Tensor) -> Tensor:
    """Return how narrow it is on both sides of people (B, A), 0 to 1, as in a doorway or a passage.

    ``walls`` (B, A, 17) are those of `narrowness`. What is straight ahead or behind counts on both sides.
    """
    here, around = walls[..., :1], walls[..., 1:].unflatten(-1, (-1, RAYS))
    left, right = around[..., : RAYS // 2 + 1], around[..., [0, *range(RAYS // 2, RAYS)]]
    sides = (torch.cat((here, side.flatten(-2)), -1) for side in (left, right))
    return torch.minimum(*(narrowness(side) for side in sides))
