"""What every policy is, and how one is made from its name."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import Any, ClassVar

from tensordict.nn import TensorDictModuleBase

from pedzoo.errors import UserError, unknown
from pedzoo.models.store import find, is_file
from pedzoo.models.walker import Walker
from pedzoo.models.zoo import baselines, list_models, load
from pedzoo.registry import MODELS, POLICIES
from pedzoo.sim.crowd import is_crowd
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
    """Return a policy of the registry, any model as one, or a mixed crowd.

    Args:
        name: ``orca:radius=0.3``, or whatever `pedzoo.load` takes, with settings of `Walker`:
            ``sgan_goal.zara1:noise=step``. For a mixed crowd several of these, joined by ``+``, each with
            its share of the agents: ``orca:share=0.5+sgan_goal_map.indoor``, see `pedzoo.sim.crowd`.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message; shares that cannot be.
    """
    if is_crowd(name):
        from pedzoo.sim.teams import Teams  # a team's policy is made here

        return Teams(name)
    spec = parse(name)
    if spec.name in POLICIES.names():
        return build(POLICIES, name, Policy)
    if ".py:" in spec.name and issubclass(POLICIES.get(spec.name), Policy):
        return build(POLICIES, name, Policy)
    if not (is_file(spec.name) or spec.name in MODELS.names() or find(spec.name)):
        raise unknown("policy", spec.name, list_policies())
    return make(Walker, "walker", spec, model=load(spec.name))


def list_policies(pattern: str = "*") -> list[str]:
    """Return the names of all policies that match ``pattern``: those that are no models come first."""
    models = sorted({*list_models(), *baselines()})
    return [name for name in (*POLICIES.names(), *models) if fnmatch(name, pattern)]


def walkers(policy: Policy | Walker) -> list[Walker]:
    """Return the learned policies that are in a policy: itself, or those of its teams."""
    return [part for part in policy.modules() if isinstance(part, Walker)]


def has_noise(policy: Policy | Walker) -> bool:
    """Return whether the learned policies in a policy draw noise."""
    return any(walker.model.noise_dim > 0 for walker in walkers(policy))
