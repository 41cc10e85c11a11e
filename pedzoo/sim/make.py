"""Environments by name."""

from __future__ import annotations

import torch

from pedzoo.core.errors import UserError, installed, known_arguments
from pedzoo.core.registry import PHYSICS, SCENARIOS
from pedzoo.core.spec import Spec, build, parse
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.scenario import PreparedScenario, Scenario
from pedzoo.sim.scenarios._yaml import scenario_spec
from pedzoo.sim.warm_start import WarmStart

CLEARANCE = 0.25
"""Metres that planned ways keep from walls."""


@known_arguments()
def make_env(
    scenario: str | Spec | Scenario | PreparedScenario,
    num_envs: int = 1,
    physics: str = "compiled",
    clearance: float = CLEARANCE,
    body_radius: float = BODY_RADIUS,
    seed: int | None = None,
    decision_dt: float = STEP_SECONDS,
    warm_start: WarmStart = "orca",
    first_episode: int = 0,
    stride: int | None = None,
    device: torch.device | str = "cpu",
    deadline: float | None = None,
) -> PedestrianEnv:
    """Return the environment of a scenario.

    Args:
        scenario: Its name with settings (``goals:map=office.yaml,people=5,goals=3``), ``mine.yaml``,
            ``file.py:Class`` with settings, ``Spec("goals", {"map": path})``, an instance, or what
            its `prepare` returned, which environments of the same clearance may share.
        num_envs: Scenes that are run at once.
        physics: ``compiled``, ``torch`` (differentiable alike, on any device), ``bullet`` (pybullet) or
            ``file.py:Class``, with settings.
        clearance: Metres that planned ways keep from walls.
        body_radius: Of a person, metres.
        seed: Of all scenes; scene i of a seed is the same however many are run at once. None: 0, and in
            processes that Python has started, such as a collector's workers, the number of the process.
        decision_dt: Seconds between two decisions, a multiple of 0.1.
        warm_start: Where the first 8 observed steps come from.
        first_episode: Number of the first scene.
        stride: From a scene that ends to the next one, ``num_envs`` by default; see `PedestrianEnv`.
        device: Where scenes are, and everything that they are looked up in.
        deadline: Seconds that people have for every goal. By default four times as many as their way takes
            freely, at least 20, and in `room_exit` what the crowd needs. Not for people of recordings.

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    prepared = prepare_scenario(scenario, clearance)
    return PedestrianEnv(
        prepared,
        make_physics(physics, prepared.bank, body_radius),
        num_envs=num_envs,
        seed=seed,
        decision_dt=decision_dt,
        warm_start=warm_start,
        first_episode=first_episode,
        stride=stride,
        body_radius=body_radius,
        device=device,
        deadline=deadline,
    )


def make_scenario(scenario: str | Spec | Scenario) -> Scenario:
    """Return the scenario of a name with settings; errors as of `pedzoo.core.spec.build`."""
    if isinstance(scenario, Scenario):
        return scenario
    return build(SCENARIOS, scenario_spec(scenario), Scenario)


def prepare_scenario(
    scenario: str | Spec | Scenario | PreparedScenario, clearance: float = CLEARANCE
) -> PreparedScenario:
    """Return a scenario with its floor plans and ways; one that has them with this clearance is returned.

    Raises:
        UserError: As of `make_scenario`, a scene that cannot be, or a `prepare` that returns something else.
    """
    if isinstance(scenario, PreparedScenario):
        if scenario.planner.clearance == clearance:
            return scenario
        scenario = scenario.scenario
    made = make_scenario(scenario)
    prepared = made.prepare(clearance)
    if not isinstance(prepared, PreparedScenario):
        raise UserError(
            f"{type(made).__name__}.prepare returned {prepared!r:.60}: expected what super().prepare("
            "clearance) returns, with tables by dataclasses.replace(prepared, tables=...)"
        )
    return prepared


def make_physics(name: str, bank: MapBank, body_radius: float) -> Physics:
    """Return the physics backend of a name with settings, on floor plans.

    Raises:
        UserError: There is no such backend, or what it needs is not installed.
    """
    physics_class(name).check()
    given = {"bank": bank, "body_radius": body_radius}
    return build(PHYSICS, name, Physics, **given)


def usual_physics() -> str:
    """Return the physics of walks where none is named: `bullet`, or `compiled` where there is no pybullet."""
    return "bullet" if installed("pybullet") else "compiled"


def physics_class(name: str) -> type[Physics]:
    """Return the class of a physics backend; errors as of `make_physics`."""
    return PHYSICS.get(parse(name).name, Physics)
