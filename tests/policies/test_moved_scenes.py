"""Every policy walks alike wherever the scene lies, and chance decides what nothing else decides."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from helpers.scenes import scene
from numpy.typing import NDArray

from pedzoo.core.registry import POLICIES
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import load_plan
from pedzoo.models.blocks.people.crowd import share_seen
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.neighbours import ROOM, separation_push

WEIGHTS = (
    "sgan_nopool.zara1",
    "sgan.zara1",
    "approach_net_goal.indoor",
    "approach_net_goal_map.indoor",
    "social_vrnn.zara1",
)
BASELINES = ("constant_velocity", "straight_line", "bent_line", "go_to_goal:safety=true")
WALKERS = (*POLICIES.names(), *BASELINES, *WEIGHTS)
AVOIDING = ("orca", "social_force")
SEEING = (
    *AVOIDING, "go_to_goal:safety=true", "sgan.zara1", "approach_net_goal.indoor",
    "approach_net_goal_map.indoor",
    "sgan_goal_map.zara1", "social_vrnn.zara1", "social_walker.indoor", "social_walker.styled",
    "social_walker.zara1", "anchor_net.zara1", "anchor_net_goal_map.indoor",
)  # fmt: skip
# as published, in the world's axes; and corrections end at a threshold, which is felt by 1.1 mm
TURNING = tuple(name for name in SEEING if name not in ("sgan.zara1", "go_to_goal:safety=true"))
PASSING = (
    "orca", "social_force:preset=indoor", "go_to_goal:safety=true", "approach_net_goal_map.indoor",
    "social_walker.styled",
)  # fmt: skip
policy_of = cache(load_policy)


def walked(
    name: str,
    begin: NDArray[Any],
    goals: NDArray[Any],
    grid: OccupancyGrid | None = None,
    seed: int = 3,
    seconds: float = 10.0,
    deterministic: bool = False,
    far: NDArray[Any] | None = None,
    robot: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """Return the positions (T, N, 2) of people whom a policy moves, metres, in double precision.

    Someone ``far`` goes 10 m to the side, and a robot beside them stays; or a ``robot`` stays.
    """
    policy = policy_of(name)
    controller = Controller(policy, grid, dt=policy.decision_dt, seed=seed, deterministic=deterministic)
    place, result = begin, []
    asked = {one: goals[one] for one in range(len(goals))}
    beside = {} if far is None else {-1: far}
    asked |= {one: goal + np.array([0.0, 10.0]) for one, goal in beside.items()}
    robots = {99: far if robot is None else robot} if beside or robot is not None else {}
    for _ in range(round(seconds / controller.dt)):
        people = {one: place[one] for one in range(len(place))} | beside
        velocity = controller.step(people, asked, others=robots)
        place = place + controller.dt * np.stack([velocity[one] for one in range(len(place))])
        result.append(place)
        asked = {}
    return np.stack(result)


@pytest.mark.parametrize("indoors", [False, True])
@pytest.mark.parametrize("name", WALKERS)
def test_walks_are_the_same_1_km_and_500_km_away(name: str, indoors: bool) -> None:
    """Six people who meet; 4,650 km is how far north map projections put central Europe."""
    column = np.arange(6)
    begin = np.stack((0.8 + 1.4 * column, np.full(6, 4.6)), 1)
    goals = np.stack((8.3 - 1.4 * column, 1.5 + column % 2 * 6), 1)
    grid = load_plan("flat") if indoors else None
    near = walked(name, begin, goals, grid)
    assert np.abs(near[-1] - begin).max() > 1
    offsets = [[1000.0, -700.0], [1234.56, 987.65], [500_000.37, 4_649_776.11]]
    # double precision has 1 nm there, and where forces of walls and people balance, the last digit decides
    exact = (name, indoors) == ("social_force", True)
    for offset in offsets[:2] if exact else offsets[::2]:
        moved = grid and replace(grid, origin=(*np.add(grid.origin[:2], offset).tolist(), grid.origin[2]))
        far = walked(name, begin + offset, goals + offset, moved)
        assert np.abs(far - offset - near).max() < (1e-8 if exact else 5e-3)


def met(seconds: float, deterministic: bool = False, angle: float = 0.0, **more: Any) -> NDArray[Any]:
    """Return where five people (T, 5, 2) who meet in the open are, metres, turned back by the angle."""
    begin = np.array([[0.0, 0.0], [1.2, 3.1], [5.3, 0.4], [6.0, 3.5], [2.9, -2.2]])
    goals = np.array([[9.0, 0.5], [8.0, -3.0], [-4.0, 0.2], [-3.0, -1.0], [3.1, 7.0]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    more = {"seconds": seconds, "deterministic": deterministic, **more}
    return walked(begin=begin @ turn, goals=goals @ turn, **more) @ turn.T


@pytest.mark.parametrize("name", SEEING)
def test_nobody_beyond_30_m_matters(name: str) -> None:
    """A person and a robot, 40 m to 9 km away: there the scene gets another origin, so another rounding."""
    alone = met(4.0, name=name)
    for place, most in (([-25.0, -40.0], 2e-4), ([9000.0, -100.0], 3e-4)):
        assert np.abs(met(4.0, name=name, far=np.array(place)) - alone).max() < most


def test_others_fade_between_25_and_30_m() -> None:
    away = torch.tensor([[0.0, 25.0], [-27.5, 0.0], [18.0, 24.0], [0.0, 0.0], [3e4, 0.0]])
    assert share_seen(away).tolist() == [1.0, 0.5, 0.0, 1.0, 0.0]


@pytest.mark.parametrize("name", TURNING)
def test_turned_scenes_are_walked_alike(name: str) -> None:
    assert np.abs(met(5.0, name=name, angle=0.7) - met(5.0, name=name)).max() < 1e-3


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("name", PASSING)
def test_those_who_meet_exactly_head_on_pass_without_chance(name: str, angle: float) -> None:
    """Two, and four at a crossing."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    for begin in ([[-3.0, 0.0], [3.0, 0.0]], [[-3.0, 0.0], [3.0, 0.0], [0.0, 3.0], [0.0, -3.0]]):
        path = walked(name, np.array(begin) @ turn, -np.array(begin) @ turn, seconds=9.0, deterministic=True)
        assert np.linalg.norm(path[-1] + np.array(begin) @ turn, axis=1).max() < 0.4
        apart = [np.linalg.norm(path[:, i] - path[:, j], axis=1) for i in range(len(begin)) for j in range(i)]
        assert np.min(apart) > 0.2


@pytest.mark.parametrize("people", [3, 6])
@pytest.mark.parametrize("name", PASSING)
def test_people_on_the_same_spot_come_apart(name: str, people: int) -> None:
    """With one goal and with one each, within 2 s, and they stay so."""
    angle = 2 * np.pi * np.arange(people) / people
    for goals in (np.tile([20.0, 3.0], (people, 1)), 20 * np.stack((np.cos(angle), np.sin(angle)), 1)):
        path = walked(name, np.zeros((people, 2)), goals, seconds=4.0, deterministic=True)
        later = path[len(path) // 2 :]
        apart = [np.linalg.norm(later[:, i] - later[:, j], axis=1) for i in range(people) for j in range(i)]
        assert np.min(apart) > 0.28


def test_one_who_begins_on_a_robot_leaves_it() -> None:
    place = np.zeros((1, 2))
    for name in PASSING:
        path = walked(name, place, np.array([[8.0, 0.0]]), seconds=2.0, robot=np.zeros(2))
        assert np.linalg.norm(path[-1]) > 1


def test_people_with_spots_of_their_own_are_not_pushed() -> None:
    """Two on one spot leave it to either side of their ways; absent ones and robots take no part."""
    position = torch.tensor([[[0.0, 1.0], [-0.0, 1.0], [0.0, 1.1], [0.0, 0.0], [0.0, 0.0]]])
    still = torch.zeros_like(position)
    controlled = torch.tensor([[True, True, True, True, False]])
    batch = scene(position, still, still + torch.tensor([1.0, 0.0]), controlled=controlled)
    batch["agents", "mask"][0, 3] = False
    away = separation_push(batch)[0]
    assert away[0].tolist() == pytest.approx([0.0, BODY_RADIUS + ROOM / 2], abs=1e-6)
    assert torch.equal(away[1], -away[0]) or torch.allclose(away[1], -away[0], atol=1e-6)
    assert (away[2:] == 0).all()


@pytest.mark.parametrize(
    ("name", "seeds"), [*((name, 8) for name in AVOIDING), ("approach_net_goal_map.indoor", 4)]
)
def test_seeds_decide_encounters_of_mirror_images(name: str, seeds: int) -> None:
    """Two people head-on: they pass each other, on the one side by some seeds and on the other by others."""
    begin, goals = np.array([[-4.0, 0.0], [4.0, 0.0]]), np.array([[4.0, 0.0], [-4.0, 0.0]])
    sides = set()
    for seed in range(seeds):
        path = walked(name, begin, goals, seed=seed)
        assert np.linalg.norm(path[:, 0] - path[:, 1], axis=1).min() > 0.25
        assert (np.abs(path[-1] - goals) < 1.0).all()
        sides.add(bool(path[len(path) // 3, 0, 1] > 0))
    assert sides == {False, True}
