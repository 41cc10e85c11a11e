"""Environments by name."""

from __future__ import annotations

from typing import Any

from pedzoo.core import renamed
from pedzoo.core.errors import UserError
from pedzoo.core.registry import PHYSICS, SCENARIOS
from pedzoo.core.spec import Spec, build, parse
from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.physics_parts.base import Physics
from pedzoo.sim.scenario_parts.scenario import Scenario

CLEARANCE = 0.25
"""Metres that planned ways keep from walls."""


@renamed.takes_world
def make_env(
    scenario: str | Spec | Scenario,
    num_envs: int = 1,
    physics: str = "compiled",
    clearance: float = CLEARANCE,
    body_radius: float = BODY_RADIUS,
    **settings: Any,
) -> PedestrianEnv:
    """Return the environment of a scenario.

    Args:
        scenario: Its name with settings (``goals:map=office.yaml,people=5,goals=3``), ``file.py:Class``
            with settings, ``Spec("goals", {"map": path})``, or an instance, which environments of the
            same clearance may share.
        num_envs: Scenes that are run at once.
        physics: ``compiled``, ``torch`` (differentiable alike, on any device), ``bullet`` (pybullet) or
            ``file.py:Class``, with settings. Called ``world`` before, and ``compiled`` ``grid``.
        clearance: Metres that planned ways keep from walls.
        body_radius: Of a person, metres.
        settings: As of `PedestrianEnv`: ``seed``, ``decision_dt``, ``warm_start``, ``first_episode``, ...

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    made = make_scenario(scenario)
    made.ready(clearance)
    moves = make_physics(physics, made, body_radius)
    return PedestrianEnv(made, moves, num_envs, body_radius=body_radius, **settings)


def make_scenario(scenario: str | Spec | Scenario) -> Scenario:
    """Return the scenario of a name with settings; errors as of `pedzoo.core.spec.build`."""
    return scenario if isinstance(scenario, Scenario) else build(SCENARIOS, scenario, Scenario)


def make_physics(name: str, scenario: Scenario, body_radius: float) -> Physics:
    """Return the physics backend of a name with settings, on the floor plans of a prepared scenario.

    Raises:
        UserError: There is no such backend, or what it needs is not installed.
    """
    physics_class(name).check()
    given = {"bank": scenario.bank, "body_radius": body_radius}
    return build(PHYSICS, renamed.backend(name), Physics, **given)


def physics_class(name: str) -> type[Physics]:
    """Return the class of a physics backend; errors as of `make_physics`."""
    spec = parse(renamed.backend(name))
    cls = PHYSICS.get(spec.name)
    if not issubclass(cls, Physics):
        raise UserError(f"{spec.name!r} is no physics: expected a subclass of {Physics.__qualname__}")
    return cls
