"""Encounters and other scenes that differ: who meets whom, where and when, on which floor plans."""

import math
from functools import cache
from typing import Any

import pytest
import torch
from helpers.scenes import prepared
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.types import BODY_RADIUS
from pedzoo.eval.rollout import prepare, walk
from pedzoo.metrics.arrival import arrived_in_time, finish_seconds
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.rollout import Rollout, joined
from pedzoo.sim.scenario import Layout
from pedzoo.sim.scenarios._base import Variants
from pedzoo.sim.scenarios._lanes import ABREAST, MEET, SPACING, Encounter

ENCOUNTERS = "blind_corner circle hallway intersection overtaking parallel perpendicular room_exit".split()
EVERY = pytest.mark.parametrize("name", ENCOUNTERS)

EXACT = "speed_std=0,jitter=0,aside=0,delay=0"
"""Scenes that do not differ but in their variant."""


LISTS = (
    "door:width=[0.7,1.2],thickness=[0.15,0.25],offset=[0,0.6]",
    "hallway:width=[1.2,2.5],offset=[-0.2,0,0.2],people=7",
    "room_exit:corridor=[1.5,3],people=9",
    "intersection:people=9,turn=0.5",
)

CROWD = 24
"""People who walk."""


def made(spec: str) -> Encounter:
    scenario = prepared(spec).scenario
    assert isinstance(scenario, Encounter)
    return scenario


def laid_out(spec: str, scenes: int) -> Layout:
    return prepared(spec).layout(Draws.for_episodes(0, torch.arange(scenes)))


def begun(spec: str, episodes: int = 8, seed: int = 0) -> PedestrianEnv:
    """Return an environment whose episodes have just begun."""
    env = make_env(prepared(spec), num_envs=episodes, seed=seed)
    env.reset()
    return env


@cache
def walked(spec: str, episodes: int = 8, policy: str = "go_to_goal") -> Rollout:
    walks, env = prepare(policy, prepared(spec), "compiled", episodes)
    return joined(list(walk(walks, env, episodes)))


def apart(position: Tensor) -> Tensor:
    """Return the distances of positions (B, A, 2), infinite from oneself."""
    between = torch.cdist(position, position, compute_mode="donot_use_mm_for_euclid_dist")
    return between + torch.eye(position.shape[1]).mul(1e9)


@EVERY
def test_a_crowd_has_room_and_arrives(name: str) -> None:
    most = SCENARIOS.get(name).most  # type: ignore[attr-defined]
    corridors = ("blind_corner", "hallway", "intersection", "overtaking")
    layout = laid_out(f"{name}:people={most}" + ",width=2" * (name in corridors), 2)
    assert layout.mask.all() and layout.mask.shape == (2, most)
    assert float(apart(layout.start).min()) > 2 * BODY_RADIUS
    env = begun(f"{name}:people={min(most, CROWD)}", 3)
    state = env.state
    for place in (state.past[:, :, 0], state.position):
        assert float(apart(place).min()) > 2 * BODY_RADIUS
    wall, _ = env.bank.closest_wall(state.position, state.map_id, state.pose)
    assert float(wall.min()) > BODY_RADIUS and state.remaining_path.isfinite().all()
    walk = walked(f"{name}:people={min(most, CROWD)}", 1)
    assert float(arrived_in_time(walk).double().mean()) > 0.95


@EVERY
def test_how_many_people(name: str) -> None:
    cls: Any = SCENARIOS.get(name)
    for people in (cls.fewest - 1, cls.most + 1):
        with pytest.raises(UserError, match=rf"people {people}: expected .*{cls.fewest}"):
            make_scenario(f"{name}:people={people}")
    for people in (cls.fewest, 7):
        assert laid_out(f"{name}:people={people}", 3).mask.sum(1).tolist() == [people] * 3


@EVERY
def test_people_meet_after_the_warm_start(name: str) -> None:
    """During it those in front have not turned aside for others, nor slowed down."""
    scenario, state = made(f"{name}:jitter=0,speed_std=0"), begun(f"{name}:jitter=0,speed_std=0", 4).state
    places = scenario.seats.of_scenes(scenario.variants.draw(Draws.for_episodes(0, torch.arange(4))))
    front = places.row == 0
    length = (state.position - state.past[:, :, 0]).norm(dim=-1)[front]
    assert torch.allclose(length, 2.8 * state.pref_speed[front], rtol=0.1)
    turned = (state.velocity * places.heading).sum(-1)[front] / state.velocity.norm(dim=-1)[front]
    # who changes lanes or comes to a bend does not walk along the lane
    assert float(turned.min()) > math.cos(math.radians(20))


@EVERY
def test_go_to_goal_runs_into_others_and_orca_does_not(name: str) -> None:
    direct, orca = walked(name, 16), walked(name, 4, "orca:radius=0.3,dt=0.4")
    assert float(direct.agent_contact.any(2).any(1).double().mean()) >= 0.7
    assert not orca.agent_contact.any()


def test_hallway_is_head_on() -> None:
    x = begun("hallway").state.position[..., 0]
    assert ((x[:, 0] < -1.5) & (x[:, 1] > 1.5)).all()
    met = walked(f"hallway:{EXACT}", 1)
    # the two of them are at x = 0 when they are said to be, but for the first steps of the warm start
    point = int(met.trace[0, :, :, 0].abs().sum(0).argmin())
    assert 0.1 * (point + 1) == pytest.approx(MEET, abs=0.3)


def test_hallway_is_its_own_mirror_image() -> None:
    state = begun(f"hallway:people=10,width=2.5,offset=0.2,{EXACT}", 1).state
    from_left = state.past[0, :, 0, 0] < 0
    left, right = state.past[0, from_left], state.past[0, ~from_left]
    assert {round(float(y), 3) for y in left[:, 0, 1]} == {-0.6, 0.2}
    distance = torch.cdist(left.flatten(1), -right.flatten(1))
    assert float(distance.amin(1).max()) < 1e-5


def test_hallway_of_some_against_others() -> None:
    for against in (1, 3):
        velocity = begun(f"hallway:people=4,against={against}").state.velocity[..., 0]
        assert ((velocity < 0).sum(1) == against).all() and ((velocity > 0).sum(1) == 4 - against).all()


@pytest.mark.parametrize("people", [2, 8])
def test_the_fast_overtake_the_slow(people: int) -> None:
    env = begun(f"overtaking:people={people},speed_ratio=1.5")
    slow = env.state.pref_speed.argsort(1).argsort(1) < people // 2
    speed, x = env.state.pref_speed, env.state.position[..., 0]
    fastest, slowest = speed.masked_fill(~slow, 0).amax(1), speed.masked_fill(slow, 9).amin(1)
    assert (slowest >= 1.5 * fastest - 1e-5).all()
    front = x.masked_fill(slow, -99).amax(1)
    assert (x.masked_fill(~slow, 99).amin(1) > front + 0.5).all()
    result = walked(f"overtaking:people={people},speed_ratio=1.5", policy="orca:radius=0.2,dt=0.4")
    seconds = finish_seconds(result.reached, result.goals)
    assert (seconds.masked_fill(slow, 0).mean(1) < seconds.masked_fill(~slow, 0).mean(1)).all()


def test_lanes_keep_their_distance_who_is_fast() -> None:
    spec = "overtaking:people=20,jitter=0"
    scenario, start = made(spec), laid_out(spec, 50).start
    variant = scenario.variants.draw(Draws.for_episodes(0, torch.arange(50)))
    for which, lanes in enumerate(scenario.lanes):
        for number in range(len(lanes)):
            x = start[variant == which][:, scenario.seats.lane[which] == number, 0]
            assert len(x) and (x.diff(dim=1) <= -SPACING + 1e-4).all()


@pytest.mark.parametrize("people", [2, 4])
def test_those_at_an_intersection_are_in_the_middle_together(people: int) -> None:
    result = walked(f"intersection:people={people},delay=0")
    nearest = result.trace.norm(dim=-1).argmin(2) * 0.1
    assert float((nearest.amax(1) - nearest.amin(1)).max()) < 1.0
    assert float(nearest.mean()) == pytest.approx(MEET, abs=0.4)
    heading = torch.atan2(*begun(f"intersection:people={people}").state.velocity.flip(-1).unbind(-1))
    quarters = (heading / (math.pi / 2)).round().long() % 4
    assert (quarters.sort(1).values == torch.arange(people)).all()


def test_some_turn_at_the_intersection() -> None:
    for settings, share in (("people=4", 0.0), ("people=8,turn=0.5,width=1.5", 0.5)):
        state = begun(f"intersection:{settings}", 24).state
        ahead = torch.nn.functional.cosine_similarity(state.velocity, state.goal_point, dim=-1)
        assert float((ahead < 0.7).double().mean()) == pytest.approx(share, abs=0.1)
    two_arms = made("intersection:arms=2,people=6")
    assert {lane.heading for lanes in two_arms.lanes for lane in lanes} == {(1.0, 0.0), (0.0, 1.0)}


@pytest.mark.parametrize("settings", ["", "width=2.5,people=20", "width=3,speed=0.6"])
def test_no_person_sees_round_the_blind_corner(settings: str) -> None:
    spec = f"blind_corner:{settings}" if settings else "blind_corner"
    env, scenario = begun(spec, 12), made(spec)
    position, variants = env.state.position, list(scenario.variants)
    lines = 0
    for scene, number in enumerate(scenario.variants.draw(Draws.for_episodes(0, torch.arange(12))).tolist()):
        across = position[..., 1] > -variants[number]["width"] / 2
        grid = env.bank.grids[number]
        assert int(env.state.map_id[scene]) == grid.map_id
        occupied = torch.from_numpy(grid.occupied("wall"))
        for one in position[scene, across[scene]]:
            for other in position[scene, ~across[scene]]:
                points = torch.lerp(one, other, torch.linspace(0, 1, 400).unsqueeze(1))
                cells = ((points - torch.tensor(grid.origin[:2])) / grid.resolution).long()
                assert occupied[cells[:, 1], cells[:, 0]].any()
                lines += 1
    assert lines >= 12
    result = walked("blind_corner")
    where = result.trace.mean(1)[torch.arange(8), result.agent_contact.any(1).int().argmax(1)]
    assert float(where.norm(dim=-1).max()) < 1.5


def test_both_sides_of_the_corner_are_mirror_images() -> None:
    state = begun(f"blind_corner:people=6,width=2.5,{EXACT}", 1).state
    across = state.past[0, :, 0, 0] < -3
    one, other = state.past[0, across], state.past[0, ~across].flip(-1)
    assert float(torch.cdist(one.flatten(1), other.flatten(1)).amin(1).max()) < 1e-4


def test_who_leaves_the_room_and_who_enters() -> None:
    env = begun("room_exit:people=9,entering=3,width=0.9", 6)
    inside = env.state.position[..., 0] < 0
    assert (inside.sum(1) == 6).all()
    result = walked("room_exit:people=9,entering=3,width=0.9", 6)
    # after all have reached their goals they have changed places, all through the door
    assert ((result.trace[:, :, -1, 0] < 0) == ~inside).all()
    side = result.trace[..., 0] > 0
    crossing = side[..., 1:] != side[..., :-1]
    assert (crossing.sum(2) == 1).all()
    assert float(result.trace[:, :, 1:, 1][crossing].abs().max()) < 0.45
    ends = result.goal[..., -1, 1][inside]
    assert (ends > 0).any() and (ends < 0).any()


def test_a_room_of_200_people_is_no_deeper_than_one_of_70() -> None:
    """Many people come from more directions, apart from each other, and not one behind a hundred others."""
    room, crowd = (laid_out(f"room_exit:people={people},entering=0", 2).start for people in (70, 200))
    assert float(apart(crowd).min()) > 2 * BODY_RADIUS
    assert float(room[..., 0].min()) - 1 < float(crowd[..., 0].min()) and (crowd[..., 0] < 0).all()


def test_streams_side_by_side() -> None:
    same = begun("parallel:people=20,change=0,aside=0", 4).state
    assert (same.velocity[..., 0] > 0).all()
    assert float((same.goal_point - same.past[:, :, 0])[..., 1].abs().max()) < 0.11
    there = begun("parallel:people=20,change=0,opposite=true", 4).state
    right = there.velocity[..., 0] > 0
    assert (right.sum(1) == 10).all()
    assert (there.goal_point[..., 1][right] < 0).all() and (there.goal_point[..., 1][~right] > 0).all()
    changed = begun("parallel:people=20,change=1,opposite=true", 4).state
    assert (changed.goal_point[..., 1].sign() == -changed.past[:, :, 0, 1].sign()).all()
    assert (changed.goal_point[..., 0].sign() == changed.velocity[..., 0].sign()).all()


def test_streams_that_cross() -> None:
    state = begun("perpendicular:people=20,speed_std=0", 4).state
    along = state.velocity.abs()
    eastward = along[..., 0] > along[..., 1]
    assert (eastward.sum(1) == 10).all()
    assert (state.velocity.amax(-1) > 0.9).all()


@pytest.mark.parametrize("people", [2, 5, 50])
def test_on_the_circle_all_want_to_the_other_side(people: int) -> None:
    env = begun(f"circle:people={people},jitter=0,aside=0,delay=0")
    state, radius = env.state, env.state.goal_point.norm(dim=-1)
    least = 0.5 / math.sin(math.pi / people)
    usual = [value for value in (3.0, 4.0, 5.0) if value >= least]
    assert sorted({round(value, 3) for value in radius[:, 0].tolist()}) == (usual or [round(least, 3)])
    assert float((state.position.norm(dim=-1) - radius).abs().mean()) < 0.25
    assert float((state.position + state.goal_point).norm(dim=-1).mean()) < 0.25
    assert float(apart(state.position).min()) > 0.6


def test_passages_that_no_person_fits_through() -> None:
    for spec in ("hallway:width=0.4", "room_exit:width=0.45", "blind_corner:width=0.4"):
        with pytest.raises(UserError, match=r"no way|in or too near a wall|clearance"):
            begun(spec)
    begun("hallway:width=0.6")


def test_people_who_walk_together() -> None:
    layout = laid_out("hallway:people=5,against=1,together=true,width=[1.8,2.4],jitter=0", 60)
    # from the left two and two, from the right one
    sides = layout.start[..., 0].sign()
    assert (sides.sum(1) == -3).all()
    scene = torch.arange(60)[layout.map_id == layout.map_id[0]]
    mine, speed = layout.start[scene], layout.pref_speed[scene]
    first, second, third, fourth = (number for number in range(5) if sides[scene[0], number] < 0)
    for one, other in ((first, second), (third, fourth)):
        assert torch.equal(speed[:, one], speed[:, other])
        assert torch.equal(mine[:, one, 0], mine[:, other, 0])
        assert torch.allclose((mine[:, one] - mine[:, other]).norm(dim=-1), torch.tensor(ABREAST))
    assert not torch.equal(speed[:, first], speed[:, third])
    alone = laid_out("hallway:people=5,against=1,width=2", 60).pref_speed
    assert not torch.equal(alone[:, first], alone[:, second])


# How scenes of one scenario differ


@pytest.mark.parametrize("spec", ["blind_corner", "hallway", "overtaking", *LISTS])
def test_every_plan_occurs_and_its_scenes_fit_it(spec: str) -> None:
    env = begun(spec, 48)
    state, names = env.state, {grid.map_id: grid for grid in env.bank.grids}
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
    result = walked(LISTS[0], 32)
    assert len(result.map_id.unique()) == 4 == len(prepared(LISTS[0]).bank.grids)
    assert bool(result.reached.amax(2).eq(1).all())
    # an offset of 0 is head-on, and goals lie where starts do
    y = result.goal[..., 0, 1].abs()
    assert set(y.flatten().mul(10).round().tolist()) == {0.0, 6.0}
    assert float((result.past[:, :, 0, 1].abs() - y).abs().max()) < 0.31


def test_a_list_of_one_is_the_number() -> None:
    one, other = (begun(f"hallway:width={width}", 5) for width in ("2", "[2]"))
    assert torch.equal(one.state.past[:, :, 0], other.state.past[:, :, 0])
    assert [grid.map_id for grid in one.bank.grids] == [grid.map_id for grid in other.bank.grids]


def test_settings_are_drawn_one_by_one() -> None:
    draws = Draws.for_episodes(3, torch.arange(500))
    both = Variants("x", width=(1.0, 2.0, 3.0), offset=(0.0, 0.1))
    assert torch.equal(both.draw(draws) // 2, Variants("x", width=(1.0, 2.0, 3.0)).draw(draws))
    assert [dict(one) for one in both][3] == {"width": 2.0, "offset": 0.1}
    assert float(torch.bincount(both.draw(draws)).min()) > 50
    assert Variants("x").draw(draws).eq(0).all() and list(Variants("x")) == [{}]


@EVERY
def test_without_variation_scenes_of_a_plan_are_alike(name: str) -> None:
    scenario, there = made(f"{name}:{EXACT}"), laid_out(f"{name}:{EXACT}", 12).start
    variant = scenario.variants.draw(Draws.for_episodes(0, torch.arange(12)))
    for number in variant.unique().tolist():
        mine = there[variant == number]
        assert torch.equal(mine, mine[:1].expand_as(mine))


@EVERY
def test_people_start_aside_and_late(name: str) -> None:
    spec = f"{name}:speed_std=0,jitter=0,aside=0.4,delay=0.8"
    scenario, layout = made(spec), laid_out(spec, 200)
    draws = Draws.for_episodes(0, torch.arange(200))
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
    position = begun("blind_corner", 40).state.position
    assert 8 <= int(position.norm(dim=-1).argmin(1).sum()) <= 32
