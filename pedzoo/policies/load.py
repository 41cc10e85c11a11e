"""Policies by name: those of the registry, models, mixed crowds, and policies of robots."""

from fnmatch import fnmatch
from pathlib import Path
from typing import Any, cast

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.machine import usable
from pedzoo.core.registry import MODELS, POLICIES, ROBOT_POLICIES, SCENARIOS, names_code
from pedzoo.core.spec import Spec, SpecText, build, make, name_of, parse, setting_types
from pedzoo.core.types import GoalProtocol
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster, Noise
from pedzoo.models.zoo.loading import baselines, check_settings, filled, list_models, read_weights, untrained
from pedzoo.models.zoo.loading import load as load_model
from pedzoo.models.zoo.store import find, is_file, no_model, robots
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.crowd_names import is_crowd, is_policy, members, parts
from pedzoo.policies.policy import NamedPolicy, Policy
from pedzoo.policies.robots._base import (
    LearnedPlanner,
    LocalPlanner,
    LocalPlannerPolicy,
    PedestrianRobotPolicy,
    RobotPolicy,
)
from pedzoo.policies.teams import Crowd, Teams
from pedzoo.policies.walker import Walker

ROBOT_SECONDS = 0.2
"""Seconds between two decisions of a robot, where nothing else is said."""


def load(
    name: str | Path,
    goal: GoalProtocol | None = None,
    *,
    device: str = "cpu",
    pretrained: bool = True,
    **settings: Any,
) -> Any:
    """Return any model or policy by its name; see `policy` and `controller` for what walks.

    Args:
        name: A model, as of `pedzoo.models.zoo.loading.load`: ``sgan_goal.zara1``, a file, an address,
            ``path/to/file.py:Class``. A policy, as of `load_policy`: ``orca:radius=0.3``, a model with
            settings of how it walks (``approach_net_goal_map.indoor:safety=false``), or a mixed crowd.
        goal: The goal protocol for untrained models that ask for it.
        device: Where the weights are, such as ``cuda``.
        pretrained: False for a model whose weights are drawn anew, see `untrained`.
        settings: Of an untrained model's architecture: ``load("sgan", pretrained=False, noise_dim=4)``.

    Returns:
        A `Forecaster` in eval mode, or a `Policy`.

    Raises:
        UserError: No such model or policy, setting or device, with the nearest spelling.
    """
    name = str(name)
    if not pretrained:
        result = untrained(name, goal, **settings)
    elif settings:
        given = ", ".join(settings)
        raise UserError(
            f"{given}: settings of untrained models, pretrained=False; those of a policy stand behind its "
            f"name, {name}:KEY=VALUE"
        )
    elif is_crowd(name) or _is_policy(spec := parse(name)) or spec.settings.keys() - _of_model(spec):
        result = load_policy(name)
    elif not (is_file(name) or name in MODELS.names() or find(name)):
        raise no_model(name, [*POLICIES.names(), *baselines()], "model or policy")
    else:
        result = load_model(name, goal)
    return result if device == "cpu" else result.to(usable(device))


def policy(model: str | Path | Forecaster | NamedPolicy, noise: Noise | None = None) -> NamedPolicy:
    """Return a model, or the one of a name, as a TorchRL policy; what is a policy stays as it is.

    Arguments of models as of `pedzoo.policies.walker.Walker`; errors as of `load`.
    """
    loaded = load(model) if isinstance(model, str | Path) else model
    return Walker(loaded, noise) if isinstance(loaded, Forecaster) else loaded


def controller(
    model: str | Path | Forecaster | NamedPolicy,
    map: OccupancyGrid | str | Path | None = None,
    noise: Noise | None = None,
    **settings: Any,
) -> Controller:
    """Return a model or policy, or the one of a name, as a controller for the people of any simulator.

    Arguments and errors as of `policy` and of `pedzoo.policies.controller.controller.Controller`: ``dt``,
    ``pref_speed``, ``seed``, ...
    """
    return Controller(policy(model, noise), map, **settings)


def _is_policy(spec: Spec | SpecText) -> bool:
    """Return whether a name is that of a policy's class, in the registry or in a file."""
    own = names_code(spec.name) and issubclass(POLICIES.get(spec.name), Policy)
    return own or spec.name in POLICIES.names()


def _of_model(spec: Spec | SpecText) -> set[str]:
    """Return which settings are those of a model's class in a file, and not of how it walks."""
    if not names_code(spec.name):
        return set()
    walking = {*setting_types(Walker)} - {"model"}
    own = {"weights", *setting_types(MODELS.get(spec.name))} - walking
    if wrong := sorted(spec.settings.keys() - own - walking):
        raise unknown(f"setting of {spec.name}", wrong[0], own | walking)
    return spec.settings.keys() & own


def list_scenarios(pattern: str = "*") -> list[str]:
    """Return the names of all scenarios that match ``pattern``."""
    return [name for name in SCENARIOS.names() if fnmatch(name, pattern)]


def list_policies(pattern: str = "*") -> list[str]:
    """Return the names of all policies that match ``pattern``: those that are no models come first."""
    models = sorted({*list_models(), *baselines()})
    return [name for name in (*POLICIES.names(), *models) if fnmatch(name, pattern)]


def load_policy(name: str) -> Policy | Walker:
    """Return a policy of the registry, any model as one, or a mixed crowd.

    Args:
        name: ``orca:radius=0.3``, or a name that `pedzoo.load` takes, with settings of `Walker`:
            ``sgan_goal.zara1:noise=step``. For a mixed crowd several of these, joined by ``+``, each with
            its share of the agents: ``orca:share=0.5+approach_net_goal_map.indoor``.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message; impossible shares.
    """
    joined = ("+" in name or "share" in name) and is_crowd(name)
    result = Teams(crowd_of(name)) if joined else _one_policy(parse(name))
    if not hasattr(result, "decision_dt"):
        raise UserError(f"policy {name!r} has no decision_dt: call super().__init__(dt) in its __init__")
    result.name = name
    return result


def _one_policy(spec: SpecText) -> Policy | Walker:
    name, settings = spec.name, dict(spec.settings)
    if names_code(name) and not _is_of_people(name):
        raise UserError(
            f"{name!r} is no policy: expected a subclass of pedzoo.policies.policy.Policy, or of "
            "pedzoo.models.base.Forecaster"
        )
    if _is_policy(spec):
        return build(POLICIES, spec, Policy)
    if not (is_file(name) or name in MODELS.names() or find(name)):
        raise no_model(name, [*POLICIES.names(), *baselines()], "policy")
    if its := _of_model(spec):
        name += ":" + ",".join(f"{key}={settings.pop(key)}" for key in sorted(its))  # as it was written
    return make(Walker, "walker", spec._replace(settings=settings), model=load_model(name))


def teams(people: str | Policy | Walker, robots: str | Policy | Walker | None = None) -> Teams:
    """Return a crowd of policies of people and of robots, or of their names; arguments and errors of `Teams`.

    Raises:
        UserError: An unknown name or setting, or shares that do not sum to 1.
    """
    one, other = (crowd_of(given) if isinstance(given, str) else given for given in (people, robots))
    return Teams(cast("Policy | Walker | Crowd", one), other)


def crowd_of(name: str) -> Crowd:
    """Return the policies of a mixed crowd, or of one policy, and their shares."""
    return [(load_policy(one), share) for one, share in members(name)]


def _is_of_people(file: str) -> bool:
    return issubclass(POLICIES.get(file), Policy | Forecaster)


def list_robot_policies(pattern: str = "*") -> list[str]:
    """Return the names of all policies of robots that match ``pattern``: the weights come last."""
    return [name for name in (*ROBOT_POLICIES.names(), *robots()) if fnmatch(name, pattern)]


def load_robot_policy(name: str) -> RobotPolicy:
    """Return a policy of robots by its name with settings, or a policy of people that moves robots.

    Args:
        name: ``stop``, ``straight``, ``sampling``, ``dwa``, ``file.py:Class``; weights such as
            ``robot_ppo.circle``; or what `load_policy` takes: ``orca``, ``social_force:preset=indoor``.
            Robots on wheels track the velocities of the latter.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message.
    """
    spec = parse(name)
    if spec.name not in ROBOT_POLICIES.names() and (not names_code(spec.name) or _is_of_people(spec.name)):
        if (trained := load_robot_weights(name)) is not None:
            return trained
        if not any(map(is_policy, parts(name))):
            known = [*ROBOT_POLICIES.names(), *POLICIES.names(), *baselines()]
            raise no_model(spec.name, known, "robot policy")
        return PedestrianRobotPolicy(load_policy(name))
    if issubclass(ROBOT_POLICIES.get(spec.name), RobotPolicy):
        return build(ROBOT_POLICIES, name, RobotPolicy)
    return LocalPlannerPolicy(load_local_planner(name, ROBOT_SECONDS))


def load_robot_weights(name: str) -> RobotPolicy | None:
    """Return a trained robot in eval mode; None for what is no file of weights, or is of a model of people.

    Args:
        name: A zoo name, ``robot_ppo.circle``, a folder or address with its card, a ``.safetensors`` file or
            a checkpoint of ``pedzoo fit --config robot/ppo``.

    Raises:
        UserError: The weights cannot be read, or do not fit their architecture.
    """
    weights = read_weights(name)
    if weights is None or weights.config["architecture"] not in ROBOT_POLICIES.names():
        return None
    cls, settings = ROBOT_POLICIES.get(weights.config["architecture"]), weights.config["init"]
    check_settings(cls, settings)
    return filled(weights, lambda: cls(**settings))


def load_planner(name: str, time_step: float) -> LocalPlanner:
    """Return a local planner by its name, or a trained robot as one; errors as of `load_local_planner`."""
    policy = None if name_of(name) in ROBOT_POLICIES.names() else load_robot_weights(name)
    return LearnedPlanner(policy) if policy else load_local_planner(name, time_step)


def load_local_planner(name: str, time_step: float) -> LocalPlanner:
    """Return a new local planner of a robot that decides every ``time_step`` seconds.

    The name may have settings, ``crowdnav_orca:safety_space=0.15``, or be ``path/to/file.py:Class``.

    Raises:
        UserError: Unknown name, setting or file, or a class whose objects cannot be called.
    """
    spec = parse(name)
    policy = make(ROBOT_POLICIES.get(spec.name), ROBOT_POLICIES.kind, spec, time_step=time_step)
    if not callable(policy):
        raise UserError(f"{name!r}: expected a class with __call__(robot, people) -> velocities (B, 2)")
    return cast("LocalPlanner", policy)
