"""Scenes of one scenario differ: which floor plan they have, where people start, and who comes first."""

import pytest
import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS
from pedzoo.eval.rollout import rollout
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.scenarios._base import Variants
from pedzoo.sim.scenarios._lanes import Encounter

EXACT = "speed_std=0,jitter=0,aside=0,delay=0"

DEFAULTS = ("blind_corner", "hallway", "overtaking")
"""Scenarios with several floor plans, beside those of `LISTS`."""

LISTS = (
    "door:width=[0.7,1.2],thickness=[0.15,0.25],offset=[0,0.6]",
    "hallway:width=[1.2,2.5],offset=[-0.2,0,0.2],people=7",
    "room_exit:corridor=[1.5,3],people=9",
    "intersection:people=9,turn=0.5",
)

ENCOUNTERS = "blind_corner circle hallway intersection overtaking parallel perpendicular room_exit".split()


def starts(env: PedestrianEnv) -> Tensor:
    env.reset()
    return env.state.past[:, :, 0]


@pytest.mark.parametrize("spec", [*DEFAULTS, *LISTS])
def test_every_plan_occurs_and_its_scenes_fit_it(spec: str) -> None:
    env = make_env(spec, num_envs=48)
    env.reset()
    state = env.state
    names = {grid.map_id: grid for grid in env.bank.grids}
    assert len(names) > 1 and set(state.map_id.tolist()) == set(names)
    for points in (state.past[:, :, 0], state.position, state.goal_point):
        wall, _ = env.bank.closest_wall(points, state.map_id, state.pose)
        assert float(wall.min()) > BODY_RADIUS
        for scene, identity in enumerate(state.map_id.tolist()):
            grid = names[identity]
            low = torch.tensor(grid.origin[:2])
            high = low + torch.tensor(grid.cells.shape[::-1]) * grid.resolution
            assert ((points[scene] > low) & (points[scene] < high)).all()
    assert state.remaining_path.isfinite().all()


def test_doors_of_any_width_are_walked_through() -> None:
    result, env = rollout("go_to_goal", LISTS[0], "compiled", 32)
    assert len(result.map_id.unique()) == 4 == len(env.bank.grids)
    assert bool(result.reached.amax(2).eq(1).all())
    # an offset of 0 is head-on, and goals lie where starts do
    y = result.goal[..., 0, 1].abs()
    assert set(y.flatten().mul(10).round().tolist()) == {0.0, 6.0}
    assert float((result.past[:, :, 0, 1].abs() - y).abs().max()) < 0.31


def test_a_list_of_one_is_the_number() -> None:
    one, other = (make_env(f"hallway:width={width}", num_envs=5) for width in ("2", "[2]"))
    assert torch.equal(starts(one), starts(other))
    assert [grid.map_id for grid in one.bank.grids] == [grid.map_id for grid in other.bank.grids]


def test_settings_are_drawn_one_by_one() -> None:
    draws = Draws.for_episodes(3, torch.arange(500))
    both = Variants("x", width=(1.0, 2.0, 3.0), offset=(0.0, 0.1))
    alone = Variants("x", width=(1.0, 2.0, 3.0))
    assert torch.equal(both.draw(draws) // 2, alone.draw(draws))
    assert [dict(one) for one in both][3] == {"width": 2.0, "offset": 0.1}
    assert float(torch.bincount(both.draw(draws)).min()) > 50
    assert Variants("x").draw(draws).eq(0).all() and list(Variants("x")) == [{}]


@pytest.mark.parametrize("name", ENCOUNTERS)
def test_without_variation_scenes_of_a_plan_are_alike(name: str) -> None:
    still = make_env(f"{name}:{EXACT}", num_envs=12)
    there = starts(still)
    scenario = still.scenario
    assert isinstance(scenario, Encounter)
    variant = scenario.variants.draw(Draws.for_episodes(0, torch.arange(12)))
    for number in variant.unique().tolist():
        mine = there[variant == number]
        assert torch.equal(mine, mine[:1].expand_as(mine))


@pytest.mark.parametrize("name", ENCOUNTERS)
def test_people_start_aside_and_late(name: str) -> None:
    scenario = make_scenario(f"{name}:speed_std=0,jitter=0,aside=0.4,delay=0.8")
    assert isinstance(scenario, Encounter)
    draws = Draws.for_episodes(0, torch.arange(200))
    layout = scenario.prepare(0.25).layout(draws)
    places = scenario.seats.of_scenes(scenario.variants.draw(draws))
    off = layout.start - places.middle
    along = (off * places.heading).sum(-1)
    across = off[..., 0] * places.heading[..., 1] - off[..., 1] * places.heading[..., 0]
    assert (across.abs() <= places.aside + 1e-4).all() and (places.aside <= 0.4 + 1e-6).all()
    assert float(across.abs().max()) > 0.9 * float(places.aside.max())
    # all others come in time, by the speeds that they like
    late = -along / layout.pref_speed - places.before / layout.pref_speed - 2.8 - scenario.meet
    assert (late > -1e-3).all() and (late <= places.delay + 1e-3).all()
    if bool((places.delay > 0).all()):
        first = torch.bincount(late.argmin(1), minlength=scenario.people)
        assert (first > 0).sum() >= 2 and float(first.max()) < 160


def test_who_comes_first_differs_between_seeds() -> None:
    position = make_env("blind_corner", num_envs=40).reset()["agents", "history"][:, :, -1]
    assert 8 <= int(position.norm(dim=-1).argmin(1).sum()) <= 32
