"""Clause 7 of the loop contract: a scene with a robot and the scene without it have the same people."""

from typing import Any

import pytest
import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC, UNICYCLE
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.zoo.loading import load
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.scenario import Layout, PreparedScenario, Scenario

SCENES = ("door:people=4,offset=[0,0.3]", "goals:map=apartment.7,people=3,goals=2,pool=8", "circle:people=5")


class WithRobot(Scenario):
    """Another scenario, and a robot with wheels in the last slot that stands at (x, 0)."""

    wheels = True

    def __init__(self, of: str, x: float) -> None:
        self.inner, self.x = make_scenario(of), x
        super().__init__(self.inner.people + 1, self.inner.speed, self.inner.speed_std)
        self.goals, self.later, self.finished = self.inner.goals, self.inner.later, self.inner.finished

    def plans(self) -> list[OccupancyGrid]:
        return self.inner.plans()

    def prepare(self, clearance: float, planner: str = "shortest") -> PreparedScenario:
        inner = self.inner.prepare(clearance, planner)
        return PreparedScenario(scenario=self, planner=inner.planner, tables=inner)

    def next_goal(self, prepared: Any, draws: Any, agent: Tensor, number: Tensor, last: Tensor) -> Tensor:
        found = self.inner.next_goal(prepared.tables, draws, agent, number, last)
        return torch.where(agent < self.inner.people, found, -1)

    def layout(self, prepared: PreparedScenario, draws: Any) -> Layout:
        layout = prepared.tables.layout(draws)

        def and_one(values: Tensor, one: Any) -> Tensor:
            one = torch.as_tensor(one, dtype=values.dtype)
            return torch.cat((values, one.expand(len(values), 1, *values.shape[2:])), 1)

        size = layout.pref_speed
        return layout._replace(
            start=and_one(layout.start, [self.x, 0.0]),
            mask=and_one(layout.mask, True),
            pref_speed=and_one(size, 1.0),
            goal=and_one(layout.goal, -1),
            radius=and_one(torch.full_like(size, 0.15), 0.5),
            kind=and_one(torch.zeros_like(layout.goal), ROBOT),
            drive=and_one(torch.full_like(layout.goal, HOLONOMIC), UNICYCLE),
        )


def pair(scenes: str, x: float) -> tuple[PedestrianEnv, PedestrianEnv]:
    """Return four scenes without a robot, and with one."""
    return make_env(scenes, num_envs=4), make_env(WithRobot(scenes, x), num_envs=4)


def people_of(tensor: Tensor, people: int) -> Tensor:
    return tensor[:, :people]


@pytest.mark.parametrize("scenes", SCENES)
def test_people_begin_as_they_do_without_the_robot(scenes: str) -> None:
    """To rounding: places, speeds, goals, later goals, the warm start, keys and noise. It is far away."""
    alone, joined = pair(scenes, 900.0)
    first, second = alone.reset(seed=7), joined.reset(seed=7)
    people = alone.state.mask.shape[1]
    assert joined.state.kind[:, people].eq(ROBOT).all() and joined.state.mask[:, people].all()
    places = "past velocity heading pref_speed top_speed radius kind goal_point"
    for name in f"{places} mask controlled person deadline remaining_path goal_id later_goals".split():
        mine, other = getattr(alone.state, name), getattr(joined.state, name)
        torch.testing.assert_close(mine, people_of(other, people), rtol=0, atol=1e-6, msg=name)
    for name in ("key", "map_id", "pose", "clock"):
        assert torch.equal(getattr(alone.state, name), getattr(joined.state, name)), name
    walker = Walker(load("approach_net_goal_map.indoor"))
    noise: Any = walker.noise_of(first)
    assert torch.equal(noise, people_of(walker.noise_of(second), people))  # type: ignore[arg-type]
    assert noise.abs().sum() > 0


def walked(env: PedestrianEnv, policy: str) -> Tensor:
    """Return places (B, A, T, 2) over eight decisions."""
    walks, seen = load_policy(policy), env.reset(seed=3)
    places = [env.state.past]
    for _ in range(8):
        seen = env.step(walks(seen))["next"]
        places.append(env.state.past)
    return torch.cat(places, 2)


@pytest.mark.parametrize("scenes", SCENES)
@pytest.mark.parametrize("policy", ["go_to_goal:dt=0.4", "orca:dt=0.4"])
def test_people_walk_as_without_the_robot_until_they_meet_it(scenes: str, policy: str) -> None:
    """To rounding, beside a robot on wheels; ORCA walks around one in a circle's midst."""
    alone, joined = pair(scenes, 900.0)
    expected = walked(alone, policy)
    people = expected.shape[1]
    assert (expected - walked(joined, policy)[:, :people]).abs().max() <= 1e-5
    assert (expected[:, :, -1] - expected[:, :, 0]).norm(dim=-1).max() > 3
    _, met = pair(scenes, 0.0)
    if scenes.startswith("circle") and policy.startswith("orca"):
        assert (expected - walked(met, policy)[:, :people]).abs().max() > 0.1
