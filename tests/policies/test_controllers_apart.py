"""Controllers remember their own people alone: beside others, in copies, and after a reset."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from tests.policies.test_controller_inputs import PLAN

CROWD = "orca:share=0.5+sgan_goal_map.indoor"
WALKER = "social_walker.styled"


def walked(
    controllers: list[Controller], starts: list[dict[Any, Any]], goals: list[dict[Any, Any]], steps: int
) -> list[np.ndarray[Any, Any]]:
    """Return where the people of some controllers are after each step (T, N, 2); all are called in turn."""
    people, paths = [{one: np.array(xy) for one, xy in start.items()} for start in starts], []
    for step in range(steps):
        for now, controller, goal in zip(people, controllers, goals, strict=True):
            velocity = controller.step(now, goal if step == 0 else None)
            now |= {one: now[one] + controller.dt * velocity[one] for one in now}
        paths.append([np.array(list(now.values())) for now in people])
    return [np.array(path) for path in zip(*paths, strict=True)]


EAST = {i: (-4.0, 0.8 * i - 2.5) for i in range(6)}, {i: (6.0, 0.8 * i - 2.5) for i in range(6)}
WEST = {i: (4.0, 0.8 * i - 2.5) for i in range(6)}, {i: (-6.0, 0.8 * i - 2.5) for i in range(6)}


@pytest.mark.parametrize("name", [CROWD, WALKER])
def test_two_controllers_of_one_policy_walk_as_each_alone(name: str) -> None:
    policy = load_policy(name)
    alone = walked([Controller(policy, dt=0.1)], [EAST[0]], [EAST[1]], 12)[0]
    both = [Controller(policy, dt=0.1) for _ in range(2)]
    beside = walked(both, [EAST[0], WEST[0]], [EAST[1], WEST[1]], 12)
    np.testing.assert_array_equal(beside[0], alone)


def test_a_reset_forgets_how_people_began() -> None:
    used, new = (Controller(load_policy(WALKER), dt=0.4) for _ in range(2))
    used.step({1: (0, 0)}, {1: (9, 0)}, velocities={1: (0, 0)})
    walked([used], [{1: (0.0, 0.0)}], [{}], 20)
    used.reset(0)
    start, goal = {1: (0.0, 0.0), 2: (3.0, 0.5)}, {1: (9, 0), 2: (-5, 0)}
    first, second = [walked([one], [start], [goal], 10)[0] for one in (used, new)]
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda walk: pickle.loads(pickle.dumps(walk))])
@pytest.mark.parametrize("name", ["go_to_goal", "sgan_goal_map.indoor"])
def test_a_copy_goes_on_as_the_controller(name: str, again: Any) -> None:
    walk = Controller(load_policy(name), PLAN, dt=0.1)
    start, goal = {1: (-4.0, 0.1)}, {1: (4.0, 0.0)}
    walked([walk], [start], [goal], 5)
    first, second = [walked([one], [start], [{}], 25)[0] for one in (again(walk), walk)]
    np.testing.assert_array_equal(first, second)
    assert first[-1, 0, 0] > -3.5


@pytest.mark.parametrize("name", ["orca", "social_force"])
def test_without_noise_the_seed_does_not_matter(name: str) -> None:
    def first(seed: int, deterministic: bool) -> list[float]:
        walk = Controller(load_policy(name), dt=0.1, seed=seed, deterministic=deterministic)
        return walk.step({1: (0, 0)}, {1: (5, 0)})[1].tolist()

    assert first(0, True) == first(1, True)
    assert first(0, False) != first(1, False) or name == "social_force"  # which fluctuates only if asked to


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"dt": "0.1"}, r"dt '0\.1': expected seconds"),
        ({"dt": None}, "dt None: expected seconds"),
        ({"seed": 1.5}, r"seed 1\.5: expected a whole number"),
        ({"seed": None}, "seed None: expected a whole number"),
        ({"map": np.zeros((3, 3))}, "map of type ndarray: expected the name or file of a floor plan"),
        ({"clearance": float("nan")}, "clearance nan"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        pedzoo.controller("go_to_goal", **settings)


def test_wrong_times_and_speeds_are_refused() -> None:
    policy = load_policy("go_to_goal")
    with pytest.raises(UserError, match="pref_speed 'fast' of 1: expected metres per second"):
        Controller(policy, pref_speed="fast").step({1: (0, 0)}, {1: (5, 0)})  # pyright: ignore
    with pytest.raises(UserError, match="time 'now': expected seconds"):
        Controller(policy).step({1: (0, 0)}, {1: (5, 0)}, time="now")  # pyright: ignore
    walk = Controller(policy)
    walk.step({1: (0, 0), 2: (2, 0)}, {1: (5, 0), 2: (7, 0)}, radius={1: 0.2})
    walk.step({2: (2, 0)})
    assert list(walk.step({2: (2, 0)}, radius={1: 0.2})) == [2]


CELLS = np.zeros((24, 32), dtype=np.uint8)  # rooms of 0.5 m cells, joined by doors of 1 m
CELLS[[0, 12, -1]], CELLS[:, [0, 10, 21, -1]] = OCCUPIED, OCCUPIED
CELLS[[3, 4, 17, 18], 10] = CELLS[[7, 8, 15, 16], 21] = CELLS[12, [4, 5, 15, 16, 27, 28]] = FREE


@pytest.mark.parametrize(
    ("name", "plan", "people"),
    [
        ("go_to_goal", "apartment.7", 60),
        ("go_to_goal", OccupancyGrid(CELLS, 0.5), 60),
        ("orca", OccupancyGrid(CELLS, 0.5), 4),
        ("sgan_goal_map.indoor", OccupancyGrid(CELLS, 0.5), 3),
    ],
)
def test_people_who_walk_alone_arrive(name: str, plan: Any, people: int) -> None:
    together = name == "go_to_goal"  # which does not see anybody
    policy, rng, count = load_policy(name), np.random.default_rng(0), 1 if together else people
    dt = min(0.2, policy.decision_dt)
    controllers = [Controller(policy, plan, dt=dt) for _ in range(count)]
    graph = controllers[0]._online_goals.planner.graph(0)
    main = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    start, goal = graph.xy[rng.choice(main, people)], np.zeros((0, 2))
    for place in graph.xy[rng.permutation(main)]:  # where others stand nobody else comes to rest
        if len(goal) < people and (np.linalg.norm(goal - place, axis=1) > 0.65).all():
            goal = np.vstack((goal, place))
    assert len(goal) == people

    def given(places: np.ndarray[Any, Any]) -> list[dict[Any, Any]]:
        return [dict(enumerate(some)) for some in np.split(places, count)]

    path = np.concatenate(list(walked(controllers, given(start), given(goal), round(40 / dt))), axis=1)
    assert np.linalg.norm(path[-1] - goal, axis=1).max() < 0.3
