"""People who hold a place: they wait in a queue, for someone, or where a recorded person stood."""

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.types import STEP_SECONDS

_WALKS = 0.99
"""Of the speed that people like: those whose desired velocity is less hold a place; the rest is rounding."""


def share_of_speed(batch: TensorDictBase) -> Tensor | None:
    """Return desired velocities as shares of preferred speeds (B, A); None where there are none."""
    agents = agents_of(batch)
    if "desired_velocity" not in agents.keys():
        return None
    desired, liked = (cast("Tensor", agents[key]) for key in ("desired_velocity", "pref_speed"))
    return desired.norm(dim=-1) / liked[..., 0]


def goes_on(batch: TensorDictBase) -> Tensor:
    """Return which agents the policy moves on (B, A) bool: it controls them, and they hold no place."""
    controlled, share = cast("Tensor", agents_of(batch)["controlled"]), share_of_speed(batch)
    return controlled if share is None else controlled & (share >= _WALKS)


def holding_places(batch: TensorDictBase, step: Tensor) -> Tensor:
    """Return the steps (B, A, 2), metres, in which people who hold a place go to it instead.

    People hold a place whose desired velocity is less than the speed that they like: it ends there in one
    step. No model has learned to stand for as long as it is asked to.

    Args:
        batch: The scenes.
        step: What the model says (B, A, 2), metres.
    """
    share = share_of_speed(batch)
    if share is None:
        return step
    there = cast("Tensor", agents_of(batch)["desired_velocity"]) * STEP_SECONDS
    share = share.unsqueeze(-1)
    return torch.where(share < _WALKS, torch.lerp(there, step, share.clamp_max(1)), step)
