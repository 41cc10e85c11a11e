"""A cost of coming nearer to people than they like, as in CrowdNav."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.errors import UserError
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robot_parts.outcome import Outcome
from pedzoo.sim.robot_parts.reward import RobotReward
from pedzoo.sim.robot_parts.view import RobotView


class Discomfort(RobotReward):
    """A cost of coming nearer to people than they like, as in CrowdNav (Chen et al., ICRA 2019, eq. 3)."""

    def __init__(self, distance: float = 0.2) -> None:
        """Say how near that is: metres between bodies.

        Raises:
            UserError: The distance is not above zero.
        """
        if not distance > 0:
            raise UserError(f"robot reward discomfort: distance {distance}: expected metres above 0")
        self.distance = distance

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Less the metres that lack, times the seconds for which they lack (B, R)."""
        state, robots = before.state, before.robots
        between = torch.linalg.vector_norm(trace[:, -robots:].unsqueeze(2) - trace.unsqueeze(1), dim=-1)
        bodies = state.radius.unsqueeze(1) + state.radius[:, -robots:].unsqueeze(2)
        person = state.mask & (state.kind != ROBOT)
        gap = torch.where(person[:, None, :, None], between - bodies.unsqueeze(-1), torch.inf).amin(2)
        return -(self.distance - gap.clamp_min(0)).clamp_min(0).sum(-1) * TRACE_SECONDS / self.distance
