"""A robot that never moves: what people do around it costs them nothing but the way."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.policies.robot_policy import RobotPolicy, bodies_of


class Stop(RobotPolicy):
    """A robot that never moves."""

    def action(self, scenes: TensorDictBase) -> Tensor:
        """See `RobotPolicy.action`."""
        radius = bodies_of(scenes).radius
        return torch.zeros(*radius.shape, 2, device=radius.device)
