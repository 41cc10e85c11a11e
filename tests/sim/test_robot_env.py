"""Robots among people: bodies, actions, outcomes, sensors, and people who are the same without the robot."""

import math
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import pedzoo
from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.core.bodies import Fleet, RobotBody
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_REWARDS, ROBOTS, SENSORS
from pedzoo.core.spec import build
from pedzoo.policies.load import load_robot_policy
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.sim.robots.rewards import Outcome, RobotReward
from pedzoo.sim.robots.scenes import with_robots
from pedzoo.sim.robots.sensors import Sensor
from pedzoo.sim.scenario import PreparedScenario

OPEN = "circle:people=4"
CROWDED = "perpendicular:people=15"
FLAT = "goals:map=apartment.7,people=3"


@lru_cache(maxsize=24)
def shared_scenes(scenario: str, robot: Any) -> PreparedScenario:
    return pedzoo.make_robot_env(scenario, robot).prepared


def made(scenario: Any = FLAT, **settings: Any) -> RobotEnv:
    if isinstance(scenario, str) and not settings.keys() & {"clearance", "body_radius", "present"}:
        robot = settings.pop("robot", "disc")
        scenario = shared_scenes(scenario, tuple(robot) if isinstance(robot, list) else robot)
    return pedzoo.make_robot_env(scenario, **{"people": "go_to_goal", "num_envs": 4} | settings)


def driven(env: RobotEnv, action: Tensor, decisions: int = 1) -> Any:
    seen = env.reset(seed=0)
    for _ in range(decisions):
        seen["robots", "action"] = action.expand(*env.batch_size, env.robots, 2)
        seen = env.step(seen)["next"]
    return seen


@pytest.mark.parametrize("robot", sorted(ROBOTS.names()))
def test_every_robot_stays_within_its_limits(robot: str) -> None:
    env = made(OPEN, robot=robot, sensors=["goal", "odometry"], ends_at="none")
    check_env_specs(env)
    body = env.scenes.bodies[0]
    seen = env.reset(seed=1)
    for _ in range(10):
        seen = env.rand_action(seen)
        seen["robots", "action"] = 10 * seen["robots", "action"]
        seen = env.step(seen)["next"]
        assert env.state.velocity[:, -1].norm(dim=-1).max() <= body.top_speed + 1e-4
        assert body.drive == "holonomic" or env.state.turn_rate[:, -1].abs().max() <= body.top_turn + 1e-4
    assert torch.equal(env.state.radius[:, -1], torch.full((4,), body.radius))


@pytest.mark.parametrize("name", sorted(SENSORS.names()))
def test_every_sensor_stays_within_its_spec(name: str) -> None:
    physics = "bullet" if name == "camera" else "compiled"
    check_env_specs(made(sensors=[name], num_envs=2, physics=physics))


def term_of(name: str, before: Any, after: Any, trace: Tensor, outcome: Any = None) -> list[float]:
    """Return a term of the reward of all robots."""
    reward: Any = build(ROBOT_REWARDS, name, RobotReward)
    return reward(before, after, trace, outcome).flatten().tolist()


def test_rewards_of_discomfort_by_hand() -> None:
    """People of 0.15 and 0.3 m, 0.1 m from robots of 0.2 and 0.4 m for 0.1 s; half of what they like."""
    bodies = torch.tensor([[0.15, 0.2], [0.3, 0.4]])
    trace = torch.zeros(2, 2, 1, 2)
    trace[:, 1, 0, 0] = bodies.sum(1) + 0.1
    kind = torch.tensor([[PERSON, ROBOT]]).expand(2, 2)
    state = SimpleNamespace(mask=torch.ones(2, 2, dtype=torch.bool), kind=kind, radius=bodies)
    view = SimpleNamespace(state=state, robots=1)
    assert term_of("discomfort", view, view, trace) == pytest.approx([-0.05, -0.05])
    for distance in (0, -0.2):
        with pytest.raises(UserError, match="expected metres above 0"):
            build(ROBOT_REWARDS, f"discomfort:distance={distance}", RobotReward)


def test_rewards_by_hand() -> None:
    """A person at the origin, and two robots that drive along x for two steps of 0.1 s."""
    trace = torch.tensor([[[[0.0, 0.0]] * 2, [[0.5, 0.0], [0.6, 0.0]], [[3.0, 0.0], [2.9, 0.0]]]])
    person = {"mask": torch.ones(1, 3, dtype=torch.bool), "kind": torch.tensor([[PERSON, ROBOT, ROBOT]])}
    person["radius"] = torch.tensor([[0.15, 0.3, 0.3]])
    views: list[Any] = []
    for goals, path in (([0, 1, 2], [9.0, 5.0, 4.0]), ([0, 1, 3], [8.0, 4.5, 7.0])):
        now = {"goal_id": torch.tensor([goals]), "remaining_path": torch.tensor([path])}
        views.append(SimpleNamespace(state=SimpleNamespace(**now, **person), robots=2))
    yes, no = torch.ones(1, 2, dtype=torch.bool), torch.zeros(1, 2, dtype=torch.bool)
    first, second = torch.tensor([[True, False]]), torch.tensor([[False, True]])
    outcome = Outcome(yes, first, no, no, second, no, no, no)
    for name, result, expected in (
        # half a metre of the way; the second robot has reached its goal and has another one
        ("progress", outcome, [0.5, 4.0]),
        ("success", outcome, [1, 0]),
        ("collision", outcome, [0, -1]),
        ("collision", outcome._replace(person_contact=first, wall_contact=no), [-1, 0]),
        ("time", outcome._replace(active=first), [-0.2, 0.0]),
        # gaps of 0.05 and 0.15 m where 0.2 m are liked, for 0.1 s each
        ("discomfort", outcome, [-(0.15 + 0.05) / 0.2 * 0.1, 0.0]),
    ):
        assert term_of(name, views[0], views[1], trace, result) == pytest.approx(expected), name


def test_every_reward_is_a_number_for_every_robot() -> None:
    weights = (dict.fromkeys(ROBOT_REWARDS.names(), weight) for weight in (1.0, 2.0))
    envs = [made(robot=["disc", "unicycle"], reward=reward, sensors=["goal"]) for reward in weights]
    once, twice = (driven(env, torch.tensor([0.5, 0.1]), 5)["robots", "reward"] for env in envs)
    assert twice.shape == (4, 2, 1)
    torch.testing.assert_close(twice, 2 * once)


def test_actions_are_what_each_drive_says() -> None:
    """Hand-computed: a disc that faces north goes forward; wheels of 0.2 and 0.4 m/s turn by 0.5 rad/s."""
    disc, car, pair = (build(ROBOTS, name, object) for name in ("disc", "unicycle", "diff_drive"))
    fleet = Fleet.of([disc, car, pair])
    action = torch.tensor([[[0.5, 0.0], [0.5, 9.0], [0.2, 0.4]]])
    heading = torch.full((1, 3), math.pi / 2)
    expected = torch.tensor([[[0.0, 0.5], [0.5, 2.0], [0.2, 0.4]]])
    torch.testing.assert_close(fleet.commands(action, heading), expected, atol=1e-6, rtol=0)
    nan = fleet.commands(torch.full((1, 3, 2), torch.nan), heading)
    assert nan.isnan().any(-1).all()


def test_a_robot_arrives_in_the_time_that_its_way_takes() -> None:
    env = made("goals:map=flat,people=0", sensors=["goal"], reward={"success": 1.0}, num_envs=1)
    seen, policy, decisions = env.reset(seed=3), load_robot_policy("straight"), 0
    way = float(env.state.remaining_path[0, -1])
    while not seen["done"].any() and decisions < 1000:
        seen, decisions = env.step(policy(seen))["next"], decisions + 1
    assert seen["robots", "info", "success"].all() and seen["terminated"].all()
    assert seen["robots", "reward"].all() and decisions * env.decision_dt == pytest.approx(way - 0.3, abs=0.5)


def test_a_robot_that_stands_runs_out_of_time() -> None:
    env = made("goals:map=flat,people=0", sensors=["goal"], time_limit=1.0)
    seen = driven(env, torch.zeros(2), 5)
    assert seen["robots", "info", "timeout"].all() and seen["truncated"].all()
    assert not seen["terminated"].any()


@pytest.mark.parametrize(("ends_at", "ends"), [("any", True), ("agent", True), ("none", False)])
def test_contacts_end_episodes_as_asked(ends_at: str, ends: bool) -> None:
    """A wide robot goes straight among people who all walk as if they were alone."""
    env = made(CROWDED, robot="disc:radius=0.6", ends_at=ends_at, sensors=["goal"])
    seen, policy = env.reset(seed=0), load_robot_policy("straight")
    touched = ended = torch.zeros(4, 1, dtype=torch.bool)
    for _ in range(60):
        seen = env.step(policy(seen))["next"]
        info = seen["robots", "info"]
        touched = touched | info["person_contact"]
        ended = ended | (info["person_contact"] & seen["done"] & ~info["success"])
    assert touched.any() and bool(ended.any()) == ends


def test_people_do_not_change_where_the_robot_is_missing() -> None:
    """The same seed, with and without robots: people begin alike, and walk alike until they meet one."""
    joined, alone = (made(num_envs=3, seed=5, present=present, people="orca") for present in (True, False))
    for env in (joined, alone):
        env.reset()
    people = alone.state.mask.shape[1] - 1
    assert not alone.state.mask[:, -1].any() and joined.state.mask[:, -1].all()
    for name in ("pref_speed", "goal_id", "later_goals", "mask", "radius"):
        first, second = getattr(joined.state, name), getattr(alone.state, name)
        assert torch.equal(first[:, :people], second[:, :people]), name
    assert torch.equal(joined.state.past[:, :people, 0], alone.state.past[:, :people, 0])


def test_zero_people_one_robot_and_a_number_that_varies() -> None:
    env = made("goals:map=flat,people=[1,3]", num_envs=32)
    env.reset()
    counts = env.state.mask[:, :-1].sum(1)
    assert counts.min() == 1 and counts.max() == 3 and env.state.mask[:, -1].all()


def test_people_are_seen_in_the_robots_frame_nearest_first() -> None:
    """Turning the robot turns what it sees; distances are those of the world."""
    env = made(OPEN, robot="unicycle", sensors=["people:most=3,reach=50", "goal"])
    seen = env.reset(seed=2)
    rows, mask = (seen["robots", "observation", name][:, 0] for name in ("people", "people_mask"))
    away = (env.state.position[:, :-1] - env.state.position[:, -1:]).norm(dim=-1).sort(-1).values
    assert mask.all()
    torch.testing.assert_close(rows[..., :2].norm(dim=-1), away[:, :3])
    goal = env.state.goal_point[:, -1] - env.state.position[:, -1]
    angle = torch.atan2(goal[:, 1], goal[:, 0]) - env.state.heading[:, -1]
    expected = goal.norm(dim=-1, keepdim=True) * torch.stack((angle.cos(), angle.sin()), -1)
    torch.testing.assert_close(seen["robots", "observation", "goal"][:, 0], expected)


def test_lidar_measures_walls_and_bodies_and_not_itself() -> None:
    env = made("goals:map=flat,people=5", sensors=["lidar:beams=16,reach=4"], num_envs=8)
    seen = env.reset(seed=0)["robots", "observation", "lidar"]
    assert seen.min() > 0.0 and seen.max() <= 4.0 and (seen < 4).any()
    state = env.state
    gone = state._replace(mask=torch.cat((torch.zeros_like(state.mask[:, :-1]), state.mask[:, -1:]), 1))
    lidar = build(SENSORS, "lidar:beams=16,reach=4", Sensor)
    walls = lidar.read(env.view(gone, env.rules.guidance(gone)))["lidar"]
    assert (walls >= seen - 1e-5).all() and (walls > seen + 0.1).any()


def test_noise_dropout_and_delay() -> None:
    """Noise is that of the scene, not of the batch; a late sensor says what it said before."""
    exact, noisy, late = (
        made(sensors=[f"people:{more}most=3,reach=50"], seed=4) for more in ("", "noise=0.1,", "delay=0.4,")
    )
    first = [env.reset()["robots", "observation", "people"] for env in (exact, noisy, late)]
    off = (first[1] - first[0])[first[0] != 0]
    assert 0.03 < off.std() < 0.3
    again = made(sensors=["people:noise=0.1,most=3,reach=50"], seed=4, num_envs=2).reset()
    torch.testing.assert_close(again["robots", "observation", "people"], first[1][:2])
    at_first = exact.reset(seed=0)["robots", "observation", "people"]
    now, before = (driven(env, torch.zeros(2), 2)["robots", "observation", "people"] for env in (exact, late))
    torch.testing.assert_close(before, at_first)
    assert not torch.allclose(now, before)


def test_scenes_that_begin_anew_are_sensed_as_in_a_look_at_all() -> None:
    """Sensors are asked about these scenes alone; what was read of the others stays."""
    sensors = ["goal", "lidar:beams=8,noise=0.02", "people:most=3,delay=0.4"]
    env = made(num_envs=12, sensors=sensors)
    now, policy, some = env.reset(seed=3), load_robot_policy("straight"), 0
    for _ in range(25):
        before, now = env.step_and_maybe_reset(policy(now))
        seen: Any = now["robots", "observation"]
        whole = env.view(env.state, env.rules.guidance(env.state))
        for sensor in (build(SENSORS, name, Sensor) for name in sensors[:2]):
            for name, value in sensor.observe(whole).items():
                torch.testing.assert_close(seen[name], value)
        anew = before["next", "done"][:, 0]
        some += bool(anew.any() and not anew.all())
        late = build(SENSORS, "people:most=3", Sensor).read(whole)["people"]
        torch.testing.assert_close(seen["people"][anew], late[anew])
        kept = before["next", "robots", "observation", "people"]
        assert torch.equal(seen["people"][~anew], kept[~anew])
    assert some > 2


@pytest.mark.parametrize(
    ("people", "robot"), [("orca", "disc"), ("go_to_goal", "unicycle"), ("orca", "diff_drive")]
)
def test_an_action_that_is_no_number_ends_its_scene_alone(people: str, robot: str) -> None:
    """ORCA's people decide twice in a decision of the robot: the scene fails in the first half."""
    one, other = (made(people=people, robot=robot) for _ in range(2))
    action, last = torch.zeros(4, 1, 2), one.prepared.people - 1
    expected = driven(other, action)
    action[1] = torch.nan
    with pytest.warns(UserWarning, match=rf"robot's policy gave .*nan.* for agent {last} of scene 1"):
        seen = driven(one, action)
    for flags in (seen["robots", "info", "failed"], seen["truncated"]):
        assert flags[:, 0].tolist() == [False, True, False, False]
    rest = [0, 2, 3]
    assert torch.equal(seen["agents", "history"][rest], expected["agents", "history"][rest])


@pytest.mark.parametrize("policy", ["stop", "straight", "orca", "social_force:preset=indoor"])
@pytest.mark.parametrize("robot", ["turtlebot4", ["disc", "jackal"]])
def test_policies_move_robots_of_all_drives(policy: str, robot: Any) -> None:
    env = made(robot=robot, people="orca")
    path = env.rollout(20, load_robot_policy(policy))["next", "agents", "history"][:, :, -env.robots :]
    moved = path[:, -1, :, -1] - path[:, 0, :, 0]
    assert (moved.norm(dim=-1) > 0.2).any() == (policy != "stop")


def test_a_step_before_a_reset_is_refused() -> None:
    env = made(OPEN)
    with pytest.raises(UserError, match=r"call reset\(\) first"):
        env.step(env.rand_action())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"robot": "husk"}, "husky"),
        ({"robot": "disc:radius=-1"}, "radius"),
        ({"sensors": ["lidarr"]}, "lidar"),
        ({"sensors": ["lidar:beams=0"]}, "beams"),
        ({"sensors": ["goal:delay=0.3"]}, "delay"),
        ({"reward": {"progres": 1}}, "progress"),
        ({"reward": ["progress"]}, r"reward \['progress'\]: expected weights by name"),
        ({"reward": "progress"}, "reward 'progress': expected weights by name"),
        ({"reward": {"progress": "x"}}, "reward progress: weight 'x': expected a finite number"),
        ({"reward": {"progress": float("nan")}}, "reward progress: weight nan: expected a finite number"),
        ({"ends_at": "wall"}, "ends_at"),
        ({"num_envs": 2.5}, "num_envs 2.5: expected a whole number"),
        ({"seed": "a"}, "seed 'a': expected a whole number"),
        ({"scenario": None}, "scenario None: expected its name with settings"),
        ({"scenario": "goals:map=flat,people=500"}, "fit"),
        ({"scenario": "goals:people=2026-11-99"}, "day is out of range"),
        ({"robots": "disc"}, "argument of make_robot_env .* did you mean 'robot'"),
        ({"sead": 3}, "argument of make_robot_env .* did you mean 'seed'"),
    ],
)
def test_wrong_names_and_numbers_are_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        made(**settings)


def test_wrong_arguments_of_make_env_are_named() -> None:
    with pytest.raises(UserError, match="argument of make_env 'num_env': did you mean 'num_envs'"):
        pedzoo.make_env(OPEN, num_env=3)  # type: ignore[call-arg]


OWN = """
import torch
from pedzoo.sim.robots.rewards import RobotReward
from pedzoo.sim.robots.sensors import Reading, Sensor

class Clock(Sensor):
    readings = {"clock": Reading((2,))}
    def read(self, view):
        return {"clock": view.heading.unsqueeze(-1)}

class Misspelt(Clock):
    def read(self, view):
        return {"klock": view.own(view.position)}

class Wide(RobotReward):
    def __call__(self, before, after, trace, outcome):
        return after.heading.unsqueeze(-1)

class Flat(Wide):
    def __call__(self, before, after, trace, outcome):
        return after.heading[:, 0]

class Split(Wide):
    def __call__(self, before, after, trace, outcome):
        return 0 * after.heading / 0

class Large(Wide):
    def __call__(self, before, after, trace, outcome):
        return 0 * after.heading + 3e38
"""


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"sensors": "Clock"}, r"sensor Clock: clock is \(4, 1, 1\): expected \(B, R, ...\) = \(4, 1, 2\)"),
        ({"sensors": "Clock:noise=0.1"}, "sensor Clock: clock is"),
        ({"sensors": "Misspelt"}, "sensor Misspelt: read returned klock: expected .* clock"),
        ({"reward": "Wide"}, r"Wide returned \(4, 1, 1\): expected \(B, R\) = \(4, 1\)"),
        ({"reward": "Flat"}, r"Flat returned \(4,\): expected \(B, R\) = \(4, 1\)"),
        ({"reward": "Split"}, "Split returned nan: expected finite numbers"),
        ({"reward": "Large"}, "Large: their sum is no finite number"),
    ],
)
def test_sensors_and_rewards_of_other_shapes_are_named(settings: dict[str, str], said: str, tmp_path) -> None:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    ((kind, name),) = settings.items()
    own: Any = {"progress": 1.0, f"{file}:{name}": 2.0} if kind == "reward" else f"{file}:{name}"
    with pytest.raises(UserError, match=said):
        driven(made(OPEN, **{kind: own}), torch.zeros(2))


@pytest.mark.parametrize("sensor", ["lidar:beams=5", build(SENSORS, "lidar:beams=5", Sensor)])
def test_one_sensor_needs_no_list(sensor: Any) -> None:
    one, several = (
        made(OPEN, sensors=sensors).reset()["robots", "observation"] for sensors in (sensor, [sensor])
    )
    assert list(one.keys()) == list(several.keys()) == ["lidar"]
    assert one["lidar"].shape[-1] == 5
    with pytest.raises(UserError, match="did you mean"):
        load_robot_policy("orcaa")


def test_robots_are_added_to_the_people_and_one_may_replay() -> None:
    bodies = [RobotBody(), RobotBody()]
    assert with_robots("circle", bodies).people == with_robots("circle:people=4", bodies).people == 6
    refused = "replay with 2 robots, simulated=one, stops=false: expected one robot"
    with pytest.raises(UserError, match=refused):
        with_robots("replay", bodies)


def test_a_patch_shows_walls_and_bodies_around_the_robot() -> None:
    """Every body within the square lights up the cell that its centre is in, and walls those of a lidar."""
    env = made("goals:map=flat,people=5", sensors=["patch:cells=40,side=8", "people:most=5"], num_envs=8)
    seen = env.reset(seed=0)["robots", "observation"]
    patch, rows, mask = seen["patch"][:, 0], seen["people"][:, 0], seen["people_mask"][:, 0]
    inside = mask & (rows[..., :2].abs().amax(-1) < 3.9)
    assert inside.sum() > 5
    for scene, person in inside.nonzero().tolist():
        x, y = rows[scene, person, :2].tolist()
        row, column = int((4 - x) / 0.2), int((4 - y) / 0.2)
        assert patch[scene, 1, row, column] == 1
    assert not patch[:, :, 19:21, 19:21].any()
    assert 0 < patch[:, 0].mean() < 0.9
