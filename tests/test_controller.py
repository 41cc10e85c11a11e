"""The controller, against the environment and against histories and velocities known by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

import pedzoo
from pedzoo.batch import agents_of
from pedzoo.errors import UserError
from pedzoo.geometry import limit_speed
from pedzoo.maps.plain import rectangles, room, wall
from pedzoo.models.controller import Controller
from pedzoo.models.roster import number_of
from pedzoo.sim.policy import Policy, load_policy
from pedzoo.types import TOP_SPEED_RATIO

# two rooms of 5 x 6 m with a door of 1.2 m between, and a third behind a wall without one
ROOMS = rectangles(
    room((0, 0), (15, 6), 0.2) + wall((5, 0), (5, 6), 0.2, doors=[(3, 1.2)]) + wall((10, 0), (10, 6), 0.2),
    resolution=0.1,
)


class Straight(Policy):
    """The desired velocity times a factor; keeps the batches that it was asked about."""

    def __init__(self, factor: float = 1.0, dt: float = 0.4) -> None:
        """Set the factor and the clock."""
        super().__init__(dt)
        self.factor = factor
        self.seen: list[Any] = []

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write everybody's velocity."""
        self.seen.append(tensordict.clone())
        tensordict["agents", "action"] = tensordict["agents", "desired_velocity"] * self.factor
        return tensordict


@pytest.fixture(scope="module")
def env():
    return pedzoo.make_env("goals:people=4,pool=8", physics="compiled", seed=5)


@pytest.fixture(scope="module")
def model():
    return pedzoo.load("sgan_goal.zara1")


def arrays(answer: dict[Any, np.ndarray]) -> np.ndarray:
    return np.stack(list(answer.values()))


@pytest.mark.parametrize("name", ["sgan_goal.zara1", "sgan_goal_map.zara1"])
@pytest.mark.parametrize("deterministic", [True, False])
def test_it_walks_as_the_same_policy_does_in_the_environment(env, name: str, deterministic: bool):
    env.set_seed(5)  # from the first scene of the seed again
    batch, policy = env.reset(), load_policy(name)
    kind = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
    with torch.no_grad(), set_exploration_type(kind):
        action = policy(batch.clone())["agents", "action"][0]
    state = env.state
    expected = limit_speed(action, TOP_SPEED_RATIO * state.pref_speed[0])

    controller = pedzoo.load(name).controller(
        env.bank.grids[0],
        pref_speed=dict(enumerate(state.pref_speed[0].tolist())),
        dt=0.1,
        seed=5,
        deterministic=deterministic,
    )
    goals, found = dict(enumerate(state.goal_point[0])), {}
    for moment in range(state.past.shape[2]):
        found = controller.step(dict(enumerate(state.past[0, :, moment])), goals)
    torch.testing.assert_close(torch.from_numpy(arrays(found)).float(), expected, atol=1e-5, rtol=0)


def test_a_plain_simulator_of_thirty_lines(model):
    dt = 0.1
    controller = model.controller(ROOMS, dt=dt, pref_speed={"quick": 1.7})
    entries = [  # when somebody comes, who, from where to where: most through the door, both ways
        (0.0, "anna", (1.0, 3.0), (9.0, 2.0)),
        (0.0, "bert", (9.0, 4.5), (1.0, 1.0)),
        (1.5, "quick", (1.0, 5.0), (9.0, 5.0)),
        (4.7, ("tuple", 4), (1.0, 1.0), (4.0, 5.0)),
    ]
    positions: dict[Any, np.ndarray] = {}
    arrived: dict[Any, float] = {}
    goal_of = {who: np.array(goal) for _, who, _, goal in entries}
    for tick in range(300):
        clock = tick * dt
        goals = {}
        for when, who, start, goal in entries:
            if tick == round(when / dt):
                positions[who], goals[who] = np.array(start), goal
        for who, velocity in controller.step(positions, goals).items():
            positions[who] = positions[who] + velocity * dt
            assert np.linalg.norm(velocity) <= 1.3 * (1.7 if who == "quick" else 1.3) + 1e-6
        for who in [w for w, xy in positions.items() if np.linalg.norm(xy - goal_of[w]) < 0.4]:
            arrived[who] = clock
            del positions[who]
    assert arrived.keys() == goal_of.keys()
    assert arrived[("tuple", 4)] > 4.7
    assert controller.step({}) == {}


def test_the_order_of_the_people_does_not_matter(model):
    draw = np.random.default_rng(1)
    people = {who: draw.uniform(0.5, 4.5, 2) for who in ("a", 7, ("x", 1), 2.5, frozenset([3]))}
    goals = {who: draw.uniform(0.5, 4.5, 2) for who in people}
    one, other = model.controller(ROOMS, seed=3), model.controller(ROOMS, seed=3)
    for tick in range(4):
        named = list(people) if tick % 2 else list(people)[::-1]
        forth = one.step(people, goals)
        back = other.step({who: people[who] for who in named}, {who: goals[who] for who in reversed(named)})
        assert list(back) == named
        for who, velocity in forth.items():
            assert (velocity == back[who]).all()
        people = {who: xy + 0.4 * forth[who] for who, xy in people.items()}


def test_noise_goes_by_seed_and_id_whoever_else_is_there():
    model = pedzoo.load("sgan_goal.zara1")
    far = {"anna": (0.0, 0.0), "bert": (900.0, 0.0)}
    goals = {"anna": (10.0, 0.0), "bert": (900.0, 10.0)}
    drawn = []

    def noted(batch, noise, steps, horizon):
        drawn.append(noise[0])
        return torch.zeros(1, noise.shape[1], steps, 2)

    model.next_steps = noted
    alone, both, again = (model.controller(seed=seed) for seed in (1, 1, 2))
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
    policy = Straight()
    controller = Controller(policy, pref_speed={"b": 2.0})
    controller.step({"a": [1.0, 1.0], "b": [0.0, 0.0]}, {"a": (11, 1), "b": (0, 9)}, {"a": (0.0, -0.5)})
    row = {one: i for i, one in enumerate(sorted("ab", key=number_of))}
    agents = agents_of(policy.seen[0])
    ago = torch.arange(7, -1, -1.0) * 0.4
    expected = torch.stack((torch.ones(8), 1 + 0.5 * ago), 1)  # as given
    torch.testing.assert_close(agents["history"][0, row["a"]], expected)
    expected = torch.stack((torch.zeros(8), -2.0 * ago), 1)  # preferred speed towards the goal
    torch.testing.assert_close(agents["history"][0, row["b"]], expected)
    torch.testing.assert_close(agents["velocity"][0, row["b"]], torch.tensor([0.0, 2.0]))
    assert agents["valid"].all() and agents["mask"].all()


def test_people_are_remembered_while_they_are_named():
    policy = Straight()
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


def test_between_decisions_the_velocity_is_held():
    policy = Straight()
    controller = Controller(policy, dt=0.1)
    goals: dict[int, Any] = {0: (10.0, 0.0)}
    answers = []
    for tick in range(9):
        if tick == 1:
            goals = {0: torch.tensor([0.0, 10.0])}  # noticed at the next decision
        people = {0: (0.0, 0.1 * tick)} | ({1: [1.0, 1.0]} if tick >= 6 else {})
        goals |= {1: (1.0, -5.0)}
        answers.append(controller.step(people, goals))
    turned = [bool(answer[0][1] > answer[0][0]) for answer in answers]
    assert turned == [False] * 4 + [True] * 5
    assert len(policy.seen) == 4  # at 0, 4 and 8, and at 6 for the newcomer
    np.testing.assert_allclose(answers[6][1], (0, -1.3), atol=1e-6)
    assert policy.seen[2]["time"].item() == pytest.approx(0.6)
    # every 0.4 s, back from now
    expected = 0.1 * torch.tensor([-20.0, -16, -12, -8, -4, 0, 4, 8])
    torch.testing.assert_close(policy.seen[3]["agents", "history"][0, 0, 5:, 1], expected[5:])


def test_velocities_are_shortened_to_the_top_speed():
    fast = Controller(Straight(factor=3.0), pref_speed=1.0).step({"a": (0, 0)}, {"a": (3, 4)})
    np.testing.assert_allclose(fast["a"], (1.3 * 0.6, 1.3 * 0.8), rtol=1e-6)
    assert fast["a"].dtype == np.float64
    still = Controller(Straight(factor=0.0)).step({"a": (0, 0)}, {"a": (3, 4)})
    assert still["a"].tolist() == [0, 0]


def test_orca_at_its_own_clock_and_through_the_door():
    controller = Controller(load_policy("orca"), ROOMS, dt=0.1)
    people: dict[str, np.ndarray] = {"a": np.array([2.0, 1.0]), "b": np.array([8.0, 1.0])}
    goals = {"a": (8.0, 1.0), "b": (2.0, 1.0)}
    nearest = np.inf
    for _ in range(90):
        people = {who: people[who] + 0.1 * v for who, v in controller.step(people, goals).items()}
        nearest = min(nearest, float(np.linalg.norm(people["a"] - people["b"])))
        if people["a"][0] > 7.5 and people["b"][0] < 2.5:
            break
    assert people["a"][0] > 7.5 and people["b"][0] < 2.5
    assert nearest > 0.3


def test_two_hundred_people_with_goals_of_their_own(model):
    controller = model.controller(ROOMS)
    draw = np.random.default_rng(0)
    goals = draw.uniform((0.5, 0.5), (4.5, 5.5), (200, 2))
    people = draw.uniform((0.5, 0.5), (4.5, 5.5), (200, 2))
    answer = controller.step(dict(enumerate(people)), dict(enumerate(goals)))
    assert len(answer) == 200 and np.isfinite(arrays(answer)).all()
    few = controller.step({5: people[5], 150: people[150]})
    assert list(few) == [5, 150]


def test_goals_that_nobody_has_any_more_are_forgotten():
    policy = Straight()
    controller = Controller(policy, rectangles(room((0, 0), (5, 5), 0.1), resolution=0.1))
    cells = np.stack(np.meshgrid(np.arange(1, 4, 0.2), np.arange(1, 4, 0.2)), -1).reshape(-1, 2)
    for goal in cells[:100]:
        velocity = controller.step(
            {"stays": (1.0, 3.0), "turns": (2.0, 2.0)}, {"stays": (4.0, 3.0), "turns": goal}
        )
        np.testing.assert_allclose(velocity["stays"], (1.3, 0), atol=1e-5)
        way = goal - (2.0, 2.0)
        if np.linalg.norm(way) > 0.1:
            np.testing.assert_allclose(velocity["turns"], 1.3 * way / np.linalg.norm(way), atol=1e-5)
    assert controller._ways.planner.goals < 80


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
    ],
)
def test_what_cannot_be_walked_is_refused_and_changes_nothing(positions, goals, message):
    controller = Controller(Straight(), ROOMS)
    with pytest.raises(UserError, match=message):
        controller.step(positions, goals)
    assert list(controller.step({"cy": (1, 1)}, {"cy": (3, 3)})) == ["cy"]


def test_a_goal_inside_a_wall_is_refused():
    plan = rectangles([*room((0, 0), (6, 3), 0.2), (2.0, 0.0, 4.0, 2.0)])
    with pytest.raises(UserError, match=r"goal of 'anna': .* in a wall or too near to one"):
        Controller(Straight(), plan).step({"anna": (1, 1)}, {"anna": (3, 0.9)})


@pytest.mark.parametrize("dt", [0.3, 0.8, 0.0, -0.1, float("nan"), float("inf")])
def test_steps_that_do_not_divide_the_clock_are_refused(dt: float):
    with pytest.raises(UserError, match=f"dt {dt}: .* every 0.4 s"):
        Controller(Straight(), dt=dt)


def test_a_policy_that_decides_more_often_than_it_is_called_is_refused():
    with pytest.raises(UserError, match=r"dt 0\.4: the policy decides every 0\.1 s"):
        Controller(load_policy("orca"))


def test_settings_out_of_range_are_refused(model, tmp_path: Path):
    with pytest.raises(UserError, match=r"nowhere\.yaml"):
        model.controller(tmp_path / "nowhere.yaml")
    with pytest.raises(UserError, match="execute_steps 4"):
        Controller(model.policy(execute_steps=4))
    with pytest.raises(UserError, match=r"pref_speed -1\.0 of 'a'"):
        Controller(Straight(), pref_speed=-1).step({"a": (0, 0)}, {"a": (1, 0)})
    with pytest.raises(UserError, match="not finite for 'a'"):
        Controller(Straight(factor=float("nan"))).step({"a": (0, 0)}, {"a": (1, 0)})


def test_ids_have_numbers_that_no_run_changes():
    assert [number_of(one) for one in (0, 3, np.int64(3), True)] == [0, 3, 3, 1]
    assert number_of("anna") == 1857110474486603798
    assert number_of(-1) >= 0


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_model_on_a_gpu_walks_as_on_the_cpu():
    people, goals = {"a": (1.0, 3.0), "b": (9.0, 2.0)}, {"a": (9.0, 3.0), "b": (1.0, 2.0)}
    here, there = pedzoo.load("sgan_goal_map.zara1"), pedzoo.load("sgan_goal_map.zara1").cuda()
    expected, found = (arrays(m.controller(ROOMS).step(people, goals)) for m in (here, there))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_positions_too_far_away_to_be_exact() -> None:
    controller = pedzoo.load("constant_velocity").controller(None)
    with pytest.raises(UserError, match=r"'a' is more than 10000 m from the origin.*subtract an offset"):
        controller.step({"a": (500000.3, 4649776.2)}, {"a": (500005.0, 4649776.0)})
