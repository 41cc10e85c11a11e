"""Scenes of agents with bodies of their own, for tests of the kernel and of physics backends."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.grid import OccupancyGrid, free_points
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.scenario import Layout, PreparedScenario, Scenario
from pedzoo.sim.scenarios.goals import Goals
from pedzoo.sim.state import State

BACKENDS = ("torch", "compiled", "bullet")


class Yard(Scenario):
    """Open floor: agents stand in a row along y, 3 m apart, at x = 0; their goals are 40 m ahead."""

    wheels = True
    smallest_radius = 0.1
    fastest_agent = 3.0  # type: ignore[assignment]

    def __init__(self, people: int = 1, **bodies: Any) -> None:
        super().__init__(people, speed_std=0.0)
        self.bodies = bodies

    def plans(self) -> list[OccupancyGrid]:
        return []

    def prepare(self, clearance: float, planner: str = "shortest") -> PreparedScenario:
        prepared = super().prepare(clearance, planner)
        points = [[40.0, 3.0 * slot] for slot in range(self.people)]
        goals = prepared.planner.add_goals(-1, torch.tensor(points, dtype=torch.float64))
        return replace(prepared, tables=goals)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        scenes = len(draws.key)
        start = torch.tensor([[0.0, 3.0 * slot] for slot in range(self.people)])
        fields: dict[str, Any] = {key: torch.tensor([values] * scenes) for key, values in self.bodies.items()}
        return Layout(
            torch.full((scenes,), -1),
            start.repeat(scenes, 1, 1),
            torch.ones(scenes, self.people, dtype=torch.bool),
            torch.full((scenes, self.people), 1.3),
            prepared.tables.repeat(scenes, 1),
            **fields,
        )


class Wide(Goals):
    """From goal to goal, with bodies of a radius of their own."""

    def __init__(self, map: str, width: float, people: int = 5) -> None:
        super().__init__(map, people=people, pool=8)
        self.width, self.smallest_radius = width, width

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        layout = super().layout(prepared, draws)
        return layout._replace(radius=torch.full_like(layout.pref_speed, self.width))


def yard(
    physics: str = "compiled", people: int = 1, decision_dt: float = 0.4, **bodies: Any
) -> PedestrianEnv:
    """Return the environment of one yard, in which agents begin at rest."""
    scenario = Yard(people, **bodies)
    return make_env(scenario, 1, physics, warm_start="static", decision_dt=decision_dt)


def put(state: State, place: Tensor, radius: Tensor | None = None) -> State:
    """Return agents who stand at positions (B, A, 2), metres."""
    past = place.unsqueeze(2).expand_as(state.past).clone()
    state = state._replace(past=past, velocity=torch.zeros_like(place))
    return state if radius is None else state._replace(radius=radius)


def free_places(env: PedestrianEnv, clear: float, seed: int = 0) -> Tensor:
    """Return random places (B, A, 2) at least ``clear`` metres from walls; all scenes lie as their map."""
    (grid,) = env.bank.grids
    free = torch.from_numpy(free_points(grid, "wall", clear)).float()
    generator = torch.Generator().manual_seed(seed)
    return free[torch.randint(len(free), tuple(env.state.mask.shape), generator=generator)]


def commands(env: PedestrianEnv, generator: torch.Generator) -> Tensor:
    """Return random commands at every person's top speed (B, A, 2), m/s."""
    top = env.state.top_speed
    angle = 6.3 * torch.rand(top.shape, generator=generator)
    return top.unsqueeze(2) * torch.stack((angle.cos(), angle.sin()), dim=-1)
