"""What a controller says about wrong arguments and people in walls; each remembers its own people alone."""

import copy
import pickle
import re
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.scenes import Watch

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy

HALL = rectangles([*room((0, 0), (15, 6), 0.2), (4.0, 2.0, 6.0, 4.0)], resolution=0.1)
"""15 x 6 m with a block of 2 x 2 m in the middle."""

PLAN = replace(HALL, origin=(HALL.origin[0] - 5, HALL.origin[1] - 3, 0.0))
"""The same 5 m to the left and 3 m down: the block is about (0, 0)."""

OFF = r"is at \(40\.00, 1\.00\), outside map"
"""The warning of a person there."""


def controller(plan: Any = PLAN) -> Controller:
    return Controller(load_policy("go_to_goal"), plan)


def test_a_radius_of_people_who_have_left_does_not_matter() -> None:
    walk = controller()
    radius = {"anna": 0.2, 7: 0.3}
    walk.step({"anna": (-4, -2), 7: (-3, -2)}, {"anna": (-4, 2), 7: (-3, 2)}, radius=radius)
    assert list(walk.step({"anna": (-4, -1.9)}, radius=radius)) == ["anna"]
    assert list(walk.step({"anna": (-4, -1.8)}, radius={7: 0.3})) == ["anna"]
    walk.reset()
    with pytest.raises(UserError, match="unknown id in radius '7'"):
        walk.step({"anna": (-4, -2)}, {"anna": (-4, 2)}, radius=radius)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ((40, 1), r"goal \(40\.00, 1\.00\) is outside .* is \(9\.\d\d, \d\.\d\d\)"),
        ((0.0, 0.1), r"goal \(0\.00, 0\.10\) is in a wall .* is \(-1\.\d\d, 0\.\d\d\)"),
    ],
)
def test_goals_are_refused_in_the_frame_of_the_floor_plan(goal: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        controller().step({"anna": (-4, -2)}, {"anna": goal})


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (
            (40, 1),
            rf"^'anna' {OFF} 'plan': .* nearest free place, \(9\.\d\d, \d\.\d\d\); .* frame, in metres\?$",
        ),
        (
            (0.1, 0.6),
            r"'anna' is at \(0\.10, 0\.60\), in a wall of map 'plan': .* place, \(0\.\d\d, 1\.\d\d\)",
        ),
    ],
)
@pytest.mark.parametrize("goal", [(-4, 2), None])
def test_people_in_walls_or_off_the_map_are_warned_of_once(place: Any, goal: Any, message: str) -> None:
    walk = controller()
    walk.step({"bo": (-4, -2)}, {"bo": (-4, 2)})
    with pytest.warns(UserWarning, match=message) as told:
        walk.step({"bo": (-4, -1.5), "anna": place}, {"anna": goal})
    assert len(told) == 1 and told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        walk.step({"bo": (-4, -1.0), "anna": place, "cy": (60, 60)}, {"cy": None})
        walk.reset()
        walk.step({"cy": (60, 60)}, {"cy": None})


def test_several_people_are_counted_and_other_agents_are_not() -> None:
    people = {"anna": (-4, -2), "bo": (40, 1), "cy": (41, 1)}
    with pytest.warns(UserWarning, match=rf"^'bo' \(and 1 more\) {OFF}|^'cy' \(and 1 more\) is at"):
        controller().step(people, dict.fromkeys(people, (-4, 2)), others={"robot": (60, 60)})


@pytest.mark.parametrize("place", [(-0.9, 0.0), (-5.12, 1.0), (-5.2, 1.0), (9.9, 2.9)])
def test_people_may_brush_walls_and_walk_in_from_outside(place: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller().step({"anna": place}, {"anna": (-4, 2)}, others={"robot": (60, 60), "box": (0, 0)})
        controller(None).step({"anna": (900, 900)}, {"anna": (-4, 2)})
        walk = controller()  # who is known may go anywhere
        walk.step({"anna": (-4, -2)}, {"anna": (-4, 2)})
        walk.step({"anna": (40, 1)})


EDGE = rectangles(room((0, 0), (8, 6), 0.1) + wall((4, 0), (4, 6), 0.1), 0.05, name="edge")


AT_WALLS = (3.2, 0.1), (3.9, 3.0), (3.95, 3.0), (3.8, 4.0), (0.07, 5.93)


@pytest.mark.parametrize(
    ("name", "goal"),
    [
        *(("go_to_goal", goal) for goal in AT_WALLS),
        ("orca", AT_WALLS[2]),
        ("approach_net_goal_map.indoor", AT_WALLS[4]),
    ],
)
def test_a_goal_at_a_wall_is_moved_with_a_warning(name: str, goal: Any) -> None:
    walk = Controller(load_policy(name), EDGE, dt=0.1)
    place, asked = np.array([1.5, 1.5]), np.array(goal)
    with pytest.warns(UserWarning, match="goal of 'a'.*0.25 m from a wall of map 'edge'.*moved by") as said:
        place = place + 0.1 * walk.step({"a": place}, {"a": goal})["a"]
    with warnings.catch_warnings(record=True) as again:
        for _ in range(100):
            place = place + 0.1 * walk.step({"a": place}, {"a": goal})["a"]
        walk.step({"a": place, "b": (2, 2)}, {"b": goal})
    assert (len(said), again) == (1, [])
    moved = np.array([float(part) for part in re.findall(r"to \((.*), (.*)\)$", str(said[0].message))[0]])
    assert bool(walk._agents.state["stands"][walk._agents.row["a"]])
    away = np.linalg.norm(moved - asked)
    assert np.linalg.norm(place - asked) < max(0.31, away + 0.16)
    assert place[0] < 4  # on this side of the wall


CROWD = "orca:share=0.5+approach_net_goal_map.indoor"
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
@pytest.mark.parametrize("name", ["go_to_goal", "approach_net_goal_map.indoor"])
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


DT = r"dt {}: expected seconds between two .* at most 0\.4 s$"
SPEED = "pref_speed {} of 0: expected metres per second, above 0"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(({"dt": dt}, DT.format(str(dt).replace("+", "[+]"))) for dt in (0.41, 0.8, 1e8, 0.0, -0.1)),
        *(({"dt": float(dt)}, DT.format(dt)) for dt in ("nan", "inf")),
        ({"dt": 100}, r"dt 100: .* at most 0\.4 s; 100 milliseconds are 0\.1$"),
        ({"dt": "0.1"}, r"dt '0\.1': expected seconds"),
        ({"dt": None}, "dt None: expected seconds"),
        ({"seed": 1.5}, r"seed 1\.5: expected a whole number"),
        ({"seed": None}, "seed None: expected a whole number"),
        ({"map": np.zeros((3, 3))}, "map of type ndarray: expected the name or file of a floor plan"),
        ({"map": "nowhere.yaml"}, r"nowhere\.yaml"),
        ({"clearance": float("nan")}, "clearance nan"),
        *(({"pref_speed": speed}, SPEED.format(speed)) for speed in (50.0, 10.1, 0.0, -1, float("inf"))),
        ({"pref_speed": "fast"}, "pref_speed 'fast' of 0: expected metres per second"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        pedzoo.controller("go_to_goal", **settings).step({0: (0, 0)}, {0: (5, 0)})


def test_policies_that_no_controller_can_ask_are_refused() -> None:
    with pytest.raises(UserError, match="not finite for 'a'"):
        Controller(Watch(factor=float("nan"))).step({"a": (0, 0)}, {"a": (1, 0)})


R, ROBOT = {"r": (3, 3)}, {"robot": (3, 3)}
NO_MAPPING = r"^{0} .*: expected a mapping by id, {0}=\{{'anna': \.\.\.\}}$"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        *(
            ({what: value}, NO_MAPPING.format(what))
            for what in ("people", "goals", "velocities", "others", "radius", "groups")
            for value in (0.3, [(1, 2)])
        ),
        ({"people": {"anna": (1.1, 1), "cy": (3, 3)}}, "no goal for 'cy'"),
        (
            {"others": ROBOT, "radius": {"rbot": 1.0}},
            r"^unknown id in radius 'rbot': did you mean 'robot'\? known: anna, bo, robot$",
        ),
        (
            {"others": ROBOT, "radius": {"robot": 1.0, "Anna": 0.2}},
            "id in radius 'Anna': did you mean 'anna'",
        ),
        ({"others": ROBOT, "radius": {7: 0.2}}, "id in radius '7': known: 'anna', 'bo', 'robot'"),
        ({"others": {"anna": (3, 3)}}, "'anna' is in people and in others"),
        ({"others": {"r": (1, 2, 3)}}, r"others: position \(1, 2, 3\) of 'r': expected two numbers"),
        ({"others": {"r": []}}, r"others: position \[\] of 'r'"),
        ({"others": {"r": "there"}}, "others: position 'there' of 'r'"),
        ({"others": {"r": (float("nan"), 1)}}, "position .* of 'r'.*expected finite"),
        ({"others": R, "velocities": {"r": (1,)}}, "velocity .* of 'r'"),
        ({"others": R, "velocities": {"r": (0.0, 1e6)}}, "velocity .* of 'r'.*at most 100"),
        ({"velocities": {"bo": (1e6, 0.0)}}, "velocity .* of 'bo': expected metres per second, at most 100"),
        ({"people": {"anna": (5000.0, 0.0)}}, "position of 'anna': 4999 m from that at the call before"),
        ({"radius": {"anna": 0}}, "radius 0 of 'anna': expected metres, above 0"),
        ({"radius": {"anna": float("nan")}}, "radius nan of 'anna'"),
        ({"radius": {"anna": 1e9}}, "radius 1000000000.0 of 'anna': .* at most 10: .*millimetres"),
        ({"radius": {"anna": 30}}, "radius 30 of 'anna': .* are these centimetres"),
        ({"others": R, "radius": {"r": "wide"}}, "radius 'wide' of 'r'"),
        ({"others": R, "radius": {"r": 300}}, "radius 300 of 'r'"),
        ({"time": 3.0}, r"time 3\.0: expected later than at the call before, 3"),
        ({"time": 2.9}, r"time 2\.9: expected later"),
        ({"time": float("nan")}, "time nan: expected seconds"),
        ({"time": "now"}, "time 'now': expected seconds"),
        ({"time": None}, "time None: expected at every call or at none"),
    ],
)
def test_wrong_values_are_refused_and_change_nothing(given: dict[str, Any], message: str) -> None:
    walk, other = Controller(Watch(), dt=0.1), Controller(Watch(), dt=0.1)
    goals = {"anna": (8, 1), "bo": (8, 2)}
    usual: dict[str, Any] = {"people": {"anna": (1.1, 1), "bo": (1, 2)}, "goals": goals, "time": 3.1}
    for one in (walk, other):
        one.step({"anna": (1, 1)}, goals, time=3.0)
    with pytest.raises(UserError, match=message):
        walk.step(**usual | given)
    for time in (3.1, 4.1):
        usual["time"] = time
        answers = [one.step(**usual) for one in (walk, other)]
        np.testing.assert_array_equal(list(answers[0].values()), list(answers[1].values()))
    counted = Controller(Watch())
    counted.step({"anna": (1, 1)}, {"anna": (8, 1)})
    with pytest.raises(UserError, match=r"time 3\.0: expected at every call or at none"):
        counted.step({"anna": (1, 1)}, time=3.0)


CELLS = np.zeros((24, 32), dtype=np.uint8)  # rooms of 0.5 m cells, joined by doors of 1 m
CELLS[[0, 12, -1]], CELLS[:, [0, 10, 21, -1]] = OCCUPIED, OCCUPIED
CELLS[[3, 4, 17, 18], 10] = CELLS[[7, 8, 15, 16], 21] = CELLS[12, [4, 5, 15, 16, 27, 28]] = FREE


@pytest.mark.parametrize(
    ("name", "plan", "people"),
    [
        ("go_to_goal", "apartment.7", 60),
        ("go_to_goal", OccupancyGrid(CELLS, 0.5), 60),
        ("orca", OccupancyGrid(CELLS, 0.5), 4),
        ("approach_net_goal_map.indoor", OccupancyGrid(CELLS, 0.5), 3),
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
