"""Environments and scenarios by name, and scenarios in files."""

import os
from typing import Any

from pedzoo.core.errors import UserError, known_arguments, unknown
from pedzoo.core.machine import usual_physics
from pedzoo.core.paths import expanded
from pedzoo.core.registry import PHYSICS, SCENARIOS
from pedzoo.core.spec import Spec, SpecText, build, parse, unquoted
from pedzoo.core.types import BODY_RADIUS
from pedzoo.core.untrusted import load_yaml, read_mapping
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.planner import Planner, planner_class
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.scenario import PreparedScenario, Scenario

CLEARANCE = 0.25
"""Metres that planned ways keep from walls."""

KEYS = ("people", "map", "speed", "speed_std")
"""What a file of a scenario may have: the settings of `pedzoo.sim.scenarios.custom.Custom`."""

EXPECTED = "people: [{from: [-3, 0], to: [3, 0]}, ...], metres"


@known_arguments(PedestrianEnv.__init__)
def make_env(
    scenario: str | Spec | Scenario | PreparedScenario,
    num_envs: int = 1,
    physics: str | None = None,
    clearance: float = CLEARANCE,
    planner: str = Planner.name,
    **settings: Any,
) -> PedestrianEnv:
    """Return the environment of a scenario.

    Args:
        scenario: Its name with settings (``goals:map=office.yaml,people=5,goals=3``), ``mine.yaml``,
            ``file.py:Class`` with settings, ``Spec("goals", {"map": path})``, an instance, or what
            its `prepare` returned, which environments of the same clearance and planner may share.
        num_envs: Scenes that are run at once.
        physics: ``compiled``, ``torch`` (differentiable alike, on any device), ``bullet`` (pybullet) or
            ``file.py:Class``, with settings; None: what ``PEDZOO_PHYSICS`` says, or ``compiled``.
        clearance: Metres that planned ways keep from walls.
        planner: ``shortest`` paths, or those of ``astar`` on the grid of open cells, as in iGibson.
        settings: More of `PedestrianEnv`: ``seed``, ``decision_dt``, ``warm_start``, ``first_episode``,
            ``stride``, ``body_radius``, ``device``, and ``deadline``, seconds that people have for every
            goal. By default these are four times as many as their way takes freely, at least 20, and in
            `room_exit` what the crowd needs; people of recordings have their own.

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    prepared = prepare_scenario(scenario, clearance, planner)
    body_radius = settings.setdefault("body_radius", BODY_RADIUS)
    return PedestrianEnv(prepared, make_physics(physics, prepared.bank, body_radius), num_envs, **settings)


def scenario_spec(scenario: str | Spec) -> Spec | SpecText:
    """Return the name and the settings of a scenario, those of a file where one is named.

    ``mine.yaml`` is the scenario ``custom`` with the settings in it. Those behind it replace the file's
    (``mine.yaml:speed=1.0``). Its map is looked for beside it, too.

    Raises:
        UserError: It is no name; the file is missing or no YAML, has an unknown key, or no people.
    """
    if not isinstance(scenario, str | Spec | SpecText):
        raise UserError(f"scenario {scenario!r:.60}: expected its name with settings, such as door:people=4")
    spec = parse(scenario) if isinstance(scenario, str) else scenario
    if not spec.name.endswith((".yaml", ".yml")):
        return spec
    file = expanded(spec.name)
    settings = read_mapping(file, "scenario", EXPECTED)
    if settings.keys() >= {"image", "resolution", "origin"}:
        raise UserError(f"{str(file)!r} is a floor plan, no scenario: write goals:map={file}")
    for key, value in spec.settings.items():
        settings[key] = load_yaml(unquoted(value)) if isinstance(spec, SpecText) else value
    if wrong := [key for key in settings if key not in KEYS]:
        raise unknown(f"key of scenario {spec.name}", str(wrong[0]), KEYS)
    people = settings.get("people")
    if not isinstance(people, list) or not people or not all(isinstance(one, dict) for one in people):
        given = f"people: {people!r:.60}" if "people" in settings else "no people"
        raise UserError(f"{spec.name}: {given}: expected {EXPECTED}")
    plan = settings.get("map")
    if isinstance(plan, str) and os.path.isfile(file.parent / plan):  # false, too, where a name is too long
        settings["map"] = str(file.parent / plan)
    return Spec("custom", settings)


def make_scenario(scenario: str | Spec | Scenario) -> Scenario:
    """Return the scenario of a name with settings; errors as of `pedzoo.core.spec.build`."""
    if isinstance(scenario, Scenario):
        return scenario
    return build(SCENARIOS, scenario_spec(scenario), Scenario)


def prepare_scenario(
    scenario: str | Spec | Scenario | PreparedScenario,
    clearance: float = CLEARANCE,
    planner: str = Planner.name,
) -> PreparedScenario:
    """Return a scenario with its floor plans and ways; one that has the asked for is returned.

    Raises:
        UserError: As of `make_scenario`, an unknown planner, a scene that cannot be, or a `prepare` that
            returns something else.
    """
    planner_class(planner)
    if isinstance(scenario, PreparedScenario):
        if (scenario.planner.clearance, scenario.planner.name) == (clearance, planner):
            return scenario
        scenario = scenario.scenario
    made = make_scenario(scenario)
    prepared = made.prepare(clearance, planner)
    if not isinstance(prepared, PreparedScenario):
        raise UserError(
            f"{type(made).__name__}.prepare returned {prepared!r:.60}: expected what super().prepare("
            "clearance, planner) returns, with tables by dataclasses.replace(prepared, tables=...)"
        )
    return prepared


def make_physics(name: str | None, bank: MapBank, body_radius: float) -> Physics:
    """Return the physics backend of a name with settings, where what it needs is installed."""
    name = name or usual_physics(fast=True)
    physics_class(name).check()
    return build(PHYSICS, name, Physics, bank=bank, body_radius=body_radius)


def physics_class(name: str) -> type[Physics]:
    """Return the class of a physics backend; errors as of `make_physics`."""
    return PHYSICS.get(parse(name).name, Physics)
