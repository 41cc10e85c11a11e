"""Who comes to a door from where, how far away they are, when they would be there, and who stands in it."""

from typing import Any

import pytest
import torch
from helpers.scenes import Watch, prepared
from helpers.walks import as_desired
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS
from pedzoo.eval.comparison import row
from pedzoo.eval.rollout import rollout
from pedzoo.sim.make import make_env
from pedzoo.sim.scenario import WARM_SECONDS, Layout
from pedzoo.sim.scenarios._base import Uniform
from pedzoo.sim.scenarios.door import ABREAST, SPACING, Door
from pedzoo.sim.state import State

SCENES = 200


def layout(settings: str) -> tuple[Any, Layout]:
    """Return a door and the starts of some scenes."""
    made = prepared(settings if settings.startswith("standing") else f"door:{settings}")
    assert isinstance(made.scenario, Door)
    return made.scenario, made.layout(Draws.for_episodes(0, torch.arange(SCENES)))


def begun(settings: str, scenes: int = 100) -> State:
    """Return the state when episodes begin."""
    env = make_env(prepared(f"door:{settings}"), num_envs=scenes)
    env.reset()
    return env.state


def closest(place: Tensor) -> float:
    """Return the least distance between two people at places (B, A, 2)."""
    return float((torch.cdist(place, place) + 9 * torch.eye(place.shape[1])).min())


def test_the_scenes_of_the_paper_stay_what_they_are() -> None:
    _, plain = layout("people=2")
    _, said = layout("away=2.5,from_right=1,abreast=1")
    torch.testing.assert_close(plain[:5], said[:5], rtol=0, atol=0)
    draws = Draws.for_episodes(0, torch.arange(SCENES))
    speed = (1.3 + 0.2 * draws.normal("speed", 2).clamp(-3, 3)).clamp_min(0.3)
    side = torch.tensor([-1, 1])
    lateral = side * 0.6 + 0.1 * draws.normal("jitter", 2).clamp(-3, 3)
    assert torch.equal(plain.pref_speed, speed)
    assert torch.equal(plain.start, torch.stack((side * (2.5 + WARM_SECONDS * speed), lateral), dim=-1))


def test_speeds_may_differ_at_the_door() -> None:
    speed = layout("speed_ratio=0.5,speed_std=0,people=4")[1].pref_speed
    assert torch.allclose(speed[0], torch.tensor([1.3, 0.65, 1.3, 0.65]))


def test_walls_are_as_thick_and_doors_as_wide_as_named() -> None:
    bank = prepared("door:width=[0.7,0.9],thickness=0.1,people=1").bank
    grid = next(
        one for one in bank.grids if one.map_id == bank.id_of("door:width=0.9,thickness=0.1,offset=0.6")
    )
    x, y, _ = grid.origin
    column = round(-x / grid.resolution)
    opening = (~grid.occupied("wall")[:, column]).sum() * grid.resolution
    wall = grid.occupied("wall")[round((-y + 1.5) / grid.resolution)]
    middle = wall[column - 10 : column + 10].sum() * grid.resolution
    assert (opening, middle) == pytest.approx((0.9, 0.1))


def test_each_side_draws_how_far_away_it_is() -> None:
    _, made = layout("away=[2.5,4],jitter=0,offset=0")
    away = made.start[..., 0].abs() - WARM_SECONDS * made.pref_speed
    assert 2.49 < float(away.min()) < 2.6 and 3.9 < float(away.max()) < 4.01
    difference = (away[:, 0] - away[:, 1]).abs()
    assert float(difference.max()) > 1.2 and float(difference.mean()) == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize("settings", ["sync=0.4", "sync=0.4,away=[2.5,4],speed_ratio=1.5,offset=[0,0.9]"])
def test_both_sides_are_at_the_door_in_time(settings: str) -> None:
    _, made = layout(settings)
    seconds = made.start.norm(dim=-1) / made.pref_speed
    apart = seconds[:, 1] - seconds[:, 0]
    # evenly distributed over 0.4 s to either side
    assert 0.39 < float(apart.abs().max()) < 0.401 and float(apart.abs().mean()) == pytest.approx(
        0.2, abs=0.04
    )
    assert abs(float(apart.mean())) < 0.05
    away = made.start[..., 0].abs() - WARM_SECONDS * made.pref_speed
    assert float(away.min()) > 2.499
    # the last one at the door starts as far away as without
    assert float(away.amin(1).max()) < 4.001


def test_the_warm_start_keeps_the_time() -> None:
    state = begun("sync=0.4")
    seconds = state.position.norm(dim=-1) / state.pref_speed
    assert float((seconds[:, 1] - seconds[:, 0]).abs().max()) < 0.41


def test_queues_are_in_time_by_their_first_ones() -> None:
    door, made = layout("sync=0,people=5,from_right=2,speed_std=0.2")
    seconds = made.start[:, :2].norm(dim=-1) / made.pref_speed[:, :2]
    assert torch.allclose(seconds[:, 0], seconds[:, 1], atol=1e-4)
    assert float(made.start[..., 0].abs().max()) < door.half_length - 0.5


def test_mirror_images_from_any_distance() -> None:
    past = begun("jitter=0,speed_std=0,offset=[0,0.6],away=[2.5,4],sync=0").past
    assert torch.equal(past[:, 0], -past[:, 1])
    assert float(past[:, 0, -1, 0].std()) > 0.3


@pytest.mark.parametrize(
    ("settings", "sides"),
    [
        ("people=5", [-1, 1, -1, 1, -1]),
        ("people=4,from_right=1", [-1, 1, -1, -1]),
        ("people=4,from_right=3", [-1, 1, 1, 1]),
        ("people=3,from_right=0", [-1, -1, -1]),
        ("people=2,from_right=2", [1, 1]),
    ],
)
def test_as_many_as_asked_for_come_from_the_right(settings: str, sides: list[int]) -> None:
    _, made = layout(settings)
    assert (made.start[..., 0].sign() == torch.tensor(sides)).all()


def test_goals_are_behind_the_door() -> None:
    expected = torch.tensor([[3.0, -0.6], [-3.0, 0.6], [3.0, -0.6], [3.0, -0.6]])
    assert torch.allclose(begun("people=4,from_right=1,offset=0.6", 1).goal_point[0], expected, atol=0.04)


@pytest.mark.parametrize("settings", ["people=6,from_right=0", "people=7,from_right=3,abreast=2"])
def test_no_person_starts_in_another_person(settings: str) -> None:
    _, made = layout(f"{settings},speed_std=0.3")
    assert closest(made.start) > min(SPACING, ABREAST) - 1e-3
    assert closest(begun(f"{settings},speed_std=0.3").position) > 2 * BODY_RADIUS


def test_people_who_walk_together() -> None:
    _, made = layout("people=7,from_right=2,abreast=2,offset=0.3,jitter=0")
    left, right = made.start[:, [0, 2, 4, 5, 6]], made.start[:, [1, 3]]
    speed = made.pref_speed[:, [0, 2, 4, 5, 6]]
    # two pairs and one alone, equally fast and side by side; the pair from the right likewise
    assert torch.equal(speed[:, 0], speed[:, 1]) and torch.equal(speed[:, 2], speed[:, 3])
    assert not torch.equal(speed[:, 0], speed[:, 2])
    assert torch.equal(left[:, 0, 0], left[:, 1, 0]) and torch.equal(right[:, 0, 0], right[:, 1, 0])
    lateral = torch.tensor([-0.375, 0.375, -0.375, 0.375, 0.0])
    assert torch.allclose(left[..., 1], (-(0.3 + lateral)).expand(SCENES, 5), atol=1e-6)
    assert torch.allclose(right[..., 1], torch.tensor([-0.075, 0.675]).expand(SCENES, 2), atol=1e-6)


def test_a_number_is_a_range_of_one() -> None:
    draws = Draws.for_episodes(1, torch.arange(50))
    assert torch.equal(Uniform("x", "y", 0.3).draw(draws, 2), torch.full((50, 2), 0.3))
    many = Uniform("x", "y", (-1.0, 2.0)).draw(draws, 20)
    assert -1 < float(many.min()) < -0.99 and 1.99 < float(many.max()) < 2
    with pytest.raises(UserError, match="expected a number or"):
        Uniform("x", "y", float("nan"))


# Who stands in it

STANDS = "standing:people=3,at=0,seconds=2.1,speed_std=0,jitter=0"


@pytest.mark.parametrize("physics", ["compiled", "bullet"])
def test_they_stand_until_their_time_is_up(physics: str) -> None:
    env = make_env(prepared(STANDS), num_envs=3, physics=physics)
    seen, _ = as_desired(env, 8)
    env.physics.close()
    begins = seen[0]["agents", "history"][:, 2, 0]
    for step, now in enumerate(seen[:-1]):
        agents = now["agents"]
        # 2.1 s: until the decision at 2.4 s the policy is not asked
        assert (agents["controlled"][:, 2] == (step > 5)).all()
        assert agents["mask"][:, 2].all() and agents["valid"][:, 2].all()
        if step <= 5:
            assert torch.equal(agents["history"][:, 2], begins.unsqueeze(1).expand(3, 8, 2))
            assert agents["velocity"][:, 2].eq(0).all()
    moved = (seen[8]["agents", "history"][:, 2, -1] - begins).norm(dim=-1)
    assert torch.allclose(moved, torch.full((3,), 0.8 * 1.3), atol=0.05)


def test_their_way_and_its_time_begin_when_they_set_out() -> None:
    env = make_env(prepared(STANDS), num_envs=2)
    now = env.reset()
    assert env.state.planned[:, 2].eq(0).all() and env.state.planned[:, 0].gt(2).all()
    env.rollout(6, Watch(factor=0.0), auto_reset=False, tensordict=now)
    # 3 m less the goal's radius of 0.3 m
    assert torch.allclose(env.state.planned[:, 2], torch.tensor(2.7), atol=0.1)
    assert torch.allclose(env.state.deadline[:, 2], torch.tensor(22.4))
    assert torch.allclose(env.state.deadline[:, 0], torch.tensor(20.0))


def test_a_metric_row_is_that_of_an_ordinary_scene() -> None:
    result, _ = rollout(
        "go_to_goal", "standing:width=1.2,at=[-1,-0.8],from_right=1,speed_std=0", "compiled", 12
    )
    assert not result.replayed
    metrics = row("go_to_goal", result)["metrics"]
    assert metrics["success"] == metrics["episode_success"] == 1
    # standing still is no delay of theirs
    assert 0.9 < metrics["time_ratio"] < 1.1
    alone = result.episodes(slice(1))
    assert 20 <= int((alone.present & ~alone.controlled)[0, -1].sum()) <= 52


def test_where_they_stand_is_drawn() -> None:
    _, made = layout("standing")
    assert made.stand is not None
    place, seconds = made.start[:, -1], made.stand[:, -1]
    assert made.stand[:, 0].eq(0).all()
    assert 2 < float(seconds.min()) < 2.1 and 4.9 < float(seconds.max()) < 5
    assert -1 < float(place[:, 0].min()) < -0.95 and 0.95 < float(place[:, 0].max()) < 1
    # some in the door, some on either side of it
    inside = place[:, 0].abs() < 0.15
    assert 0.06 < inside.float().mean() < 0.27 and 0.3 < (place[:, 0] > 0).float().mean() < 0.7
    assert len(made.goal[:, -1].unique()) == 2 * 4  # the two of every width


def test_no_person_stands_in_a_wall() -> None:
    env = make_env("standing:width=[0.7,1.2],thickness=[0.1,0.3],at=[-0.3,0.3]", num_envs=60)
    env.reset()
    distance, _ = env.bank.closest_wall(env.state.position, env.state.map_id, env.state.pose)
    assert float(distance[:, -1].min()) > 0.19
