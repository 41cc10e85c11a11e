"""The controller, against the environment and against histories and velocities known by hand."""

from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.scenes import Watch
from helpers.walks import hosted
from torchrl.envs.utils import ExplorationType, set_exploration_type

import pedzoo
from pedzoo.core.batch import PERSON, ROBOT, agents_of, companions_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import blended, limit_speed
from pedzoo.core.types import GOAL_RADIUS, TOP_SPEED_RATIO
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.policies.controller.arguments import number_of
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy

# two rooms of 5 x 6 m with a door of 1.2 m between, and a third behind a wall without one
ROOMS = rectangles(
    room((0, 0), (15, 6), 0.2) + wall((5, 0), (5, 6), 0.2, doors=[(3, 1.2)]) + wall((10, 0), (10, 6), 0.2),
    resolution=0.1,
)

THICK = rectangles([*room((0, 0), (15, 6), 0.2), (4.2, 0.0, 6.2, 6.0), *wall((10, 0), (10, 6), 0.2)], 0.1)
"""A room with a block, and another one behind a wall without a door."""


def arrays(answer: dict[Any, np.ndarray]) -> np.ndarray:
    return np.stack(list(answer.values()))


@pytest.mark.parametrize("name", ["sgan_goal.zara1", "approach_net_goal_map.controller_open"])
@pytest.mark.parametrize("deterministic", [True, False])
def test_it_walks_as_the_policy_does_in_the_environment(name: str, deterministic: bool):
    env = pedzoo.make_env("goals:people=4,pool=8", physics="compiled", seed=5)
    batch, policy = env.reset(), load_policy(name)
    kind = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
    with torch.no_grad(), set_exploration_type(kind):
        action = policy(batch)["agents", "action"][0]
    state = env.state
    speeds, top_speed = state.pref_speed[0], TOP_SPEED_RATIO * state.pref_speed[0]
    # the first 0.1 s of the decision
    expected = blended(state.velocity[0].T, limit_speed(action, top_speed).T, 4)[:, 0].T

    options: dict[str, Any] = {"dt": 0.1, "seed": 5, "deterministic": deterministic}
    controller = pedzoo.controller(
        name, env.bank.grids[0], pref_speed=dict(enumerate(speeds.tolist())), **options
    )
    goals, result = dict(enumerate(state.goal_point[0])), {}
    for moment in range(state.past.shape[2]):
        result = controller.step(dict(enumerate(state.past[0, :, moment])), goals)
    expected = limit_speed(expected, top_speed)
    torch.testing.assert_close(torch.from_numpy(arrays(result)).float(), expected, atol=1e-5, rtol=0)


def test_a_plain_simulator_of_thirty_lines():
    controller = pedzoo.controller("sgan_goal.zara1", ROOMS, dt=0.1, pref_speed={"quick": 1.7})
    entries = [  # when people come, who, from where to where: most through the door, both ways
        (0, "anna", (1.0, 3.0), (9.0, 2.0)),
        (0, "bert", (9.0, 4.5), (1.0, 1.0)),
        (15, "quick", (1.0, 5.0), (9.0, 5.0)),
        (47, ("tuple", 4), (1.0, 1.0), (4.0, 5.0)),
    ]
    positions: dict[Any, np.ndarray] = {}
    arrived: dict[Any, float] = {}
    goal_of = {who: np.array(goal) for _, who, _, goal in entries}
    for tick in range(300):
        goals = {who: goal for when, who, _, goal in entries if tick == when}
        positions |= {who: np.array(start) for when, who, start, _ in entries if tick == when}
        for who, velocity in controller.step(positions, goals).items():
            positions[who] = positions[who] + velocity * 0.1
            assert np.linalg.norm(velocity) <= 1.3 * (1.7 if who == "quick" else 1.3) + 1e-6
        for who in [w for w, xy in positions.items() if np.linalg.norm(xy - goal_of[w]) < 0.4]:
            arrived[who] = tick
            del positions[who]
    assert arrived.keys() == goal_of.keys()
    assert arrived[("tuple", 4)] > 47
    assert controller.step({}) == {}


def test_order_of_agents_and_names_of_others_do_not_matter():
    draw = np.random.default_rng(1)
    people = {who: draw.uniform(0.5, 4.5, 2) for who in ("a", 7, ("x", 1), 2.5, frozenset([3]))}
    goals = {who: draw.uniform(0.5, 4.5, 2) for who in people}
    names = {"r": "r", "s": "s"}, {"s": "s", "r": "r"}, {"r": 3, "s": ("x", 2)}
    walks = [pedzoo.controller("sgan_goal.zara1", ROOMS, seed=3) for _ in names]
    for _ in range(4):
        answers = []
        for number, (walk, name) in enumerate(zip(walks, names, strict=True)):
            ids = list(people)[:: -1 if number else 1]
            robots = {"r": (2.0, 0.4), "s": [(3.0, 2.0), (3.5, 2.0)]}
            answers.append(
                walk.step(
                    {who: people[who] for who in ids},
                    {who: goals[who] for who in reversed(ids)},
                    others={name[one]: robots[one] for one in name},
                    radius={name[one]: {"r": 0.5, "s": 0.25}[one] for one in name},
                )
            )
            assert list(answers[-1]) == ids
        assert all((velocity == answers[1][who]).all() for who, velocity in answers[0].items())
        for who in people:
            np.testing.assert_allclose(answers[2][who], answers[0][who], atol=1e-5)
        people = {who: xy + 0.4 * answers[0][who] for who, xy in people.items()}


def test_noise_goes_by_seed_and_id_who_else_is_there():
    model = pedzoo.load("sgan_goal.zara1")
    far = {"anna": (0.0, 0.0), "bert": (900.0, 0.0)}
    goals = {"anna": (10.0, 0.0), "bert": (900.0, 10.0)}
    drawn = []

    def noted(batch, noise, steps, horizon):
        drawn.append(noise[0])
        return torch.zeros(1, noise.shape[1], steps, 2)

    model.next_steps = noted
    alone, both, again = (pedzoo.controller(model, seed=seed) for seed in (1, 1, 2))
    alone.step({"bert": far["bert"]}, goals)
    both.step(far, goals)
    again.step(far, goals)
    row = sorted(far, key=number_of).index("bert")
    assert torch.equal(drawn[0][0], drawn[1][row])
    assert not torch.equal(drawn[1], drawn[2])
    both.reset(seed=2)
    both.step(far, goals)
    assert torch.equal(drawn[3], drawn[2])
    both.deterministic = True
    model.next_steps = lambda batch, noise, steps, horizon: drawn.append(noise) or torch.zeros(1, 2, steps, 2)
    both.step(far)
    assert drawn[4] is None


def test_newcomers_have_walked_here():
    policy = Watch()
    controller = Controller(policy, pref_speed={"b": 2.0})
    controller.step({"a": [1.0, 1.0], "b": [0.0, 0.0]}, {"a": (11, 1), "b": (0, 9)}, {"a": (0.0, -0.5)})
    a, b = (sorted("ab", key=number_of).index(one) for one in "ab")
    agents, ago = agents_of(policy.seen[0]), torch.arange(7, -1, -1.0) * 0.4
    expected = torch.stack((torch.ones(8), 1 + 0.5 * ago), 1)  # as given
    torch.testing.assert_close(agents["history"][0, a], expected)
    expected = torch.stack((torch.zeros(8), -2.0 * ago), 1)  # preferred speed towards the goal
    torch.testing.assert_close(agents["history"][0, b], expected)
    torch.testing.assert_close(agents["velocity"][0, b], torch.tensor([0.0, 2.0]))
    assert agents["valid"].all() and agents["mask"].all()


def test_people_are_remembered_while_they_are_named():
    policy = Watch()
    controller = Controller(policy)
    goals = {0: (100.0, 0.0), 1: (0.0, 100.0)}
    for tick in range(10):
        controller.step({0: (tick, 0.0), 1: (0.0, tick)}, goals)
    history = policy.seen[-1]["agents", "history"][0]
    assert history[0, :, 0].tolist() == history[1, :, 1].tolist() == [2, 3, 4, 5, 6, 7, 8, 9]
    controller.step({1: (0.0, 10.0)})  # 0 leaves
    assert policy.seen[-1]["agents", "history"][0, 0, :, 1].tolist() == [3, 4, 5, 6, 7, 8, 9, 10]
    with pytest.raises(UserError, match="no goal for 0"):
        controller.step({0: (50.0, 0.0), 1: (0.0, 11.0)})
    controller.step({0: (50.0, 0.0), 1: (0.0, 11.0)}, {0: (100, 0)})  # the failed call was none
    history = policy.seen[-1]["agents", "history"][0]
    torch.testing.assert_close(history[0, :, 0], 50 - torch.arange(7, -1, -1) * 0.4 * 1.3)
    assert history[1, :, 1].tolist() == [4, 5, 6, 7, 8, 9, 10, 11]


def test_newcomers_are_decided_at_once_others_at_the_interval():
    policy = Watch()
    controller, answers = Controller(policy, dt=0.1), []
    for tick in range(9):
        people = {0: (0.0, 0.1 * tick)} | ({1: [1.0, 1.0]} if tick >= 6 else {})
        # the other goal is noticed at the next decision
        goals: dict[int, Any] = {0: torch.tensor([0.0, 10.0]) if tick else (10.0, 0.0), 1: (1.0, -5.0)}
        answers.append(controller.step(people, goals))
    assert [bool(answer[0][1] > answer[0][0]) for answer in answers] == [False] * 4 + [True] * 5
    assert len(policy.seen) == 4  # at 0, 4 and 8, and at 6 for the newcomer
    np.testing.assert_allclose(answers[6][1], (0, -1.3), atol=1e-6)
    assert policy.seen[2]["time"].item() == pytest.approx(0.6)
    # every 0.4 s, back from now
    expected = 0.1 * torch.tensor([-20.0, -16, -12, -8, -4, 0, 4, 8])
    torch.testing.assert_close(policy.seen[3]["agents", "history"][0, 0, 5:, 1], expected[5:])


@pytest.mark.parametrize(
    ("dt", "shares"),
    [
        (0.1, [0.5, 1.25, 1.25, 1.0]),
        (0.2, [0.875, 1.125]),
        (0.05, [0.5, 0.5, 1.25, 1.25, 1.25, 1.25, 1.0, 1.0]),
        (0.4, [1.0]),
    ],
)
def test_between_two_decisions_velocities_blend(dt: float, shares: list[float]):
    """From 1.3 m/s along x to 1.3 m/s along y: half-way in the first 0.1 s, made up for in the next 0.2 s."""
    controller, steps = Controller(Watch(), dt=dt), len(shares)
    goals = {0: {0: (100.0, 0.0)}, steps: {0: (0.52, 100.0)}}
    path, result = hosted(controller, np.zeros((1, 2)), goals, 0.8)
    # no faster than 1.3 times the preferred speed
    expected = [(1.3 * (1 - share), 1.3 * share) for share in shares]
    np.testing.assert_allclose(result[steps:, 0], expected, atol=2e-5)
    np.testing.assert_allclose(path[-1, 0] - path[steps, 0], (0.0, 0.52), atol=2e-5)


def test_velocities_are_shortened_to_the_top_speed():
    fast = Controller(Watch(factor=3.0), pref_speed=1.0).step({"a": (0, 0)}, {"a": (3, 4)})
    np.testing.assert_allclose(fast["a"], (1.3 * 0.6, 1.3 * 0.8), rtol=1e-6)
    assert fast["a"].dtype == np.float64
    still = Controller(Watch(factor=0.0)).step({"a": (0, 0)}, {"a": (3, 4)})
    assert still["a"].tolist() == [0, 0]


def test_goals_that_no_person_has_any_more_are_forgotten():
    policy = Watch()
    controller = Controller(policy, rectangles(room((0, 0), (5, 5), 0.1), resolution=0.1))
    people = {"stays": (1.0, 3.0), "turns": (2.0, 2.0)}
    for goal in np.stack(np.meshgrid(np.arange(1, 4, 0.3), np.arange(1, 4, 0.3)), -1).reshape(-1, 2):
        velocity = controller.step(people, {"stays": (4.0, 3.0), "turns": goal})
        np.testing.assert_allclose(velocity["stays"], (1.3, 0), atol=1e-5)
        way, told = goal - (2.0, 2.0), seen(policy, "desired_velocity")[0]
        if np.linalg.norm(way) > GOAL_RADIUS:
            wanted = torch.from_numpy(1.3 * way / np.linalg.norm(way)).float()
            torch.testing.assert_close(told[controller._agents.row["turns"]], wanted, atol=1e-5, rtol=0)
    assert controller._online_goals.planner.goals < 80


@pytest.mark.parametrize(
    ("positions", "goals", "message"),
    [
        ({"anna": (1, 1)}, {}, "no goal for 'anna'"),
        ({"anna": (1, 1), "bo": (2, 2)}, {"anna": (3, 3), "Bo": (3, 3)}, "no goal for 'bo'"),
        ({"anna": (float("nan"), 1)}, {"anna": (3, 3)}, "position .* of 'anna': expected finite"),
        ({"anna": (1, 1, 0)}, {"anna": (3, 3)}, r"position \(1, 1, 0\) of 'anna': expected two numbers"),
        ({"anna": (1, 1), "bo": "here"}, {}, "position 'here' of 'bo': expected two numbers"),
        ({"anna": (1, 1)}, {"anna": (np.inf, 3)}, "goal .* of 'anna': expected finite"),
        ({"anna": (1, 1), "bo": (2, 2)}, {"anna": (3, 3), "bo": (50, 3)}, "goal of 'bo': .* outside the map"),
        ({"anna": (1, 1)}, {"anna": (12, 3)}, "no way leads to the goal of 'anna'"),
        ({"anna": (5e5, 4e6)}, {"anna": (3, 3)}, "'anna' is more than 10000 m from the scene's origin"),
    ],
)
def test_what_cannot_be_walked_is_refused(positions, goals, message):
    controller = Controller(Watch(), THICK)
    with pytest.raises(UserError, match=message):
        controller.step(positions, goals)
    assert list(controller.step({"cy": (1, 1)}, {"cy": (3, 3)})) == ["cy"]


def test_ids_have_numbers_that_no_run_changes():
    assert [number_of(one) for one in (0, 3, np.int64(3), True)] == [0, 3, 3, 1]
    assert number_of("anna") == 1857110474486603798
    assert number_of(-1) >= 0


def seen(policy: Watch, key: str) -> torch.Tensor:
    """Return what the policy was last told of all agents."""
    return cast("torch.Tensor", agents_of(policy.seen[-1])[key])


def test_companies_are_seen_until_they_change() -> None:
    policy = Watch()
    controller = Controller(policy)
    people = {name: (0.0, float(y)) for y, name in enumerate("abc")}
    goals = {name: (9.0, float(y)) for y, name in enumerate("abc")}
    known: list[torch.Tensor] = []
    for groups in (None, {"a": "family", "c": "family"}, {}, {"c": None}):
        controller.step(people, goals, groups=groups, others={"robot": (5.0, 9.0)})
        known.append(companions_of(policy.seen[-1])[0])
        assert seen(policy, "group").shape == (1, 4)
    assert [int(pairs.sum()) for pairs in known] == [0, 2, 2, 0]
    a, c = (controller._agents.row[name] for name in "ac")
    assert known[1][a, c] and known[2][a, c]


def row_of(batch: Any, radius: float) -> int:
    """Return the only row with a body of this radius."""
    rows = (agents_of(batch)["radius"][0, :, 0] - radius).abs().lt(1e-6).nonzero()[:, 0]
    assert len(rows) == 1
    return int(rows[0])


@pytest.mark.parametrize(
    ("name", "goal"), [("sgan_goal.zara1", (0.8, 0.0)), ("approach_net_goal.indoor", None)]
)
def test_who_has_arrived_stands_until_another_goal(name: str, goal: Any):
    room_of_ten = rectangles(room((-5, -5), (5, 5), 0.1), resolution=0.1)
    controller = pedzoo.controller(name, room_of_ten, dt=0.1)
    # the same goal again is no other goal; one stands, and the other passes
    goals = {tick: {0: goal if tick < 120 else (3.0, 3.0)} for tick in range(1, 250)}
    goals[0] = {0: goal, 1: (4.0, 0.3)}
    path = hosted(controller, np.array([[0.0, 0.0], [-4.0, 0.3]]), goals, 25.0)[0][:, 0]
    assert np.linalg.norm(path[120] - (goal or (0.0, 0.0))) <= GOAL_RADIUS
    assert np.linalg.norm(path[60:120] - path[120], axis=1).max() < 0.2
    assert np.linalg.norm(path[-1] - (3.0, 3.0)) <= GOAL_RADIUS


def test_a_goal_counts_as_reached_between_two_calls_and_once():
    policy = Watch()
    controller = Controller(policy)
    controller.step({"a": (0.0, 0.0), "b": (0.0, 9.0)}, {"a": (1.0, 0.2), "b": (99.0, 9.0)})
    controller.step({"a": (2.0, 0.0), "b": (0.0, 9.0)})  # past it, 0.2 m beside
    agents, a = agents_of(policy.seen[-1]), sorted("ab", key=number_of).index("a")
    assert agents["controlled"][0].tolist() == [one != a for one in range(2)]
    assert agents["kind"].unique().tolist() == [PERSON] and agents["mask"].all()
    assert agents["desired_velocity"][0, a].tolist() == [0, 0]
    assert controller.step({"a": (-3.0, 0.0), "b": (0.0, 9.0)})["a"].tolist() == [0, 0]  # carried away
    result = controller.step({"a": (-3.0, 0.0), "b": (0.0, 9.0)}, {"a": (1.0, 0.3)})["a"]
    assert result[0] > 0.9
    assert controller.step({"a": (-3.0, 0.0), "b": (0.0, 9.0)}, {"a": None})["a"].tolist() == [0, 0]


def test_others_are_seen_and_not_returned():
    policy = Watch()
    controller = Controller(policy)
    for tick in range(10):
        result = controller.step(
            {"anna": (0.0, 0.0)},
            {"anna": (9.0, 0.0)},
            others={"husky": (5.0 - 0.4 * tick, 1.0), 7: [3.0, 3.0]},
            radius={"husky": 0.5, "anna": 0.2},
            velocities={"husky": (-1.0, 0.0)},
        )
        assert list(result) == ["anna"]
    for batch, tick in ((policy.seen[0], 0), (policy.seen[-1], 9)):
        agents = agents_of(batch)
        husky, anna, usual = (row_of(batch, radius) for radius in (0.5, 0.2, 0.3))
        expected = 5.0 - 0.4 * (tick - torch.arange(7.0, -1, -1))
        history = agents["history"][0] - agents["history"][0, anna, -1]
        torch.testing.assert_close(history[husky, :, 0], expected)
        torch.testing.assert_close(agents["velocity"][0, husky], torch.tensor([-1.0, 0.0]))
        assert agents["heading"][0, husky, 0].item() == pytest.approx(np.pi, abs=1e-4)
        assert (history[usual] == 3).all()  # at rest
        assert agents["controlled"][0].tolist() == [row == anna for row in range(3)]
        assert agents["kind"][0].tolist() == [PERSON if row == anna else ROBOT for row in range(3)]
    controller.step({"anna": (0.0, 0.0)}, others={"husky": (1.0, 1.0)}, radius={"husky": 0.4})
    assert sorted(seen(policy, "radius").flatten().tolist()) == pytest.approx([0.2, 0.4])
    assert controller.step({}, others={"husky": (1.0, 1.0)}) == {}
    # the empty call was one: the history of the robot goes on
    controller.step({"anna": (0.0, 0.0)}, {"anna": (9.0, 0.0)}, others={"husky": (1.5, 1.0)})
    history = seen(policy, "history")[0, row_of(policy.seen[-1], 0.4), -3:, 0]
    assert history.diff().tolist() == [0.0, 0.5]


def test_a_box_is_several_discs_with_histories_of_their_own():
    policy = Watch()
    controller = Controller(policy)
    for tick in range(3):
        discs = np.array([[4.0, 0.2 * tick], [5.0, 0.4 * tick], [6.0, 0.6 * tick]])
        box = discs if tick else discs.tolist()
        controller.step({0: (0.0, 0.0)}, {0: (9.0, 0.0)}, others={"box": box}, radius={"box": 0.45})
    wide = seen(policy, "radius")[0, :, 0] > 0.4
    assert int(wide.sum()) == 3
    last = sorted(map(tuple, seen(policy, "history")[0, wide][:, -3:].flatten(1).tolist()))
    expected = [(x, 0.0, x, 0.2 * (x - 3), x, 0.4 * (x - 3)) for x in (4.0, 5.0, 6.0)]
    np.testing.assert_allclose(last, expected, atol=1e-6)


def test_a_clock_that_jitters_gives_regular_histories():
    """On a circle of 2 m at 1.2 m/s: what the policy sees is where they were every 0.4 s, within 1 cm."""

    def at(time):
        angle = 0.6 * np.asarray(time)
        return 2 * np.stack((np.cos(angle), np.sin(angle)), -1)

    draw, policy = np.random.default_rng(0), Watch()
    controller = Controller(policy, dt=0.1)
    times = 1.7e9 + 0.1 * np.arange(100) + draw.uniform(-0.04, 0.04, 100)
    for time in times:
        controller.step({0: at(time)}, {0: (50.0, 0.0)}, others={1: -at(time)}, time=float(time))
    clock = np.array([batch["time"].item() for batch in policy.seen])
    assert len(clock) == 25 and np.abs(np.diff(clock) - 0.4).max() < 0.09
    for batch in policy.seen[7:]:
        now = times[0] + batch["time"].item()
        expected = torch.from_numpy(at(now - 0.4 * np.arange(7, -1, -1))).float()
        history = cast("torch.Tensor", agents_of(batch)["history"])[0]
        start = torch.from_numpy(at(times[0])).float()  # the first agent's is the origin
        assert (history[0] + start - expected).norm(dim=-1).max() < 0.01
        assert (history[1] + start + expected).norm(dim=-1).max() < 0.01


@pytest.mark.parametrize("name", ["approach_net_goal_map.indoor", "social_walker.eth_ucy"])
def test_a_policy_asked_by_a_controller_still_has_gradients(name: str) -> None:
    """A controller asks in inference mode; nothing that is kept may be a tensor of that mode."""
    policy = pedzoo.policy(name)
    controller = Controller(policy, ROOMS)
    people, goals = {0: (1.0, 3.0), 1: (4.0, 2.0)}, {0: (9.0, 3.0), 1: (1.0, 2.0)}
    controller.step(people, goals)
    bank = controller._online_goals.planner.bank
    place = torch.tensor([[[1.0, 3.0], [4.0, 2.0]]], requires_grad=True)
    pose, map_id = torch.tensor([[0.0, 1.0, 0.0, 0.0]]), torch.tensor([bank.grids[0].map_id])
    distance = bank.signed_distance(place, map_id, pose) + bank.closest_wall(place, map_id, pose)[0]
    distance.square().sum().backward()
    env = pedzoo.make_env("goals:people=2,pool=8", physics="compiled")
    with set_exploration_type(ExplorationType.RANDOM):
        action = policy(env.reset())["agents", "action"]
        action.square().sum().backward()
        again = policy(env.reset())["agents", "action"]
    assert place.grad is not None and bool(place.grad.any())
    assert any(weight.grad is not None and bool(weight.grad.any()) for weight in policy.parameters())
    assert not again.is_inference()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_model_on_a_gpu_walks_as_on_the_cpu():
    people, goals = {"a": (1.0, 3.0), "b": (9.0, 2.0)}, {"a": (9.0, 3.0), "b": (1.0, 2.0)}
    models = pedzoo.load("sgan_goal.zara1"), pedzoo.load("sgan_goal.zara1", device="cuda")
    expected, result = (arrays(pedzoo.controller(one, ROOMS).step(people, goals)) for one in models)
    np.testing.assert_allclose(result, expected, atol=1e-4)
