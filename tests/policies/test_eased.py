"""How people of a controller start and stop, at any clock and where hosts move them otherwise than told."""

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from helpers.scenes import Watch
from helpers.walks import hosted
from numpy.typing import NDArray

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.plans import rectangles, room
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy

RULES = ("go_to_goal", "orca", "social_force:preset=indoor")
LEARNED = ("go_to_goal:safety=true", "approach_net_goal_map.indoor", "social_walker.indoor")
CROWD = "orca:share=0.5+approach_net_goal_map.indoor"

policy_of = cache(load_policy)
Array = NDArray[Any]


def at_rest(path: Array, answers: Array, goal: Array, dt: float) -> None:
    """Check that people have come to rest on their goals, and stay there for the last second."""
    last = max(1, round(1 / dt))
    assert np.linalg.norm(path[-1] - goal, axis=-1).max() <= 0.1
    assert np.linalg.norm(path[-last:] - path[-1], axis=-1).max() < 0.1
    assert np.linalg.norm(answers[-last:], axis=-1).max() < 0.1


def accelerations(answers: Array, dt: float) -> Array:
    """Return the changes of velocities (T, N), of their means over 0.1 s for shorter calls, m/s^2."""
    calls = max(1, round(0.1 / dt))
    mean = np.stack([answers[i : len(answers) - calls + i + 1] for i in range(calls)]).mean(0)
    return np.linalg.norm(mean[calls:] - mean[:-calls], axis=-1) / (calls * dt)


@pytest.mark.parametrize(
    ("name", "dt"),
    [
        *(("go_to_goal", dt) for dt in (0.02, 0.04, 0.17, 0.4)),
        *((name, 0.1) for name in (*RULES, *LEARNED)),
        (CROWD, 0.3),
        ("orca", 0.4),
    ],
)
def test_people_start_and_brake_as_people_do(name: str, dt: float) -> None:
    """From rest to goals 0 to 7 m away, people far apart: at most 2.5 m/s^2 at both ends of the walk."""
    start = 60.0 * np.stack((np.arange(8), np.zeros(8)), 1)
    away = np.array([0.0, 0.05, 0.2, 0.35, 0.6, 1.0, 3.0, 7.0])
    angle = np.arange(8.0)
    goal = start + away[:, None] * np.stack((np.cos(angle), np.sin(angle)), 1)
    controller = Controller(policy_of(name), dt=dt, pref_speed={6: 0.7, 7: 1.6})
    still = {one: (0.0, 0.0) for one in range(8)}
    path, answers = hosted(controller, start, {0: dict(enumerate(goal))}, 11.0, still)
    at_rest(path, answers, goal, dt)
    change = accelerations(np.concatenate((np.zeros((1, 8, 2)), answers)), dt)
    if name not in RULES:  # between its ends a walk is the policy's
        begins = np.arange(len(change))[:, None] * dt < 0.4
        change = np.where(begins | (np.linalg.norm(path[: len(change)] - goal, axis=-1) < 0.7), change, 0.0)
    assert change.max() <= 2.5 + 1e-6


@pytest.mark.parametrize(
    ("name", "dt"), [("go_to_goal", 0.04), ("go_to_goal", 0.2), ("orca", 0.1), (RULES[2], 0.1)]
)
def test_goals_that_come_change_and_go_at_any_moment(name: str, dt: float) -> None:
    """New people at speed, goals within the braking distance, changed while braking, and taken away."""
    start = 60.0 * np.stack((np.arange(8), np.zeros(8)), 1)
    ways = {0: [(4, 0), (0.5, 0), (0.1, 0), None, *[(4, 0)] * 4]}
    later = {2.9: {4: (6, 2), 5: None}, 3.1: {6: (5, -3), 5: (7, 0)}, 7.0: {7: (8, 0)}}
    ways |= {math.ceil(time / dt): way for time, way in later.items()}
    goals: dict[int, Any] = {}
    for call, given in ways.items():
        some = given.items() if isinstance(given, dict) else enumerate(given)
        goals[call] = {one: None if way is None else start[one] + way for one, way in some}
    moving = {one: (1.3, 0.0) for one in range(8)}
    path, answers = hosted(Controller(policy_of(name), dt=dt), start, goals, 14.0, moving)
    last = [(4, 0), (0.5, 0), (0.1, 0), path[-1, 3] - start[3], (6, 2), (7, 0), (5, -3), (8, 0)]
    at_rest(path, answers, start + np.array(last), dt)
    assert np.linalg.norm(path[-1, 3] - start[3]) < 0.7  # who is to stand brakes
    change = accelerations(np.concatenate(([(1.3, 0.0) + 0 * start], answers)), dt)
    assert change.max() <= 2.5 + 1e-6
    # the next goal comes in time: nobody stops in between
    assert np.linalg.norm(answers[math.ceil(2.9 / dt) : math.ceil(4 / dt), 4], axis=1).min() > 0.3


@pytest.mark.parametrize("name", ["orca", "go_to_goal:safety=true", "approach_net_goal_map.indoor"])
def test_nobody_is_touched_where_many_arrive(name: str) -> None:
    """Eight people with one goal, or with two for four each, in a room of 8 m."""
    plan = rectangles(room((-4, -4), (4, 4), 0.1), resolution=0.1)
    angle = np.arange(8) * math.tau / 8 + 0.2
    start = (2.2 + 0.15 * np.arange(8))[:, None] * np.stack((np.cos(angle), np.sin(angle)), 1)
    for goals in (np.zeros((8, 2)), np.array([[1.5, 0.0], [-1.5, 0.0]])[np.arange(8) % 2]):
        controller = Controller(policy_of(name), plan, dt=0.1)
        path, answers = hosted(controller, start, {0: dict(enumerate(goals))}, 5.0)
        apart = np.linalg.norm(path[:, :, None] - path[:, None], axis=-1) + 9 * np.eye(8)
        assert apart.min() >= 0.3 - 5e-3
        nearest = np.linalg.norm(path[-1] - goals, axis=1)
        assert nearest.min() < 0.3 and np.median(nearest) < 0.8
        assert np.linalg.norm(answers[-1][nearest < 0.3], axis=1).max() < 0.1


def curve(time: Any) -> Array:
    """Return places on a circle of 2 m, at 1.2 m/s."""
    angle = 0.6 * np.asarray(time)
    return 2 * np.stack((np.cos(angle), np.sin(angle)), -1) - (2.0, 0.0)


@pytest.mark.parametrize("decision_dt", [0.1, 0.4])
@pytest.mark.parametrize("dt", [0.0166, 1 / 30, 0.08, 0.1, 0.17, 0.3, 0.4])
def test_any_clock_gives_histories_in_time_and_decisions_in_turn(dt: float, decision_dt: float) -> None:
    told, counted = Watch(decision_dt), Watch(decision_dt)
    controllers = Controller(told, dt=dt), Controller(counted, dt=dt)
    for call in range(round(4.5 / dt)):
        people = {0: curve(call * dt)}
        controllers[0].step(people, {0: (90.0, 0.0)}, time=7.0 + call * dt)
        controllers[1].step(people, {0: (90.0, 0.0)})
    times = np.array([batch["time"].item() for batch in counted.seen])
    np.testing.assert_allclose([batch["time"].item() for batch in told.seen], times, atol=1e-5)
    # in the mean as often as it should, or at every call
    assert np.diff(times).mean() == pytest.approx(max(decision_dt, dt), rel=0.08)
    assert np.diff(times).max() < max(decision_dt, dt) + dt
    for one, other in zip(told.seen, counted.seen, strict=True):
        seen: Any = agents_of(other)
        now = other["time"].item()
        if now > 2.9:
            expected = torch.from_numpy(curve(now - STEP_SECONDS * np.arange(7, -1, -1))).float()
            assert (seen["history"][0, 0] - expected).norm(dim=1).max() < 0.2 * dt**2 + 1e-4
            window = max(dt, 0.1)
            velocity = torch.from_numpy((curve(now) - curve(now - window)) / window).float()
            assert (seen["velocity"][0, 0] - velocity).norm() < 0.05
        torch.testing.assert_close(agents_of(one)["history"], seen["history"], atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("name", "dt"), [("orca", 0.08), ("orca", 0.3), (RULES[2], 1 / 30), (RULES[2], 0.4), (CROWD, 0.17)]
)
def test_policies_walk_alike_at_any_clock(name: str, dt: float) -> None:
    goal, paths = np.array([[6.0, 1.0]]), []
    for seconds in (dt, dt, 0.1):
        controller = Controller(policy_of(name), dt=seconds, deterministic=True)
        path, _ = hosted(controller, np.zeros((1, 2)), {0: {0: goal[0]}}, 7.0)
        paths.append(path)
        assert np.linalg.norm(path[-1] - goal) < 0.1
    np.testing.assert_array_equal(paths[0], paths[1])
    assert np.linalg.norm(paths[0][round(3 / dt)] - paths[2][30]) < 0.3


@pytest.mark.parametrize("name", ["sgan_goal.zara1", "orca"])
def test_people_walk_alike_by_a_clock_that_jitters(name: str) -> None:
    jitter, ends = np.random.default_rng(1).uniform(-0.02, 0.02, 61), []
    for shift, told in ((0.0, False), (0.0, True), (jitter, True)):
        controller = Controller(policy_of(name), dt=0.1, deterministic=True)
        times, place = 5.0 + 0.1 * np.arange(61) + shift, np.zeros(2)
        times[[0, -1]] = 5.0, 11.0
        for time, after in pairwise(times.tolist()):
            result = controller.step({0: place}, {0: (50.0, 20.0)}, time=time if told else None)
            place = place + (after - time) * result[0]
        ends.append(place)
    assert np.linalg.norm(ends[1] - ends[0]) < 1e-3 and np.linalg.norm(ends[2] - ends[1]) < 0.01


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ((1.76e18,), "time 1.76e[+]18: expected seconds: are these nanoseconds"),
        ((1.76e12,), "are these milliseconds"),
        ((0.0, 1e8), "time .*: expected seconds: are these nanoseconds"),
        ((0.0, 1e5), "are these microseconds"),
        ((5.0, 105.0), "are these milliseconds[?] After a pause reset"),
        ((0.0, 0.1, 0.2, 1e6), "expected seconds"),
    ],
)
def test_times_in_other_units_are_refused_and_change_nothing(times: Any, message: str) -> None:
    controller, other = Controller(Watch(), dt=0.1), Controller(Watch(), dt=0.1)
    for time in times[:-1]:
        for one in (controller, other):
            before = one.step({0: (0.0, 0.0)}, {0: (9.0, 0.0)}, time=time)
            assert np.isfinite(before[0]).all()
    with pytest.raises(UserError, match=message):
        controller.step({0: (0.0, 0.0)}, {0: (9.0, 0.0)}, time=times[-1])
    after = times[-2] + 0.1 if len(times) > 1 and times[-2] < 1e9 else 0.0
    answers = [one.step({0: (0.1, 0.0)}, {0: (9.0, 0.0)}, time=after) for one in (controller, other)]
    np.testing.assert_array_equal(answers[0][0], answers[1][0])


def test_milliseconds_are_noticed_and_pauses_allowed() -> None:
    controller, people = Controller(Watch(), dt=0.02), {0: (0.0, 0.0)}
    controller.step(people, {0: (9.0, 0.0)}, time=0.0)
    controller.step(people, time=20.0)  # a pause, perhaps
    with pytest.raises(UserError, match="are these milliseconds"):
        controller.step(people, time=40.0)
    controller.step(people, time=20.02)


@pytest.mark.parametrize(
    ("name", "dt"), [("go_to_goal", 0.4), ("orca", 0.1), ("approach_net_goal_map.indoor", 0.1)]
)
@pytest.mark.parametrize("host", ["noise", "lag", "block"])
def test_hosts_may_move_people_otherwise_than_told(name: str, dt: float, host: str) -> None:
    """Noise of 1 cm, commands that come a call late, and people held for 2 s: all arrive and stand."""
    draw, commands = np.random.default_rng(0), [np.zeros((2, 2))]

    def move(call: int, place: Array, velocity: Array) -> Array:
        commands.append(velocity)
        if host == "noise":
            moves = np.linalg.norm(velocity, axis=1, keepdims=True) > 0
            return place + dt * velocity + moves * draw.normal(0, 0.01, (2, 2))
        if host == "lag":
            return place + dt * commands[-2]
        return place if 1.5 <= call * dt < 3.5 else place + dt * velocity

    start = np.array([[0.0, 0.0], [60.0, 0.0]])
    goal = start + np.array([[4.0, 1.0], [0.0, 5.0]])
    controller = Controller(policy_of(name), dt=dt)
    path, answers = hosted(controller, start, {0: dict(enumerate(goal))}, 9.0, host=move)
    at_rest(path, answers, goal, dt)


def test_velocities_are_those_of_the_positions() -> None:
    """A person is told 1.3 m/s and held: seen at rest, and freed begins half-way to what is decided."""
    policy, place = Watch(), np.zeros(2)
    controller = Controller(policy, dt=0.1)
    answers = []
    for call in range(24):
        answers.append(controller.step({0: place}, {0: (50.0, 0.0)})[0])
        if not 8 <= call < 16:
            place = place + 0.1 * answers[-1]
    velocity = [agents_of(batch)["velocity"][0, 0, 0].item() for batch in policy.seen]
    assert velocity == pytest.approx([1.3, 1.3, 1.3, 0.0, 0.0, 1.3], abs=1e-4)
    np.testing.assert_allclose(np.array(answers)[16:20, 0], 1.3 * np.array([0.5, 1.25, 1.25, 1.0]), atol=1e-4)
