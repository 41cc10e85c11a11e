"""People who hold a place: they wait in a queue, for someone, or where a recorded person stood."""

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.batch import WAITING_SPEED_SHARE, agents_of, desired_speed_share
from pedzoo.core.types import STEP_SECONDS


def holding_places(batch: TensorDictBase, step: Tensor) -> Tensor:
    """Return the steps (B, A, 2), metres, in which people who hold a place go to it instead.

    People hold a place whose desired velocity is less than the speed that they like: it ends there in one
    step. No model has learned to stand for as long as it is asked to.

    Args:
        batch: The scenes.
        step: What the model says (B, A, 2), metres.
    """
    share = desired_speed_share(batch)
    if share is None:
        return step
    there = cast("Tensor", agents_of(batch)["desired_velocity"]) * STEP_SECONDS
    share = share.unsqueeze(-1)
    return torch.where(share < WAITING_SPEED_SHARE, torch.lerp(there, step, share.clamp_max(1)), step)
