"""Policies by name."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import cast

from pedzoo.core import renamed
from pedzoo.core.errors import unknown
from pedzoo.core.registry import MODELS, POLICIES, ROBOT_POLICIES
from pedzoo.core.spec import build, make, parse
from pedzoo.models.zoo.loading import baselines, list_models, load
from pedzoo.models.zoo.store import find, is_file
from pedzoo.policies.crowd import is_crowd, members
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.policy import Policy
from pedzoo.policies.robot_policy import AsPedestrian, RobotPolicy
from pedzoo.policies.teams import Crowd, Teams


def load_policy(name: str) -> Policy | Walker:
    """Return a policy of the registry, any model as one, or a mixed crowd.

    Args:
        name: ``orca:radius=0.3``, or whatever `pedzoo.load` takes, with settings of `Walker`:
            ``sgan_goal.zara1:noise=step``. For a mixed crowd several of these, joined by ``+``, each with
            its share of the agents: ``orca:share=0.5+sgan_goal_map.indoor``, see `pedzoo.policies.crowd`.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message; shares that cannot be.
    """
    if is_crowd(name):
        return Teams(crowd_of(name))
    spec = parse(name)
    own = ".py:" in spec.name and issubclass(POLICIES.get(spec.name), Policy)
    if own or spec.name in POLICIES.names():
        return build(POLICIES, name, Policy)
    if not (is_file(spec.name) or spec.name in MODELS.names() or find(spec.name)):
        raise unknown("policy", spec.name, list_policies())
    return make(
        Walker, "walker", spec._replace(settings=renamed.new_settings(spec.settings)), model=load(spec.name)
    )


def list_policies(pattern: str = "*") -> list[str]:
    """Return the names of all policies that match ``pattern``: those that are no models come first."""
    models = sorted({*list_models(), *baselines()})
    return [name for name in (*POLICIES.names(), *models) if fnmatch(name, pattern)]


def teams(people: str | Policy | Walker, robots: str | Policy | Walker | None = None) -> Teams:
    """Return a crowd of policies of people and of robots, or of their names; see `Teams`.

    Raises:
        UserError: An unknown name or setting, shares that do not sum to 1, or decision intervals that are no
            multiples of the shortest.
    """
    one, other = (crowd_of(given) if isinstance(given, str) else given for given in (people, robots))
    return Teams(cast("Policy | Walker | Crowd", one), other)


def crowd_of(name: str) -> Crowd:
    """Return the policies of a mixed crowd, or of one policy, and their shares.

    Args:
        name: Such as ``orca:share=0.5+sgan_goal_map.indoor``, see `pedzoo.policies.crowd`.
    """
    return [(load_policy(one.policy), one.share) for one in members(name)]


def load_robot_policy(name: str) -> RobotPolicy:
    """Return a policy of robots by its name with settings, or a policy of people that moves robots.

    Args:
        name: ``stop``, ``straight``, ``file.py:Class``, or whatever `load_policy` takes: ``orca``,
            ``social_force:preset=indoor``. Robots on wheels track the velocities of the latter.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message.
    """
    spec = parse(name)
    own = ".py:" in spec.name and issubclass(ROBOT_POLICIES.get(spec.name), RobotPolicy)
    if own or spec.name in ROBOT_POLICIES.names():
        return build(ROBOT_POLICIES, name, RobotPolicy)
    return AsPedestrian(load_policy(name))
