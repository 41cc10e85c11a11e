"""The table of reward terms of robots: every public class here is a term by its name."""

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.errors import UserError
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robots.reward import Outcome, RobotReward
from pedzoo.sim.robots.sensor import RobotView


class Collision(RobotReward):
    """-1 for a robot that touched a person, a robot or a wall."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """-1 where a robot touched anything (B, R)."""
        return -outcome.collision.float()


class Discomfort(RobotReward):
    """A cost of coming nearer to people than they like, as in CrowdNav.

    Equation 3 of Chen et al., "Crowd-Robot Interaction" (ICRA 2019).
    """

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
        state, last = before.state, slice(-before.robots, None)
        between = torch.linalg.vector_norm(trace[:, last].unsqueeze(2) - trace.unsqueeze(1), dim=-1)
        bodies = state.radius.unsqueeze(1) + state.radius[:, last].unsqueeze(2)
        person = state.mask & (state.kind != ROBOT)
        gap = torch.where(person[:, None, :, None], between - bodies.unsqueeze(-1), torch.inf).amin(2)
        return -(self.distance - gap.clamp_min(0)).clamp_min(0).sum(-1) * TRACE_SECONDS / self.distance


class Progress(RobotReward):
    """Metres by which the way to the goal got shorter."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Metres by which the planner's way to the goal got shorter (B, R); 0 where a goal was reached."""
        last = slice(-before.robots, None)
        same_goal = before.state.goal_id[:, last] == after.state.goal_id[:, last]
        left = torch.where(same_goal, after.state.remaining_path[:, last], 0.0)
        return before.state.remaining_path[:, last] - left


class Success(RobotReward):
    """1 for a robot that has reached all its goals."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """1 where a robot has reached all its goals (B, R)."""
        return outcome.success.float()


class Time(RobotReward):
    """-1 for every second."""

    def __call__(self, before: RobotView, after: RobotView, trace: Tensor, outcome: Outcome) -> Tensor:
        """Less the seconds that a decision took (B, R)."""
        return -TRACE_SECONDS * trace.shape[2] * outcome.active
