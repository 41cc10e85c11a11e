"""Baseline: everybody walks along the planner's way as if alone."""

from __future__ import annotations

from tensordict import TensorDictBase

from pedzoo.sim.policy import Policy
from pedzoo.types import STEP_SECONDS


class GoToGoal(Policy):
    """The desired velocity itself: what any avoidance has to improve on."""

    def __init__(self, dt: float = STEP_SECONDS) -> None:
        """Say how often it decides.

        Args:
            dt: Seconds between decisions.
        """
        super().__init__(dt)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write everybody's velocity."""
        tensordict["agents", "action"] = tensordict["agents", "desired_velocity"]
        return tensordict
