"""Narrow places, where people look up: they turn faster, and set out again where somebody stopped them."""

from torch import Tensor

NEAR_WALL, AT_WALL = 0.3, 0.05
"""Metres from a person, or from what they reach, to a wall: from the first on a place gets narrow."""


def narrowness(walls: Tensor) -> Tensor:
    """Return how narrow it is around people (B, A), 0 to 1, for their distances to walls (B, A, 17), metres.

    Of these `pedzoo.models.blocks.people.step_features.Situation` says where they are measured.
    """
    return ((NEAR_WALL - walls.amin(-1)) / (NEAR_WALL - AT_WALL)).clamp(0, 1)
