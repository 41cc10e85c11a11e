"""Train, share and evaluate learned pedestrian controllers.

The public names below are imported on first use, so that ``import pedzoo`` and the command line's help
never wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pedzoo.eval.evaluate import evaluate
    from pedzoo.metrics.closed_loop import measure
    from pedzoo.models.zoo.loading import list_models
    from pedzoo.policies.load import controller, list_policies, list_scenarios, load, policy
    from pedzoo.sim.make import make_env
    from pedzoo.sim.robots.env import make_robot_env
    from pedzoo.viz.episodes import plot, rollout

__version__ = "0.1.0"

__all__ = [
    "controller",
    "evaluate",
    "list_models",
    "list_policies",
    "list_scenarios",
    "load",
    "make_env",
    "make_robot_env",
    "measure",
    "plot",
    "policy",
    "rollout",
]

_HOME = {
    "controller": "pedzoo.policies.load",
    "evaluate": "pedzoo.eval.evaluate",
    "list_models": "pedzoo.models.zoo.loading",
    "list_policies": "pedzoo.policies.load",
    "list_scenarios": "pedzoo.policies.load",
    "load": "pedzoo.policies.load",
    "make_env": "pedzoo.sim.make",
    "make_robot_env": "pedzoo.sim.robots.env",
    "measure": "pedzoo.metrics.closed_loop",
    "plot": "pedzoo.viz.episodes",
    "policy": "pedzoo.policies.load",
    "rollout": "pedzoo.viz.episodes",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
