"""How people of a controller set out, walk and stop, at any clock and where hosts move them otherwise."""

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
from torchrl.envs import step_mdp

import pedzoo
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.plans import rectangles, room
from pedzoo.models.architectures.sgan import at_own_speed
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import Walker, with_walked_history
from pedzoo.sim.make import make_env
from pedzoo.sim.scenarios.custom import Custom
from tests.helpers.batches import make_batch

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


# Setting out


MOVED = 0.25
"""Metres that people have walked after a second."""

KINDS = (
    *("orca", "social_force", "bent_line", "sgan_goal.zara1", "approach_net_goal_map.indoor"),
    *("anchor_net_goal.eth_destination", "social_vrnn.eth", "social_walker.indoor", "social_walker.styled"),
)


def test_all_policies_set_out_from_a_static_start() -> None:
    """Those that know a goal go there; the others go where they are shown to have gone."""
    late, names = [], pedzoo.list_policies()
    settings: Any = {"warm_start": "static", "physics": "compiled"}
    envs = {dt: make_env("circle:people=2,speed_std=0", 2, decision_dt=dt, **settings) for dt in (0.1, 0.4)}
    for name in names:
        policy = load_policy(name)
        env = envs[policy.decision_dt]
        now: Any = env.reset()
        begin, way = env.state.position, env.state.goal_point - env.state.position
        with torch.no_grad():
            env.rollout(round(0.8 / policy.decision_dt), policy, auto_reset=False, tensordict=now)
        moved = ((env.state.position - begin) * way / way.norm(dim=-1, keepdim=True)).sum(-1).min()
        model = getattr(policy, "model", None)
        if moved < (MOVED if model is None or "goal" in model.needs else MOVED / 4):
            late.append((name, round(float(moved), 2)))
    assert len(names) > 100 and not late


@pytest.mark.parametrize("name", KINDS)
def test_people_of_a_host_set_out_again(name: str) -> None:
    """They were placed without a goal, have arrived, or were stopped, for a short or a long time."""
    policy = load_policy(name)
    dt = policy.decision_dt
    for number, (begin, stood, way) in enumerate(
        (("placed", 3.6, 2.5), ("arrived", 0.8, -1.9), ("arrived", 3.6, 3.0), ("stopped", 0.8, 0.4))
    ):
        controller = Controller(policy, dt=dt, seed=number, pref_speed=1.2)
        here = np.array([[0.3, 0.2], [30.0, 0.0]])
        if begin != "placed":
            first = (1.1, 0.2) if begin == "arrived" else (9.0, 0.2)
            here = hosted(controller, here, {0: {0: first, 1: None}}, 2.0)[0][-1]
        here = hosted(controller, here, {} if begin == "arrived" else {0: {0: None, 1: None}}, stood)[0][-1]
        goal = here[0] + 6.0 * np.array([math.cos(way), math.sin(way)])
        there = hosted(controller, here, {0: {0: goal}}, 0.8)[0][-1]
        assert np.linalg.norm(there - here, axis=1)[0] > MOVED, (begin, stood)


@pytest.mark.parametrize(
    "scenario", ["waiting:people=3,waiting=2,stay=0,seconds=1.5", "standing:seconds=1.5"]
)
def test_people_who_waited_in_a_scenario_set_out(scenario: str) -> None:
    env = make_env(scenario, 2, "compiled")
    for name in ("social_walker.styled", "sgan_goal.zara1", "approach_net_goal_map.indoor"):
        policy, begin = load_policy(name), None
        now: Any = env.reset()
        with torch.no_grad():
            for _ in range(6):
                begin = env.state.position if env.state.goal_since.amax() > 0 and begin is None else begin
                now = step_mdp(env.step(policy(now)))
        assert begin is not None
        moved = (env.state.position - begin).norm(dim=-1)[env.state.goal_since > 0]
        assert len(moved) >= 2 and moved.min() > MOVED


def test_what_people_see_of_themselves_when_they_set_out() -> None:
    """Of four one is on the way, one just got a goal, one 0.8 s ago, and one walked when it did."""
    batch = make_batch((4,), padding=0.0)
    agents = agents_of(batch)
    here = torch.zeros(1, 4, 8, 2)
    here[0, 2, 6:, 1] = torch.tensor([0.3, 0.7])
    here[0, 3, :, 0] = 0.5 * torch.arange(8.0)
    agents["history"], agents["pref_speed"] = here, torch.ones(1, 4, 1)
    agents["desired_velocity"] = torch.tensor([1.0, 0.0]).expand(1, 4, 2)
    agents["goal_since"] = torch.tensor([-torch.inf, 4.0, 3.2, 3.6]).view(1, 4, 1)
    batch["time"] = torch.full((1, 1), 4.0)
    result = agents_of(with_walked_history(batch))
    came = 0.4 * torch.arange(-7.0, 1.0)
    assert torch.equal(result["history"][0, [0, 3]], here[0, [0, 3]])
    torch.testing.assert_close(result["history"][0, 1], torch.stack((came, torch.zeros(8)), 1))
    ended = torch.stack((0.4 * torch.arange(-5.0, 1.0), torch.zeros(6)), 1)
    torch.testing.assert_close(result["history"][0, 2], torch.cat((ended, here[0, 2, 6:])))
    assert result["sets_out"][0, :, 0].tolist() == [False, True, True, False]
    agents["goal_since"] -= 3.0
    assert with_walked_history(batch) is batch


def test_recorded_people_who_stand_have_no_new_goal() -> None:
    env = make_env("replay:fold=embedded", 2, "compiled")
    now: Any = env.reset()
    for _ in range(4):
        assert env.state.goal_since.isneginf().all()
        now["agents", "action"] = now["agents", "desired_velocity"]
        now = step_mdp(env.step(now))


# Speeds


DEFAULT = "approach_net_goal_map.indoor"


@pytest.mark.parametrize("name", ["go_to_goal", "orca", "social_force", DEFAULT])
@pytest.mark.parametrize("speed", [0.5, 1.0, 1.7])
def test_a_host_gets_the_speed_that_it_asks_for(name: str, speed: float) -> None:
    """Within 3 %, in any direction, whatever the noise, by way and by path."""
    policy = load_policy(name)
    dt, seed = policy.decision_dt, round(10 * speed)
    controller = Controller(policy, dt=dt, pref_speed=speed, seed=seed)
    here = np.array([[0.2, -0.1]])
    goal = here[0] + 90.0 * np.array([math.cos(seed), math.sin(seed)])
    track, _ = hosted(controller, here, {0: {0: goal}}, 12.0)
    path = np.diff(track[round(6.0 / dt) :, 0], axis=0)
    assert np.linalg.norm(path, axis=1).mean() / dt == pytest.approx(speed, rel=0.03)
    assert np.linalg.norm(path.mean(0)) / dt == pytest.approx(speed, rel=0.03)


@pytest.mark.parametrize("speed", [0.6, 0.8, 1.4])
def test_the_environment_gets_it_too(speed: float) -> None:
    """Of 24 people alone in their scenes, each with noise of their own."""
    alone = Custom([{"from": [0.0, 0.0], "to": [50.0, 20.0]}], speed=speed, speed_std=0.0)
    env = make_env(alone, 24, "compiled")
    with torch.no_grad():
        walk = env.rollout(22, load_policy(DEFAULT), auto_reset=True)
    here = walk["agents", "history"][:, :, 0, -1]
    walked = (here[:, -1] - here[:, 10]).norm(dim=-1) / (11 * 0.4)
    assert (walked / speed - 1).abs().max() < 0.03


def test_people_alone_walk_at_their_speed_others_at_its_share() -> None:
    """The way leads along x at 0.4 m a step; alone the model walks 0.5 m, and so did people before."""
    alone, last, wanted = (torch.tensor([[x, 0.0]]).repeat(5, 1) for x in (0.5, 0.5, 0.4))
    step = torch.tensor([[0.5, 0.0], [0.25, 0.1], [0.0, 0.0], [-0.1, 0.0], [0.6, 0.0]])
    result = at_own_speed(step, alone, last, wanted)
    # halfway from 0.5 to 0.4 m: 0.45
    expected = torch.tensor([[0.45, 0.0], [0.225, 0.1], [0.0, 0.0], [-0.1, 0.0], [0.55, 0.0]])
    torch.testing.assert_close(result, expected)
    turned = torch.tensor([[-0.2, 0.1], [0.1, 0.4]])
    torch.testing.assert_close(at_own_speed(turned, turned, turned, wanted[:2]), turned)


def test_others_slow_people_down() -> None:
    """A row of people who stand across the way stops the default, at any speed."""
    start = np.array([(0.0, 0.0), *((4.0, 0.45 * number - 2.7) for number in range(1, 12))])
    goals = {0: {0: (12.0, 0.0), **dict.fromkeys(range(1, 12))}}
    for speed in (0.8, 1.4):
        policy = load_policy(DEFAULT)
        assert isinstance(policy, Walker)
        path, _ = hosted(Controller(policy, pref_speed=speed), start, goals, 8.0)
        assert path[-1, 0, 0] < 4.0
