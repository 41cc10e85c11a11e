"""Robots that learn: what their network sees, where they learn, what a training does, and weights by name."""

import math
import re
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from helpers.training import LIGHTNING_MARKS, last, quiet_trainer
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.envs.utils import check_env_specs

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.bodies import Fleet
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import build
from pedzoo.models.zoo.store import robots
from pedzoo.policies.load import list_robot_policies, load_planner, load_robot_policy
from pedzoo.policies.robots._base import ObservedPeople, Robot, bodies_of
from pedzoo.policies.robots.attention import Attention, as_action, as_decision, frame_of
from pedzoo.sim.crowdnav import COLLISION, CROWDNAV, CROWDNAV_PP, SUCCESS, TIMEOUT, cases
from pedzoo.sim.robots.env import make_robot_env
from pedzoo.train.ppo.crowdnav import CrowdNavEnv, Crowds
from pedzoo.train.ppo.robots import RobotPPO, act, taught, teacher_of, walked_once
from tools.kills import difference
from tools.paper.crowdnav import run

pytestmark = LIGHTNING_MARKS

BEAMS = 32


def network(beams: int = 0) -> Attention:
    """Return a network whose answers depend on all that it sees."""
    torch.manual_seed(0)
    policy = Attention(width=16, beams=beams)
    nn.init.normal_(cast("nn.Linear", policy.net[-1]).weight, std=0.3)
    return policy


def scene(robot: str = "disc", **changes: Tensor) -> TensorDict:
    """Return what robots sense anywhere, but for some readings: one robot among 4 people in 6 scenes."""
    draw, shape = torch.Generator().manual_seed(1), (6, 1)

    def some(*size: int) -> Tensor:
        return torch.randn(*shape, *size, generator=draw)

    rows = torch.cat((2 * some(4, 4), 0.2 + 0.2 * some(4, 1).abs()), -1)
    seen = {
        "waypoint": 2 * some(2),
        "velocity": 0.5 * some(2),
        "remaining_path": some(1).abs() * 4,
        "turn_rate": torch.zeros(*shape, 1),
        "radius": torch.full((*shape, 1), 0.3),
        "people": rows,
        "people_mask": some(4) > -1,
        "lidar": (some(BEAMS).abs() * 2).clamp_max(5.0),
    }
    body = TensorDict(Fleet.of([build(ROBOTS, robot, object)])._asdict(), (1,)).expand(shape)
    group = {"observation": TensorDict(seen | changes, shape), "body": body}
    return TensorDict({"robots": TensorDict(group, shape)}, (6,))


@pytest.mark.parametrize("beams", [0, BEAMS])
def test_a_disc_that_faces_elsewhere_goes_the_same_way(beams: int) -> None:
    """Its own frame is turned by three beams: so are its velocities, and nothing else."""
    policy, given = network(beams), scene()
    angle = torch.tensor(3 * 2 * math.pi / BEAMS)
    direction = torch.stack((angle.cos(), angle.sin()))
    seen = cast("TensorDict", given["robots", "observation"])
    place, velocity, radius = seen["people"].split([2, 2, 1], -1)
    turned = scene(
        "disc",
        people=torch.cat((rotate(place, direction), rotate(velocity, direction), radius), -1),
        **{name: rotate(seen[name], direction) for name in ("waypoint", "velocity")},
        lidar=seen["lidar"].roll(3, -1),
    )
    # beams are taken in whole steps: ways that begin between two of them round alike
    expected = rotate(policy.action(given), direction)
    torch.testing.assert_close(policy.action(turned), expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("robot", ["disc", "diff_drive"])
def test_order_of_people_and_masked_ones_do_not_matter(robot: str) -> None:
    policy, given = network(), scene(robot)
    seen = cast("TensorDict", given["robots", "observation"])
    people, mask, action = seen["people"], seen["people_mask"], policy.action(given)
    order = torch.tensor([2, 0, 3, 1])
    other = scene(robot, people=people[:, :, order], people_mask=mask[:, :, order])
    torch.testing.assert_close(policy.action(other), action)
    moved = scene(robot, people=torch.where(mask.unsqueeze(-1), people, 7.0))
    torch.testing.assert_close(policy.action(moved), action)
    assert not torch.allclose(policy.action(scene(robot, people=cast("Tensor", 0.9 * people))), action)
    assert policy.action(scene(robot, people_mask=torch.zeros_like(mask))).isfinite().all()


def test_untrained_it_goes_to_the_waypoint_at_top_speed() -> None:
    """Hand-computed, for a waypoint at 0.2 rad to the left: wheels turn at 2.5 times that."""
    ahead = torch.tensor([math.cos(0.2), math.sin(0.2)])
    speed, turn = math.cos(0.2), 0.5
    expected = {"disc": ahead.tolist(), "unicycle": [speed, turn], "diff_drive": [speed - 0.1, speed + 0.1]}
    for robot, action in expected.items():
        given = scene(robot, waypoint=(3 * ahead).expand(6, 1, 2))
        torch.testing.assert_close(Attention().action(given)[2, 0], torch.tensor(action))


def test_sensors_that_lack_are_told() -> None:
    env = pedzoo.make_robot_env("circle:people=4", sensors=["goal"], num_envs=2)
    with pytest.raises(UserError, match=r"no people, velocity: attention needs sensors=\['goal', 'odometry'"):
        Attention()(env.reset())
    with pytest.raises(UserError, match="width 10, heads 4, beams 0"):
        Attention(width=10)


@pytest.mark.parametrize("name", ["straight", "crowdnav_orca", "robot_ppo.circle"])
def test_the_crossing_is_crowdnavs(name: str) -> None:
    """Cases end as those of the rules that are CrowdNav's to the digit, when they do."""
    check_env_specs(CrowdNavEnv(3, crowds=8))
    expected = run(load_planner(name, 0.25), CROWDNAV, cases(CROWDNAV, range(1000, 1030)))
    env = CrowdNavEnv(30, crowds=30, first=1000)
    now, over, seconds = env.reset(), torch.zeros(30, dtype=torch.bool), torch.zeros(30)
    outcome, planner = torch.zeros(30, dtype=torch.long), load_planner(name, 0.25)
    while not bool(over.all()):
        seen = {key: value[:, 0] for key, value in now["robots", "observation"].items()}
        robot = Robot(0 * seen["goal"], seen["velocity"], seen["goal"], seen["radius"][:, 0], torch.ones(30))
        place, velocity, radius = seen["people"].split([2, 2, 1], -1)
        people = ObservedPeople(place, velocity, radius[..., 0], seen["people_mask"])
        now["robots", "action"] = planner(robot, people).unsqueeze(1)
        now = env.step(now)["next"]
        info = now["robots", "info"]
        happened = info["success"] * SUCCESS + info["person_contact"] * COLLISION + info["timeout"] * TIMEOUT
        outcome = torch.where(over, outcome, happened[:, 0])
        seconds = torch.where(over, seconds, seconds + 0.25)
        over = over | now["done"][:, 0]
    same = (outcome == expected.outcome) & (seconds == expected.seconds)
    assert same.float().mean() >= 0.9  # single precision, and the robot's own frame


def test_the_shipped_robot_gets_through_crowdnavs_cases() -> None:
    """500 cases: .996 in 9.49 s, by `pedzoo reproduce crowdnav --models robot_ppo.circle`."""
    runs = run(load_planner("robot_ppo.circle", 0.25), CROWDNAV, cases(CROWDNAV, range(1000, 1100)))
    arrived = runs.outcome == SUCCESS
    assert arrived.float().mean() >= 0.98 and 9 < runs.seconds[arrived].mean() < 10


def test_wheels_reach_the_goal_as_their_limits_allow() -> None:
    """No person is there. At 1 m/s^2 top speed takes a second and half a metre: 0.5 s more than a disc."""
    for robot, expected in {"disc": 7.75, "diff_drive": 8.25, "diff_drive:acceleration=1000": 7.75}.items():
        env = CrowdNavEnv(2, people=1, crowds=2, robot=robot)
        env.crowds = env.crowds._replace(place=env.crowds.place + 100)
        ends = walked_once(env, Attention().mean)
        assert ends["success"] == 1 and ends["seconds"] == expected


def test_standing_where_a_person_will_be_costs_intrusion() -> None:
    """A person comes up to a robot that stands at (0, -4): bodies of 0.3 m overlap within 0.6 m."""
    env = CrowdNavEnv(1, CROWDNAV_PP, people=1, crowds=1, reward={"intrusion": 4.0})
    check_env_specs(env)
    steps = torch.arange(env.crowds.place.shape[1])
    place = torch.stack((torch.zeros(len(steps)), -2.0 - 0.19 * steps.clamp_max(8)), -1)
    ends = torch.tensor([[0.0, -4.0]])
    env.crowds = Crowds(place.view(1, -1, 1, 2), torch.zeros(1, len(steps), 1, 2), ends, -ends)
    now, costs = env.reset(), []
    for _ in range(4):
        now["robots", "action"] = torch.zeros(1, 1, 2)
        now = env.step(now)["next"]
        costs.append(float(now["robots", "reward"]))
    # from step 8 on it is 0.48 m away; five steps are looked ahead
    assert costs == pytest.approx([0, 0, 0, -1.0])
    with pytest.raises(UserError, match="did you mean 'intrusion'"):
        CrowdNavEnv(1, people=1, crowds=1, reward={"intrusoin": 1.0})


def test_crowdnav_pp_replaces_people_and_shows_the_near_ones() -> None:
    env = CrowdNavEnv(8, CROWDNAV_PP, crowds=8, first=1425)
    seen = cast("Any", env.reset()["robots", "observation"])
    gap = seen["people"][..., :2].norm(dim=-1) - 0.6
    assert ((gap <= 5.0) | ~seen["people_mask"]).all() and seen["people_mask"].any()
    assert (seen["goal"].norm(dim=-1) >= 8).all()
    moved = env.crowds.place.diff(dim=1).norm(dim=-1)
    assert (moved < 0.26).float().mean() > 0.99 and (moved > 2).any()  # 1 m/s, and new people elsewhere


@pytest.mark.parametrize("robot", ["disc", "unicycle", "diff_drive"])
def test_decisions_and_actions_are_each_others_inverse(robot: str) -> None:
    given, decision = scene(robot), 0.6 * torch.rand(6, 1, 2)
    bodies = bodies_of(given)
    action = as_action(decision, frame_of(given, bodies), bodies)
    torch.testing.assert_close(as_decision(action, frame_of(given, bodies), bodies), decision)


def test_any_policy_of_robots_teaches() -> None:
    now = make_robot_env("door:people=2", sensors=Attention().sensors, num_envs=3).reset()
    straight = teacher_of("straight")(now)
    act(now, straight)
    torch.testing.assert_close(now["robots", "action"], load_robot_policy("straight").action(now))
    assert not torch.allclose(straight, teacher_of("orca")(now), atol=1e-3)
    with pytest.raises(UserError, match="orka"):
        teacher_of("orka")


def test_the_teacher_gets_most_robots_through() -> None:
    ends = walked_once(CrowdNavEnv(100, crowds=100), taught)
    assert ends["success"] > 0.85 and ends["seconds"] < 10.5


def trained(policy: Attention, people: int = 1, **options: Any) -> RobotPPO:
    settings: dict[str, Any] = {"envs": 64, "steps": 16, "minibatches": 4, "lr": 3e-3} | options
    module = RobotPPO(policy, [f"crowdnav:people={people},crowds=64"], updates=8, **settings)
    quiet_trainer(max_epochs=1, limit_val_batches=0).fit(module)
    return module


def test_rewards_make_a_robot_faster_that_hardly_moves() -> None:
    torch.manual_seed(1)  # one of ten seeds needs more updates
    policy = Attention(width=16)
    with torch.no_grad():
        cast("nn.Linear", policy.net[-1]).bias[0] = -0.9  # 0.1 m/s
    env = CrowdNavEnv(50, people=1, crowds=50)
    before = walked_once(env, policy.mean)["return"]
    trained(policy)
    assert walked_once(env, policy.mean)["return"] > before + 1


def test_imitation_comes_near_the_teacher() -> None:
    """It misses less of what the teacher says, in what the teacher's own robot meets."""
    env = CrowdNavEnv(32, crowds=32)
    now, met = env.reset(), []
    for _ in range(16):
        met.append(now.select(("robots", "observation"), ("robots", "body")).clone())
        act(now, taught(now))
        now = env.step(now)["next"]
    scenes: Any = torch.cat(met)

    def missed() -> float:
        with torch.no_grad():
            return float((policy.mean(scenes) - taught(scenes)).square().mean())

    policy = Attention(width=16)
    before = missed()
    trained(policy, people=5, envs=32, imitate=8)
    assert missed() < 0.85 * before


FIT = ["fit", "--config", "robot/ppo", "--trainer.enable_progress_bar", "false", "--model.envs=8"]
FIT += ["--model.steps=4", "--model.updates=2", "--model.episodes=4", "--model.minibatches=2"]
FIT += ["--model.policy.width=16", "--model.final_lr=1", "--trainer.check_val_every_n_epoch=1"]
CASES = {"crowdnav:crowds=16": "disc", "crowdnav_pp:crowds=9,people=3": "disc", "door:people=2": "diff_drive"}


def fitted(runs: Path, epochs: int, scenario: str = "crowdnav:crowds=16", *options: str) -> Path:
    """Train in a scenario and return the run's folder."""
    place = ["--model.scenarios", f"[{scenario!r}]", "--model.robot", CASES[scenario], f"--runs={runs}"]
    assert main([*FIT, *place, "--model.decision_dt=0.4", f"--trainer.max_epochs={epochs}", *options]) == 0
    return next(runs.glob("*/*"))


@pytest.mark.parametrize("scenario", CASES)
def test_the_command_line_trains_and_what_it_trained_loads(scenario: str, tmp_path, capsys) -> None:
    run = fitted(tmp_path, 1, scenario)
    printed, best = capsys.readouterr().out, run / "checkpoints" / "best.ckpt"
    assert re.search(r"\nval/return -?\d+\.\d{3} \(epoch 0\), success \d\.\d\d, \d+ s\nnext: ", printed)
    assert f"next: pedzoo evaluate {best} straight --suite robots --people orca --quick" in printed
    assert run.name == f"{scenario.partition(':')[0]}-seed0"
    logged = (run / "metrics.csv").read_text()
    for name in ("train/samples_per_s", "train/kl", "val/success", "val/return"):
        assert name in logged
    assert "nan" not in logged
    policy = load_robot_policy(str(last(run)))
    assert isinstance(policy, Attention) and policy.config["width"] == 16
    assert policy.action(scene(CASES[scenario])).shape == (6, 1, 2)


@pytest.mark.parametrize("scenario", ["crowdnav:crowds=16", "door:people=2"])
def test_a_resumed_training_ends_as_an_uninterrupted_one(scenario: str, tmp_path) -> None:
    parts, whole = fitted(tmp_path / "parts", 1, scenario), fitted(tmp_path / "whole", 2, scenario)
    assert main(["fit", "--resume", str(parts), "--trainer.max_epochs=2"]) == 0
    assert difference(parts, whole) == ""
    state = torch.load(last(parts), weights_only=True)["state_dict"]
    assert int(state["iteration"]) == 4


def test_what_cannot_go_on_is_refused(refused, tmp_path, capsys) -> None:
    run = fitted(tmp_path, 1)
    resume = ["fit", "--resume", str(run)]
    for option in ("--model.people go_to_goal", "--model.robot jackal", "--seed_everything 1"):
        assert f"{option}: the run '{run}' goes on with " in refused(*resume, *option.split())
    state, file = torch.load(last(run), weights_only=True), last(run)
    width = {"state_dict": state["state_dict"] | {"mean.log_std": torch.zeros(3)}}
    for damage in (width, {"loops": None}, {"optimizer_states": [{}]}, {"pedzoo": 3}, None):
        torch.save(state | damage, file) if damage else file.write_bytes(file.read_bytes()[:5000])
        assert main([*resume, "--trainer.max_epochs=3", "--model.lr=0.0005"]) == 2
        out, said = capsys.readouterr()
        assert "checkpoint" in said and said.count("\n") == 1
        noted = "note: goes on with --model.lr 0.0005, it was 0.001\n" in out
        assert noted or damage in ({"pedzoo": 3}, None)
    torch.save(state, file)
    for command in ("forecast", "fit --weights"):
        assert f"'{file}' moves robots" in refused(*command.split(), str(file))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scenarios": []}, "at least one"),
        ({"envs": 0}, "--model.envs 0"),
        ({"envs": 1, "steps": 2}, "--model.minibatches 16: there are 2"),
        ({"std": 0.0}, "--model.std 0.0"),
        ({"gamma": 1.5}, "gamma 1.5"),
        ({"people": "social_force"}, "--model.people social_force: no use for people with crowdnav"),
        ({"people": "orcaa", "scenarios": ["crowdnav", "door"]}, "did you mean 'orca'"),
        ({"lr": -1e-3}, "--model.lr -0.001: expected at least 0"),
        ({"clip": 0.0}, "--model.clip 0.0: expected above 0"),  # no gradient would be left
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        given: dict[str, Any] = {"scenarios": ["crowdnav"]} | options
        RobotPPO(Attention(width=16), **given)


def test_shipped_robots_load_by_name_and_are_no_models_of_people(capsys) -> None:
    names = robots()
    assert names and set(names) <= set(list_robot_policies()) and not set(names) & set(pedzoo.list_models())
    for name in names:
        policy = cast("Attention", load_robot_policy(name))
        assert not policy.training and policy.action(scene()).isfinite().all()
        with pytest.raises(UserError, match=f"'{name}' moves robots.*pedzoo evaluate {name} --suite robots"):
            pedzoo.load(name)
    assert main(["info", names[0]]) == 0
    assert "people" in capsys.readouterr().out
