"""Environments by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal

from pedzoo.errors import unknown
from pedzoo.registry import SCENARIOS
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.worlds.base import World
from pedzoo.spec import Spec, build
from pedzoo.types import BODY_RADIUS

WORLDS = {"grid": "pedzoo.sim.worlds.grid:GridWorld", "bullet": "pedzoo.sim.worlds.bullet:BulletWorld"}

CLEARANCE = 0.25
"""Metres that planned ways keep from walls."""


def make_env(
    scenario: str | Spec | Scenario,
    num_envs: int = 1,
    world: Literal["grid", "bullet"] = "grid",
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
        world: ``grid`` (torch, batched) or ``bullet`` (pybullet).
        clearance: Metres that planned ways keep from walls.
        body_radius: Of a person, metres.
        settings: As of `PedestrianEnv`: ``seed``, ``decision_dt``, ``warm_start``, ``first_episode``, ...

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    made = make_scenario(scenario)
    made.ready(clearance)
    watching = make_world(world, made, body_radius)
    return PedestrianEnv(made, watching, num_envs, body_radius=body_radius, **settings)


def make_scenario(scenario: str | Spec | Scenario) -> Scenario:
    """Return the scenario of a name with settings; errors as of `pedzoo.spec.build`."""
    return scenario if isinstance(scenario, Scenario) else build(SCENARIOS, scenario, Scenario)


def make_world(name: str, scenario: Scenario, body_radius: float) -> World:
    """Return the world ``name`` with the floor plans of a prepared scenario.

    Raises:
        UserError: There is no such world.
    """
    if name not in WORLDS:
        raise unknown("world", name, WORLDS)
    module, _, cls = WORLDS[name].partition(":")
    return getattr(import_module(module), cls)(scenario.bank, body_radius)
