"""Who comes to a door from where, how far away they are, and when they would be there."""

import pytest
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.scenario import WARM_SECONDS, Layout
from pedzoo.sim.scenarios._base import Uniform
from pedzoo.sim.scenarios.door import ABREAST, SPACING, Door

SCENES = 200


def layout(settings: str) -> tuple[Door, Layout]:
    """Return a door and the starts of some scenes."""
    door = make_scenario(f"door:{settings}")
    assert isinstance(door, Door)
    return door, door.prepare(0.25).layout(Draws.for_episodes(0, torch.arange(SCENES)))


def begun(settings: str) -> tuple[Tensor, Tensor]:
    """Return where people are when episodes begin (B, A, 2), and the speeds that they like (B, A)."""
    state = make_env(f"door:{settings}", num_envs=SCENES)
    state.reset()
    return state.state.position, state.state.pref_speed


def test_the_scenes_of_the_paper_stay_what_they_are() -> None:
    _, plain = layout("people=2")
    _, said = layout("away=2.5,from_right=1,abreast=1")
    for mine, theirs in zip(plain[:5], said[:5], strict=True):
        assert torch.equal(mine, theirs)
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
    bank = make_env("door:width=[0.7,0.9],thickness=0.1,people=1").bank
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
    position, _ = begun("away=[2.5,4],jitter=0,offset=0")
    away = position[..., 0].abs()
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
    position, speed = begun("sync=0.4")
    seconds = position.norm(dim=-1) / speed
    assert float((seconds[:, 1] - seconds[:, 0]).abs().max()) < 0.41


def test_queues_are_in_time_by_their_first_ones() -> None:
    door, made = layout("sync=0,people=5,from_right=2,speed_std=0.2")
    seconds = made.start[:, :2].norm(dim=-1) / made.pref_speed[:, :2]
    assert torch.allclose(seconds[:, 0], seconds[:, 1], atol=1e-4)
    assert float(made.start[..., 0].abs().max()) < door.half_length - 0.5


def test_mirror_images_from_any_distance() -> None:
    state = make_env("door:jitter=0,speed_std=0,offset=[0,0.6],away=[2.5,4],sync=0", num_envs=SCENES)
    state.reset()
    past = state.state.past
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
    state = make_env("door:people=4,from_right=1,offset=0.6")
    state.reset()
    expected = torch.tensor([[3.0, -0.6], [-3.0, 0.6], [3.0, -0.6], [3.0, -0.6]])
    assert torch.allclose(state.state.goal_point[0], expected, atol=0.04)


@pytest.mark.parametrize("settings", ["people=6,from_right=0", "people=7,from_right=3,abreast=2"])
def test_no_person_starts_in_another_person(settings: str) -> None:
    door, made = layout(f"{settings},speed_std=0.3")
    apart = torch.cdist(made.start, made.start) + 9 * torch.eye(door.people)
    assert float(apart.min()) > min(SPACING, ABREAST) - 1e-3
    position, _ = begun(f"{settings},speed_std=0.3")
    apart = torch.cdist(position, position) + 9 * torch.eye(door.people)
    assert float(apart.min()) > 2 * BODY_RADIUS


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
