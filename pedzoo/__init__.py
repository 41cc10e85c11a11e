"""Train, share and evaluate learned pedestrian controllers.

The public names below are imported on first use, so that ``import pedzoo`` and the command line's help
never wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pedzoo.eval.evaluate import evaluate as evaluate
    from pedzoo.eval.rollout import rollout as rollout
    from pedzoo.metrics.closed_loop import measure as measure
    from pedzoo.models.zoo.loading import list_models as list_models
    from pedzoo.models.zoo.loading import load as load
    from pedzoo.policies.load import list_policies as list_policies
    from pedzoo.sim.make import make_env as make_env
    from pedzoo.sim.robot_parts.make import make_robot_env as make_robot_env

__version__ = "0.1.0"

_HOME = {
    "evaluate": "pedzoo.eval.evaluate",
    "load": "pedzoo.models.zoo.loading",
    "list_models": "pedzoo.models.zoo.loading",
    "list_policies": "pedzoo.policies.load",
    "measure": "pedzoo.metrics.closed_loop",
    "make_env": "pedzoo.sim.make",
    "make_robot_env": "pedzoo.sim.robot_parts.make",
    "rollout": "pedzoo.eval.rollout",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
