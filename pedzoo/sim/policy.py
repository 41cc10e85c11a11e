"""What every policy is, and how one is made from its name."""

from __future__ import annotations

from typing import Any, ClassVar

from tensordict.nn import TensorDictModuleBase

from pedzoo.errors import UserError, unknown
from pedzoo.models.store import find, is_file
from pedzoo.models.walker import Walker
from pedzoo.models.zoo import baselines, list_models, load
from pedzoo.registry import MODELS, POLICIES
from pedzoo.spec import build, make, parse


class Policy(TensorDictModuleBase):
    """Reads a scene batch and writes everybody's velocity (B, A, 2) in m/s to ``agents/action``.

    Attributes:
        decision_dt: Seconds between its decisions.
    """

    decision_dt: float
    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def __init__(self, decision_dt: float) -> None:
        """Say how often it decides."""
        super().__init__()
        if not decision_dt > 0:
            raise UserError(f"dt {decision_dt}: expected seconds between decisions, above 0")
        self.decision_dt = decision_dt


def load_policy(name: str) -> Policy | Walker:
    """Return a policy of the registry, or any model as one.

    Args:
        name: ``orca:radius=0.3``, or whatever `pedzoo.load` takes with settings of `Walker`
            (``sgan_goal.zara1:noise=step``).

    Raises:
        UserError: Unknown name or setting; the message has the nearest spelling.
    """
    spec = parse(name)
    if spec.name in POLICIES.names():
        return build(POLICIES, name, Policy)
    if ".py:" in spec.name and issubclass(POLICIES.get(spec.name), Policy):
        return build(POLICIES, name, Policy)
    if not (is_file(spec.name) or spec.name in MODELS.names() or find(spec.name)):
        raise unknown("policy", spec.name, [*POLICIES.names(), *list_models(), *baselines()])
    return make(Walker, "walker", spec, model=load(spec.name))
