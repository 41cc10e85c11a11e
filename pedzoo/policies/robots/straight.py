"""A robot that goes its way at top speed, as if it were alone."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.policies.robot_policy import VelocityPolicy, bodies_of


class Straight(VelocityPolicy):
    """A robot that goes the planner's way at top speed, straight in the open, as if it were alone."""

    def velocity(self, scenes: TensorDictBase) -> Tensor:
        """See `VelocityPolicy.velocity`."""
        bodies = bodies_of(scenes)
        last = slice(-bodies.radius.shape[-1], None)
        desired = cast("Tensor", agents_of(scenes)["desired_velocity"])[:, last]
        return torch.nn.functional.normalize(desired, dim=-1) * bodies.top_speed.unsqueeze(-1)
