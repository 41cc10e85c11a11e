"""Baseline: people walk along the planner's path as if alone."""

from tensordict import TensorDictBase

from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS
from pedzoo.policies.neighbours import separation_push
from pedzoo.policies.policy import Policy
from pedzoo.policies.safety_layer import safe


class GoToGoal(Policy):
    """The desired velocity itself: the baseline of all avoidance."""

    def __init__(self, dt: float = STEP_SECONDS, safety: bool = False) -> None:
        """Say how often it decides.

        Args:
            dt: Seconds between decisions.
            safety: Whether it has the safety layer of learned models, `pedzoo.policies.safety_layer`.
                That shows what the layer does alone. The velocity before the layer is then written, too, as
                ``unconstrained_action`` (B, A, 2) in m/s.

        Raises:
            UserError: With it, decisions at another step.
        """
        super().__init__(dt)
        if safety and dt != STEP_SECONDS:
            raise UserError(f"dt {dt}: the safety layer looks {STEP_SECONDS} s ahead; leave out dt or safety")
        self.safety = safety

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's velocity."""
        velocity = tensordict["agents", "desired_velocity"]
        if self.safety:
            tensordict["agents", "unconstrained_action"] = velocity
            step = velocity * STEP_SECONDS + separation_push(tensordict)
            velocity = safe(tensordict, step) / STEP_SECONDS
        tensordict["agents", "action"] = velocity
        return tensordict
