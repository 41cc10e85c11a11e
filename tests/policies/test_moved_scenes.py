"""Every policy walks alike wherever the scene lies, and chance decides what nothing else decides."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from helpers.scenes import scene
from numpy.typing import NDArray

from pedzoo.core.registry import POLICIES
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.named_plans import load_plan
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.learned.same_spot import PUSH, led_apart
from pedzoo.policies.load import load_policy

WEIGHTS = ("sgan.zara1", "sgan_pool.zara1", "sgan_goal.indoor", "sgan_goal_map.indoor", "social_vrnn.zara1")
BASELINES = ("constant_velocity", "straight_line", "bent_line", "go_to_goal:safety=true")
WALKERS = (*POLICIES.names(), *BASELINES, *WEIGHTS)
AVOIDING = ("orca", "social_force")
LEARNED = ("sgan_goal_map.indoor", "social_walker.eth_ucy")

policy_of = cache(load_policy)


def walked(
    name: str,
    begin: NDArray[Any],
    goals: NDArray[Any],
    grid: OccupancyGrid | None = None,
    seed: int = 3,
    seconds: float = 10.0,
    deterministic: bool = False,
) -> NDArray[Any]:
    """Return the positions (T, N, 2) of people whom a policy moves, metres, in double precision."""
    policy = policy_of(name)
    controller = Controller(policy, grid, dt=policy.decision_dt, seed=seed, deterministic=deterministic)
    place, result = begin, []
    asked = {one: goals[one] for one in range(len(goals))}
    for _ in range(round(seconds / controller.dt)):
        velocity = controller.step({one: place[one] for one in range(len(place))}, asked)
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


@pytest.mark.parametrize(
    ("name", "apart"),
    [*((name, 0.25) for name in AVOIDING), *((name, 0.01) for name in ("go_to_goal:safety=true", *LEARNED))],
)
def test_people_on_the_same_spot_come_apart(name: str, apart: float) -> None:
    """Models without a memory of the spot, and those that answer alike for equal people, too."""
    begin, goals = np.zeros((2, 2)), np.array([[8.0, 0.0], [8.0, 0.0]])
    path = walked(name, begin, goals, seconds=4.0, deterministic=name in LEARNED)
    assert np.isfinite(path).all()
    assert np.linalg.norm(path[-1, 0] - path[-1, 1]) > apart


def test_people_with_spots_of_their_own_are_not_led_apart() -> None:
    position = torch.tensor([[[0.0, 1.0], [-0.0, 1.0], [0.0, 1.0 + 1e-6], [0.0, 0.0], [0.0, 0.0]]])
    still = torch.zeros_like(position)
    controlled = torch.tensor([[True, True, True, True, False]])
    batch = scene(position, still, still, controlled=controlled)
    batch["agents", "mask"][0, 3] = False
    away = led_apart(batch)[0]
    assert away[:2].norm(dim=1).tolist() == pytest.approx([PUSH, PUSH]) and not torch.equal(*away[:2])
    assert (away[2:] == 0).all()


@pytest.mark.parametrize(("name", "seeds"), [*((name, 8) for name in AVOIDING), ("sgan_goal_map.indoor", 4)])
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
