"""Policies by name, and mixed crowds of them: ``orca:share=0.5+sgan_goal_map.indoor``.

The policies of a crowd are joined by ``+``. The setting ``share`` belongs to the team, not to the policy. A
``+`` does not join policies in these places:

* in brackets, and in a number (``1e+3``);
* in the name of a file or folder that exists;
* in a path or an address. There it joins if the name of a policy, of a model or of a file that exists
  follows, or an address.
"""

import math
import os
import re
from fnmatch import fnmatch
from typing import NamedTuple, cast

from pedzoo.core import renamed
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import MODELS, POLICIES, ROBOT_POLICIES, names_code
from pedzoo.core.spec import build, make, name_of, parse, split
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.address import is_address
from pedzoo.models.zoo.card import is_name
from pedzoo.models.zoo.loading import baselines, list_models, load
from pedzoo.models.zoo.store import find, is_file, names, robots
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.local_planner import load_local_planner
from pedzoo.policies.policy import Policy
from pedzoo.policies.robot_policy import AsPedestrian, Planned, RobotPolicy
from pedzoo.policies.robot_weights import load_robot_weights
from pedzoo.policies.teams import Crowd, Teams

ROBOT_SECONDS = 0.2
"""Seconds between two decisions of a robot, where nothing else is said."""

_SHARE = "share"
_ROUNDING = 1e-6


def load_policy(name: str) -> Policy | Walker:
    """Return a policy of the registry, any model as one, or a mixed crowd.

    Args:
        name: ``orca:radius=0.3``, or a name that `pedzoo.load` takes, with settings of `Walker`:
            ``sgan_goal.zara1:noise=step``. For a mixed crowd several of these, joined by ``+``, each with
            its share of the agents: ``orca:share=0.5+sgan_goal_map.indoor``.

    Raises:
        UserError: Unknown name or setting, with the nearest spelling in the message; impossible shares.
    """
    if is_crowd(name):
        return Teams(crowd_of(name))
    spec, more = parse(name), {}
    own = names_code(spec.name) and issubclass(POLICIES.get(spec.name), Policy)
    if own or spec.name in POLICIES.names():
        kind, cls = "policy", POLICIES.get(spec.name, Policy)
    elif is_file(spec.name) or spec.name in MODELS.names() or find(spec.name):
        model, settings = spec.name, renamed.new_settings(spec.settings)
        if names_code(model) and "weights" in settings:
            model = f"{model}:weights={settings.pop('weights')}"
        kind, cls, more = "walker", Walker, {"model": load(model)}
        spec = spec._replace(settings=settings)
    else:
        raise unknown("policy", spec.name, list_policies())
    return make(cls, kind, spec, **more)


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
    """Return the policies of a mixed crowd, or of one policy, and their shares."""
    return [(load_policy(one.policy), one.share) for one in members(name)]


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
    if spec.name not in ROBOT_POLICIES.names() and (not names_code(spec.name) or _is_pedestrian(spec.name)):
        if (trained := load_robot_weights(name)) is not None:
            return trained
        if not any(map(_is_policy, parts(name))):
            raise unknown("robot policy", spec.name, (*list_robot_policies(), *list_policies()))
        return AsPedestrian(load_policy(name))
    if issubclass(ROBOT_POLICIES.get(spec.name), RobotPolicy):
        return build(ROBOT_POLICIES, name, RobotPolicy)
    return Planned(load_local_planner(name, ROBOT_SECONDS))


def _is_pedestrian(file: str) -> bool:
    return issubclass(POLICIES.get(file), Policy | Forecaster)


class Member(NamedTuple):
    """A team as it was written.

    Attributes:
        policy: Its policy with settings, without ``share``.
        share: Part of the agents that it moves, above 0, at most 1.
    """

    policy: str
    share: float


def parts(text: str) -> list[str]:
    """Return the policies that are joined in a text, each with its settings and its ``share``."""
    pieces = split(text, "+")
    result = pieces[:1]
    for place in range(1, len(pieces)):
        if _goes_on(result[-1], pieces[place:]):
            result[-1] += f"+{pieces[place]}"
        else:
            result.append(pieces[place])
    return [part.strip() for part in result]


def is_crowd(text: str) -> bool:
    """Return whether a text is a crowd of teams: several policies, or one with a ``share``."""
    result = parts(text)
    return len(result) > 1 or (":" in text and _SHARE in parse(text).settings)


def members(text: str) -> list[Member]:
    """Return the teams of a crowd; those without a share have equal parts of what the others leave.

    Raises:
        UserError: A share is no positive number, or the shares do not sum to 1.
    """
    policies: list[str] = []
    shares: list[float | None] = []
    for part in parts(text):
        if not part:
            raise UserError(f"{text!r}: a policy is missing beside '+': expected orca:share=0.5+go_to_goal")
        name, settings = parse(part)
        own = ",".join(f"{key}={value}" for key, value in settings.items() if key != _SHARE)
        policies.append(f"{name}:{own}" if own else name)
        shares.append(_number(part, settings[_SHARE]) if _SHARE in settings else None)
    given = sum(share for share in shares if share is not None)
    if given > 1 + _ROUNDING:
        raise UserError(f"{text!r}: the shares sum to {given:g}: expected at most 1; make them smaller")
    open_shares = shares.count(None)
    rest = 1 - given
    if not open_shares and rest > _ROUNDING:
        raise UserError(
            f"{text!r}: the shares sum to {given:g}, and the rest has no policy: leave out one share, which "
            "then is the rest, or make them larger"
        )
    if open_shares and rest <= _ROUNDING:
        without = policies[shares.index(None)]
        raise UserError(f"{text!r}: nothing is left for {without!r}: make the other shares smaller")
    return [
        Member(policy, rest / open_shares if share is None else share)
        for policy, share in zip(policies, shares, strict=True)
    ]


def _number(part: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0 < share < math.inf:
        raise UserError(f"{part!r}: share {text}: expected a number above 0, at most 1")
    return share


def _goes_on(before: str, pieces: list[str]) -> bool:
    """Return whether a policy's text goes on behind the ``+``, with the first of the pieces."""
    if re.search(r"\d\.?[eE]$", before) and pieces[0][:1].isdigit():
        return True
    # the name, or the value of the last setting
    value = re.split(r"[:,]\s*\w+\s*=", before)[-1]
    if re.search(r"\.py:\w+\s*$", value):
        return False
    joined = ["+".join(pieces[:count]) for count in range(1, len(pieces) + 1)]
    if any(_exists(f"{value}+{ahead}") for ahead in joined):
        return True
    return "/" in value and not any(_is_policy(ahead) for ahead in joined)


def _is_policy(text: str) -> bool:
    name = name_of(text.strip())
    if is_name(name) and name.partition(".")[0] in MODELS.names():
        return True
    return is_address(name) or name in (*POLICIES.names(), *MODELS.names(), *names()) or _exists(text)


def _exists(text: str) -> bool:
    """Return whether the name in a text is that of a file, or of a model in a folder."""
    name = os.path.expanduser(name_of(text.strip()))
    file = name.rpartition(":")[0] if names_code(name) else name
    return os.path.exists(file) or os.path.exists(f"{file}.yaml")
