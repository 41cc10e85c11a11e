"""Robots' policies on cases by hand: the sampling planner, the dynamic window, ORCA and social forces."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.policies.load import load_local_planner
from pedzoo.policies.robots._base import DriveState, ObservedPeople, Robot
from pedzoo.policies.robots.baselines import Sampling, people_gap
from pedzoo.policies.robots.dwa import Dwa, arc

STEP = 0.25
SAMPLING = Sampling(horizon=8, margin=0.2, discount=1.0, margin_cost=4.0, collision_cost=10.0, time_step=STEP)


def robots(goal: list[float], count: int = 1, velocity: tuple[float, float] = (0.0, 0.0)) -> Robot:
    """Robots of 0.3 m in the origin that go up to 1 m/s."""
    place = torch.zeros(count, 2)
    moving, end = torch.tensor([velocity] * count), torch.tensor([goal] * count)
    return Robot(place, moving, end, place[:, 0] + 0.3, place[:, 0] + 1)


def people(*each: tuple[float, float, float, float], count: int = 1) -> ObservedPeople:
    """The same people in each scene: x, y, and their velocities."""
    states = torch.tensor(each).reshape(1, len(each), 4).expand(count, -1, -1)
    radius = torch.full(states.shape[:2], 0.3)
    return ObservedPeople(states[..., :2], states[..., 2:], radius, radius > 0)


def turned(part: Tensor, angle: float) -> Tensor:
    return rotate(part, torch.tensor([math.cos(angle), math.sin(angle)]))


def wall(points: Tensor) -> Tensor:
    """Distances (B, M) of points from a wall along x = 1."""
    return (points[..., 0] - 1).abs()


@pytest.mark.parametrize("name", [name for name in ROBOT_POLICIES.names() if name != "attention"])
def test_robots_keep_their_top_speed_and_ignore_the_absent(name: str) -> None:
    random = torch.Generator().manual_seed(0)
    place, goal, crowd = (torch.randn(16, *shape, generator=random) * 4 for shape in ((2,), (2,), (3, 4)))
    radius = torch.full((16, 3), 0.3)
    robot = Robot(place, torch.zeros_like(place), goal, radius[:, 0], torch.full((16,), 0.8))
    mask = torch.rand(16, 3, generator=random) > 0.3
    seen = ObservedPeople(crowd[..., :2], crowd[..., 2:] / 8, radius, mask)
    chosen = load_local_planner(name, STEP)(robot, seen)
    assert chosen.shape == (16, 2) and chosen.isfinite().all()
    assert (chosen.norm(dim=-1) <= 0.8 + 1e-5).all()
    garbage = torch.where(mask[..., None], seen.position, torch.nan)
    absent = seen._replace(position=garbage, velocity=torch.where(mask[..., None], seen.velocity, torch.nan))
    assert torch.equal(load_local_planner(name, STEP)(robot, absent), chosen)
    no_people = ObservedPeople(*(part[:, :0] for part in seen))
    assert load_local_planner(name, STEP)(robot, no_people).shape == (16, 2)


@pytest.mark.parametrize(
    ("name", "goal", "others", "expected"),
    [
        ("crowdnav_orca", [3.0, 4.0], [], [0.6, 0.8]),
        # the cut-off disc around (3, 0) / 5 s of radius 0.62 / 5 s begins at 0.476 m/s; half of it is 0.238
        ("crowdnav_orca", [4.0, 0.0], [(3.0, 0.0, 0.0, 0.0)], [0.238, 0.0]),
        # at rest a quarter of a second of the acceleration of 1 m/s^2 towards the goal, ...
        ("crowdnav_social_force", [3.0, 4.0], [], [0.15, 0.2]),
        # ... and 2 exp(-(1.6 - 0.6)) m/s^2 away from a person
        ("crowdnav_social_force", [4.0, 0.0], [(1.6, 0.0, 0.0, 0.0)], [0.25 * (1 - 2 * math.exp(-1)), 0.0]),
    ],
)
def test_orca_and_social_forces_by_hand(name: str, goal: list[float], others: Any, expected: Any) -> None:
    chosen = load_local_planner(name, STEP)(robots(goal), people(*others))[0]
    assert chosen.tolist() == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("goal", "others", "expected"),
    [
        ([4.0, 0.0], [], [1.0, 0.0]),
        ([-3.0, 4.0], [], [-0.6, 0.8]),
        ([4.0, 0.0], [(2.0, 1.0, -1.0, 0.0)], [1.0, 0.0]),  # who passes beside
        ([1.0, 0.0], [(2.4, 0.0, 0.0, 0.0)], [1.0, 0.0]),  # who is behind the goal
    ],
)
def test_on_a_free_way_it_goes_straight(goal: list[float], others: Any, expected: list[float]) -> None:
    assert SAMPLING(robots(goal), people(*others))[0].tolist() == pytest.approx(expected, abs=1e-6)


def test_samples_are_directions_times_speeds_and_standing() -> None:
    made = Sampling(directions=4, speeds=2).velocities(robots([0.0, 5.0]))[0]
    expected = [[0, 1], [0, 0.5], [-1, 0], [-0.5, 0], [0, -1], [0, -0.5], [1, 0], [0.5, 0], [0, 0]]
    assert torch.allclose(made, torch.tensor(expected, dtype=torch.float32), atol=1e-6)


def test_gaps_are_those_on_the_way_of_each_step() -> None:
    # A person crosses from (1, -1) at 2 m/s, a robot goes at 1 m/s. Relative to it the person moves
    # (-1, 2) m/s: after 0.25 s at (0.75, -0.5), after 0.5 s at (0.5, 0). Nearest is the end of each step;
    # in the third, after 0.6 s, it is at (0.4, 0.2): the whole way's nearest point, 0.447 m.
    robot, crowd = robots([4.0, 0.0]), people((1.0, -1.0, 0.0, 2.0))
    gap = people_gap(robot, crowd, torch.tensor([[[1.0, 0.0], [0.0, 0.0]]]), STEP, 4)[0]
    expected = [math.hypot(0.75, 0.5), 0.5, math.hypot(0.4, 0.2), math.hypot(0.25, 0.5)]
    assert gap[0].tolist() == pytest.approx([one - 0.6 for one in expected], abs=1e-5)
    # at rest the person passes at 1 m after 0.5 s
    assert gap[1, 1].item() == pytest.approx(0.4, abs=1e-5)


def test_it_gives_way_and_never_touches_who_walks_on() -> None:
    robot, crowd = robots([4.0, 0.0]), people((2.0, 0.0, -1.0, 0.0))
    chosen = SAMPLING(robot, crowd)
    assert abs(float(chosen[0, 1])) > 0.2
    assert people_gap(robot, crowd, chosen[:, None], STEP, 8).min() >= 0


def test_it_stands_where_every_way_is_blocked() -> None:
    ring = [(0.9 * math.cos(k * math.pi / 6), 0.9 * math.sin(k * math.pi / 6), 0.0, 0.0) for k in range(12)]
    assert SAMPLING(robots([4.0, 0.0]), people(*ring)).norm() == 0


def test_planners_leave_people_whom_they_touch() -> None:
    touching = people((0.5, 0.0, 0.0, 0.0))
    chosen = SAMPLING(robots([4.0, 0.0]), touching)[0]
    assert (chosen * STEP - touching.position[0, 0]).norm() > 0.52
    speed, _ = DWA.command(robots([-4.0, 0.0]), drive(0.0, heading=math.pi), touching)
    assert speed.item() == pytest.approx(0.25)


def test_walls_count_as_people_do() -> None:
    robot = robots([4.0, 0.0])
    chosen = SAMPLING(robot, people(), wall)[0]
    assert float(chosen[0]) * SAMPLING.horizon * STEP < 0.7  # it stays 0.3 m from the wall at x = 1


def test_its_answer_turns_with_the_scene_in_any_batch() -> None:
    random = torch.Generator().manual_seed(1)
    crowd = people(*(torch.randn(5, 4, generator=random) * torch.tensor([2.0, 2.0, 0.5, 0.5])).tolist())
    robot = robots([4.0, 1.0])
    chosen = SAMPLING(robot, crowd)
    for angle in (0.7, 2.9):
        other = crowd._replace(position=turned(crowd.position, angle), velocity=turned(crowd.velocity, angle))
        rotated = SAMPLING(robot._replace(goal=turned(robot.goal, angle)), other)
        assert torch.allclose(rotated, turned(chosen, angle), atol=1e-4)
    many = Robot(*(part.expand(3, *part.shape[1:]) for part in robot))
    others = ObservedPeople(*(part.expand(3, *part.shape[1:]) for part in crowd))
    assert torch.equal(SAMPLING(many, others), chosen.expand(3, 2))


@pytest.mark.parametrize(
    "wrong", ["sampling:horizon=0", "sampling:discount=1.5", "sampling:margin=-0.1", "dwa:acceleration=0"]
)
def test_settings_of_planners_are_checked(wrong: str) -> None:
    with pytest.raises(UserError, match=wrong.partition("=")[0].replace(":", ": ") + ".*: expected"):
        load_local_planner(wrong, STEP)


DWA = Dwa(acceleration=1.0, turn_acceleration=2.0, top_turn_rate=1.0, speeds=3, turn_rates=3, time_step=STEP)


def drive(speed: float, turn_rate: float = 0.0, heading: float = 0.0) -> DriveState:
    return DriveState(*(torch.tensor([value]) for value in (heading, speed, turn_rate)))


def test_the_window_is_what_a_step_can_reach() -> None:
    speed, turn_rate = DWA.window(drive(0.9, 0.8), torch.tensor([1.0]))
    assert speed[0, ::3].tolist() == pytest.approx([0.65, 0.825, 1.0])
    assert turn_rate[0, :3].tolist() == pytest.approx([0.3, 0.65, 1.0])
    speed, _ = DWA.window(drive(0.1), torch.tensor([1.0]))
    assert speed[0, ::3].tolist() == pytest.approx([0.0, 0.175, 0.35])  # not backwards


def test_arcs_are_circles() -> None:
    # 1 m/s and pi/2 rad/s for a second: a quarter of a circle of radius 2 / pi, from facing x to facing y
    quarter = arc(torch.tensor(0.0), torch.tensor(1.0), torch.tensor(math.pi / 2), 1.0)
    assert quarter.tolist() == pytest.approx([2 / math.pi, 2 / math.pi], abs=1e-6)
    ahead = arc(torch.tensor(math.pi / 2), torch.tensor(1.0), torch.tensor(0.0), 2.0)
    assert ahead.tolist() == pytest.approx([0.0, 2.0], abs=1e-6)


def test_arcs_are_free_until_the_margin() -> None:
    robot, ahead = robots([4.0, 0.0]), people((2.0, 0.0, 0.0, 0.0))
    speed, turn_rate = torch.tensor([[1.0, 0.5, 0.0]]), torch.zeros(1, 3)
    free = DWA.free_seconds(robot, drive(1.0), ahead, speed, turn_rate)
    # 2 - 0.3 - 0.3 - 0.1 = 1.3 m: up to 1.2 s at 1 m/s, up to 2.5 s at 0.5 m/s, and for all 3 s at rest
    assert free[0].tolist() == pytest.approx([1.2, 2.5, 3.0], abs=1e-5)
    comes = people((2.0, 0.0, -1.0, 0.0))
    meeting = DWA.free_seconds(robot, drive(1.0), comes, speed[:, :1], turn_rate[:, :1])
    assert meeting[0, 0].item() == pytest.approx(0.6)
    behind_wall = DWA.free_seconds(robot, drive(1.0), people(), speed[:, :1], turn_rate[:, :1], wall)
    assert behind_wall[0, 0].item() == pytest.approx(0.5)


def test_it_keeps_its_pace_on_a_free_way_and_brakes_for_a_wall() -> None:
    command = DWA.command(robots([9.0, 0.0]), drive(1.0), people())
    assert [part.item() for part in command] == pytest.approx([1.0, 0.0], abs=1e-6)
    # 0.6 m from the wall at x = 1 less 0.3 m of its body: from 1 m/s it cannot stop any more, and brakes
    near = robots([9.0, 0.0])._replace(position=torch.tensor([[0.4, 0.0]]))
    speed, _ = DWA.command(near, drive(1.0), people(), wall)
    assert speed.item() == pytest.approx(0.75)


def test_it_turns_to_its_goal_within_its_limits() -> None:
    _, turn_rate = DWA.command(robots([0.0, 5.0]), drive(0.0), people())
    assert turn_rate.item() == pytest.approx(0.5)
    mine = Dwa(time_step=STEP)
    body, before = robots([3.0, 0.5]), torch.zeros(1, 2)
    for _ in range(40):
        velocity = mine(body, people())
        assert (velocity - before).norm() <= 0.25 * 1.0 + 0.25 * 1.5 + 1e-5  # accelerations and turns
        body, before = body._replace(position=body.position + STEP * velocity), velocity
        if (body.goal - body.position).norm() < 0.3:
            break
    assert (body.goal - body.position).norm() < 0.3
