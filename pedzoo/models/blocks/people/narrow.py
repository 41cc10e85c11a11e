"""Narrow places, where people look up: they turn faster, and set out again where somebody stopped them."""

from torch import Tensor
from torch.nn import functional

from pedzoo.core.geometry import smooth_norm

NEAR_WALL, AT_WALL = 0.3, 0.05
"""Metres from a person, or from what they reach, to a wall: from the first on a place gets narrow."""


def narrowness(walls: Tensor) -> Tensor:
    """Return how narrow it is around people (B, A), 0 to 1, for their distances to walls (B, A, 17), metres.

    Of these `pedzoo.models.blocks.people.step_features.Situation` says where they are measured.
    """
    return ((NEAR_WALL - walls.amin(-1)) / (NEAR_WALL - AT_WALL)).clamp(0, 1)


def turned(velocity: Tensor, want: Tensor, pref_speed: Tensor) -> Tensor:
    """Return how far people walk off the way that they want (B, A): 0 if not at all, 1 from 90 degrees on.

    Less for slower people, whose directions say little: a quarter at half the speed that they like.

    Args:
        velocity: Of people (B, A, 2), m/s.
        want: Velocities that they want (B, A, 2), m/s.
        pref_speed: Speeds that they like (B, A), m/s.
    """
    one, other = functional.normalize(velocity, dim=-1), functional.normalize(want, dim=-1)
    share = (smooth_norm(velocity) / pref_speed).clamp_max(1).square()
    return share * (1 - (one * other).sum(-1)).clamp(0, 1)
