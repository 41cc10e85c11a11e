"""Every scenario and every policy of the registries, a newcomer's too."""

from functools import cached_property
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace
from typing import Any, Literal

import pytest
import torch
from helpers.scenes import prepared
from helpers.walks import as_desired
from torchrl.envs import check_env_specs, step_mdp

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import move_to_scene, turn_to_scene
from pedzoo.core.randomness import Draws
from pedzoo.core.registry import POLICIES, SCENARIOS
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.eval.comparison import row
from pedzoo.eval.rollout import rollout
from pedzoo.maps.formats import read_plan, write_ros
from pedzoo.maps.plans import flat
from pedzoo.models.zoo.loading import baselines, list_models, load, save_weights
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.scenario import MIN_INITIAL_PATH

EVERY_SCENARIO = pytest.mark.parametrize("name", SCENARIOS.names())
EVERY_POLICY = pytest.mark.parametrize("name", [*POLICIES.names(), *baselines(), *list_models("*.eth_ucy")])
"""Of every family of weights those of all scenes: others differ in numbers alone."""


@EVERY_SCENARIO
def test_scenes_are_sound(name: str) -> None:
    env = make_env(prepared(name), num_envs=24, decision_dt=0.1)
    check_env_specs(env)
    env.set_seed(0)
    env.reset()
    state = env.state
    wall, _ = env.bank.closest_wall(state.position, state.map_id, state.pose)
    assert float(wall[state.mask].min()) > BODY_RADIUS - 0.011
    apart = torch.cdist(state.position, state.position) + 9 * torch.eye(env.prepared.people)
    apart = torch.where(state.mask.unsqueeze(1) & state.mask.unsqueeze(2), apart, torch.inf)
    assert float(apart.min()) > 2 * BODY_RADIUS
    assert state.remaining_path[state.mask].isfinite().all()
    assert (state.goal_id[state.mask] >= 0).all()
    assert float(state.pref_speed.max()) <= env.prepared.fastest + 1e-6
    assert state.mask.any(1).all()


@EVERY_SCENARIO
def test_scenarios_stay_as_they_were_made(name: str) -> None:
    """Whatever is prepared and laid out of them; only what follows from their settings is kept in them."""
    scenario, draws = make_scenario(name), Draws.for_episodes(0, torch.arange(4))
    before = dict(vars(scenario))
    first = scenario.prepare(0.25)
    begun = first.layout(draws)
    assert scenario.prepare(0.3).planner.clearance == 0.3
    cached = {key for key in vars(scenario) if isinstance(getattr(type(scenario), key, 0), cached_property)}
    assert vars(scenario).keys() - cached == before.keys()
    assert all(vars(scenario)[key] is value for key, value in before.items())
    assert first.planner.clearance == 0.25
    for mine, again in zip(begun[:5], first.layout(draws)[:5], strict=True):
        assert isinstance(mine, torch.Tensor) and torch.equal(mine, again)


@EVERY_SCENARIO
def test_a_scene_depends_on_seed_and_number_alone(name: str) -> None:
    """The same alone and among others, at first and a few decisions later; other seeds differ."""
    scene = prepared(name)
    whole, alone = (make_env(scene, n, seed=3, first_episode=first) for n, first in ((9, 0), (1, 5)))
    seen = (as_desired(env, 5)[0] for env in (whole, alone))
    for step, (every, one) in enumerate(zip(*seen, strict=True)):
        for key in ("history", "goal", "desired_velocity", "pref_speed", "group", "controlled"):
            theirs, mine = every["agents", key][5], one["agents", key][0]
            torch.testing.assert_close(mine, theirs, atol=1e-4 if step else 0, rtol=0, msg=key)
        assert torch.equal(one["map_id"][0], every["map_id"][5])
    if scene.script is None:
        first, other = (make_env(scene, 9, seed=seed).reset()["agents", "history"] for seed in (3, 4))
        assert float((first - other).abs().amax((1, 2, 3)).min()) > 0.01
        assert float((first[1:] - first[:-1]).abs().amax((1, 2, 3)).min()) > 0.01


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("door:away=0.5", r"away 0\.5: expected a number or \[least,most\], from 1"),
        ("door:away=[2,3,4]", r"away=\[2,3,4\]: expected float"),
        ("door:sync=-1", r"sync -1\.0: expected at least 0 s"),
        ("door:sync=0.4,from_right=0", r"sync 0\.4: expected at least 0 s, and people from both sides"),
        ("door:from_right=3", "from_right 3 of 2 people: expected 0 to 2"),
        ("door:abreast=4", "abreast 4: expected 1 to 3"),
        (
            "door:width=0.83",
            r"width 0\.83 is no multiple of the resolution 0\.05: the nearest are 0\.8 and 0\.85",
        ),
        ("door:people=0", "people 0: expected 1 to 10,000"),
        ("door:people=100000000", "people 100000000: expected 1 to 10,000"),
        ("door:speed=.nan", "speed nan, speed_std 0.2: expected at least 0.3 and 0"),
        ("door:speed_ratio=0", r"speed_ratio 0\.0"),
        ("standing:people=1", "standing: people 1: expected at least 2"),
        ("standing:at=-1.8", r"at -1\.8, away 2\.5: expected to stand at least 1 m nearer to the wall"),
        ("standing:seconds=0", r"standing: seconds 0\.0: expected a number or \[least,most\], from 0\.1"),
        ("hallway:width=[2,1.83]", r"width 1\.83 is no multiple of the resolution 0\.05: .* 1\.8 and 1\.85"),
        ("hallway:width=[]", r"hallway: width \[\]: expected a number, or a list of some"),
        ("hallway:width=[2,2]", r"hallway: width \[2\.0, 2\.0\]: 2 is there twice"),
        ("hallway:width=[2,wide]", r"hallway:width=\[2,wide\]: expected float \| Sequence\[float\]"),
        ("hallway:aside=-1", r"aside -1\.0, delay 1\.0: expected at least 0 m"),
        ("hallway:delay=60", r"delay 60\.0: expected at least 0 m, and 0 to 10 s"),
        ("hallway:width=-1", r"hallway: width -1\.0.* expected above 0"),
        ("hallway:people=4,against=4", r"against 4 of 4 people: expected 1 to 3"),
        ("hallway:width=[2,3],offset=0.8", r"offset 0\.8 in a corridor of 2\.0 m: expected at most 0\.70 m"),
        ("hallway:jitter=0.5", r"jitter 0\.5: expected 0 to 0\.15 m"),
        ("overtaking:speed_ratio=1", r"speed_ratio 1\.0: expected at least 1\.2"),
        ("intersection:arms=5", r"arms 5: expected 2 to 4"),
        ("intersection:turn=2", r"turn 2\.0: expected a share"),
        ("room_exit:entering=4", r"entering 4 of 4 people: expected 0 to 3"),
        ("parallel:gap=[1,0.5]", r"gap 0\.5: expected at least 0\.8 m"),
        ("circle:radius=[4,1]", r"radius 1\.0 for 4 people: expected at least 2\.00 m"),
        (
            "blind_corner:people=400",
            r"people 400: expected 2 to 300, as more need a floor plan .*; goals:people=N",
        ),
        ("perpendicular:width=2", "known: .*people"),
        ("waiting:waiting=36,people=40", "waiting 36 of 40 people: expected 0 to 35 who wait"),
        ("waiting:waiting=4,people=4", "waiting 4 of 4 people: .* and 1 to 18 others"),
        ("queue:people=3,coming=3", "coming 3 of 3 people: expected 0 to 2"),
        ("groups:size=[1,3]", r"size \(?\[?1, 3\)?\]?: expected \[least,most\], from 2 to 4"),
        ("two_way:people=1", "people 1: expected at least 2"),
        ("two_way:density=3", r"density 3\.0: expected people per square metre, up to 2"),
        ("two_way:width=0.4", r"0\.40 m by .*: expected at least 0\.5 m"),
    ],
)
def test_settings_that_give_no_scene_are_refused(spec: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_scenario(spec)


def test_the_scenario_of_contributing_works(tmp_path) -> None:
    page = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text()
    code = page.partition("class `MyScenario(Scenario)`")[2].partition("```python\n")[2].partition("```")[0]
    (tmp_path / "my_scenario.py").write_text(code)
    walked, _ = rollout("orca", f"{tmp_path / 'my_scenario.py'}:MyScenario:speed=1.2", "compiled", 3)
    assert (walked.reached[:, :, -1] == 1).all() and walked.reached.shape[:2] == (3, 2)


def test_a_scenario_that_returns_nothing_prepared(tmp_path) -> None:
    code = """
        from pedzoo.sim.scenarios.door import Door

        class Mine(Door):
            def prepare(self, clearance, planner):
                self.kept = super().prepare(clearance, planner)
    """
    (tmp_path / "mine.py").write_text(dedent(code))
    with pytest.raises(UserError, match=r"Mine.prepare returned None: expected .* super\(\).prepare"):
        make_env(f"{tmp_path / 'mine.py'}:Mine")


@EVERY_SCENARIO
def test_no_person_starts_on_a_goal(name: str) -> None:
    """Over 300 scenes, but for people who wait. Recorded people may: those who stay are not controlled."""
    if prepared(name).script is None:
        env = make_env(prepared(name), num_envs=300, seed=1)
        env.reset()
        walks = env.state.mask & ~env.state.holds
        assert float(env.state.remaining_path[walks].min()) >= MIN_INITIAL_PATH > 2 * GOAL_RADIUS


@pytest.mark.parametrize("warm_start", ["orca", "static"])
@pytest.mark.parametrize("scenario", ["goals:map=apartment.0,people=5,pool=8", "goals:people=3,pool=2"])
def test_goals_at_the_start_make_way_for_others(scenario: str, warm_start: Literal["orca", "static"]) -> None:
    """In some of 300 scenes the warm start ends near the first goal; each is the same alone."""
    env = make_env(scenario, num_envs=300, seed=2, warm_start=warm_start)
    env.reset()
    state = env.state
    assert float(state.remaining_path.min()) >= MIN_INITIAL_PATH
    assert bool((state.goal_index > 0).any()) == (warm_start == "orca")
    assert (state.reached == 0).all()
    for episode in (0, *state.goal_index.any(1).nonzero()[:3, 0].tolist()):
        alone = make_env(env.prepared, 1, seed=2, first_episode=episode, warm_start=warm_start)
        alone.reset()
        for key in ("goal_id", "goal_index", "goal_point", "remaining_path"):
            assert torch.equal(getattr(alone.state, key)[0], getattr(state, key)[episode])


def test_a_scenario_without_other_goals_keeps_its_first_ones(tmp_path) -> None:
    """A person who starts on the only goal there is arrives at once, and the episode begins all the same."""
    (tmp_path / "mine.py").write_text(
        "import torch\nfrom pedzoo.sim.scenarios.goals import Goals\n\n\nclass One(Goals):\n"
        "    def next_goal(self, prepared, draws, agent, number, last):\n"
        "        return torch.full_like(last, -1)\n"
    )
    env = make_env(f"{tmp_path}/mine.py:One:people=3,pool=4", num_envs=200)
    env.reset()
    assert (env.state.goal_id >= 0).all() and float(env.state.remaining_path.min()) < MIN_INITIAL_PATH


@EVERY_SCENARIO
def test_goals_can_be_reached_in_time(name: str) -> None:
    result, env = rollout("go_to_goal", prepared(name), "compiled", 16)
    if env.prepared.script is None:
        assert row("go_to_goal", result)["metrics"]["success"] > 0.95
    else:  # people come and go
        arrived = result.person[result.controlled & (result.reached > 0)].unique()
        assert len(arrived) > 0.95 * len(result.person[result.controlled].unique())


@EVERY_POLICY
def test_policies_walk(name: str, request) -> None:
    if "sgan_goal_map" in name:
        request.getfixturevalue("alexnet")
    policy = load_policy(name)
    env = make_env("goals:people=[2,4],pool=6", num_envs=3, decision_dt=policy.decision_dt)
    now: Any = env.reset()
    with torch.no_grad():
        action = policy(now)["agents", "action"]
        assert action.shape == (3, 4, 2)
        assert action[now["agents", "mask"]].isfinite().all()
        # who is not there has no say
        absent = ~now["agents", "mask"]
        assert absent.any()
        changed = now.clone()
        for key in ("history", "goal", "velocity", "desired_velocity"):
            changed["agents", key][absent] = 3.0
        again = policy(changed)["agents", "action"]
    assert torch.allclose(again[~absent], action[~absent], atol=1e-5)


def test_policies_of_ones_own(tmp_path) -> None:
    (tmp_path / "mine.py").write_text(
        "from pedzoo.models.architectures.constant_velocity import ConstantVelocity\n"
        "from pedzoo.policies.rule_based.go_to_goal import GoToGoal\n\n\n"
        "class Model(ConstantVelocity):\n    pass\n\n\n"
        "class Mine(GoToGoal):\n    def __init__(self, dt: float = 0.2):\n        super().__init__(dt)\n"
    )
    model = load_policy(f"{tmp_path}/mine.py:Model:noise=step")
    assert isinstance(model, Walker) and model.noise == "step"
    assert load_policy(f"{tmp_path}/mine.py:Mine").decision_dt == 0.2
    for name in ("Model", "Mine:dt=0.4"):
        assert rollout(f"{tmp_path}/mine.py:{name}", "door", "compiled", 1)[0].trace.isfinite().all()
    weights = tmp_path / "weights.safetensors"
    save_weights(load("sgan_goal.zara1"), weights)
    named, _ = rollout("sgan_goal.zara1", "door", "compiled", 1)
    assert torch.equal(rollout(str(weights), "door", "compiled", 1)[0].trace, named.trace)


@pytest.mark.parametrize("name", POLICIES.names())
def test_a_turned_and_mirrored_scene_is_walked_alike(name: str) -> None:
    policy = load_policy(f"{name}:jitter=0" if name == "orca" else name)
    env = make_env("door:people=4", num_envs=3, decision_dt=policy.decision_dt)
    now: Any = env.reset()
    pose = torch.tensor([[1.1, -1.0, 4.0, -2.0]]).repeat(3, 1)
    turned = now.clone()
    turned["scene_pose"] = pose
    for key in ("history", "goal"):
        turned["agents", key] = move_to_scene(now["agents", key], pose)
    for key in ("velocity", "desired_velocity"):
        turned["agents", key] = turn_to_scene(now["agents", key], pose)
    expected = turn_to_scene(policy(now)["agents", "action"], pose)
    assert torch.allclose(policy(turned)["agents", "action"], expected, atol=1e-3)


def test_goals_are_new_ones_some_way_off() -> None:
    result, _ = rollout("go_to_goal", "goals:people=3,pool=10,goals=3", "compiled", 8)
    moved = result.goal.diff(dim=2).norm(dim=-1)
    assert float(moved[moved > 0].min()) > 0.5
    assert int((result.reached.diff(dim=2) > 1).sum()) == 0  # reached one after the other


def test_a_scenario_on_several_floor_plans(tmp_path) -> None:
    for name in ("a", "b"):
        write_ros(flat(), tmp_path / f"{name}.yaml")
    grid = flat()
    assert grid.map_id == read_plan(tmp_path / "a.yaml").map_id
    with pytest.raises(UserError, match="no map"):
        make_env(f"goals:map={tmp_path}/c.yaml")
    env = make_env(f"goals:map=[{tmp_path}/a.yaml,{tmp_path}/b.yaml],pool=4,people=2", num_envs=2)
    assert env.reset()["map_id"].unique().tolist() == [grid.map_id]  # the same content is the same map


def test_processes_of_a_collector_walk_other_scenes_unless_told(monkeypatch) -> None:
    prepared = make_scenario("door:people=2").prepare(0.25)

    def starts(number: tuple[int, ...], **settings: Any) -> list[float]:
        with monkeypatch.context() as patch:
            patch.setattr("multiprocessing.current_process", lambda: SimpleNamespace(_identity=number))
            env = make_env(prepared, **settings)
        env.reset()
        return env.state.past.flatten().tolist()

    workers = [(), (1,), (2,), (1, 1), (1, 2), (2, 1)]
    assert starts(()) == starts((1,), seed=0) and starts((2,)) == starts((), seed=2)
    assert len({tuple(starts(worker)) for worker in workers}) == len(workers)
    assert len({tuple(starts(worker, seed=0)) for worker in workers}) == 1


# Gradients through 25 decisions of its environment


STEPS = 25

DISCOUNT = 0.95
"""Per decision: the plain sum of the way that was made is the same whenever a person arrives."""

WALK, WANDER, PRESS, STAY = range(4)
"""What people do in each of four scenes: go to their goals; go there and about; all press to the right, where
walls are; not move at all."""


@pytest.mark.parametrize("name", SCENARIOS.names())
def test_gradients_are_finite_and_reach_all_people(name: str) -> None:
    """Of rewards and of ways, by every action, and by the gain of what people see of others."""
    env = make_env(prepared(name), num_envs=4)
    now: Any = env.reset()
    given = torch.zeros(STEPS, *now["agents", "mask"].shape, 2, requires_grad=True)
    gain = torch.tensor(0.1, requires_grad=True)
    reward, way, who = torch.zeros(()), torch.zeros(()), []
    for step in range(STEPS):
        agents = now["agents"]
        wanted = agents["desired_velocity"].clone()
        wanted[WANDER] += torch.randn(wanted[WANDER].shape)
        wanted[PRESS] = torch.tensor([2.0, 0.1])
        wanted[STAY] = 0.0
        here, there = agents["history"][:, :, -1], agents["mask"].unsqueeze(-1)
        others = (here * there).sum(1, keepdim=True) / there.sum(1, keepdim=True).clamp_min(1) - here
        seen = agents["velocity"] + agents["goal"] - here + others
        agents["action"] = wanted + gain * seen.tanh() + given[step]
        who.append(agents["controlled"])
        now = step_mdp(env.step(now), exclude_reward=False)
        reward = reward + DISCOUNT**step * now["agents", "reward"].sum()
        way = way + now["agents", "info", "trace"].square()[now["agents", "mask"]].sum()
    moved = torch.stack(who)
    for value in (reward, way):
        by_action, by_gain = torch.autograd.grad(value, (given, gain), retain_graph=True)
        assert by_action.isfinite().all() and by_gain.isfinite() and by_gain != 0
        assert by_action[~moved].eq(0).all()
        felt = by_action.ne(0).any(-1)
        for scene in (WALK, WANDER, STAY):  # of a last decision nothing is seen after arriving
            assert float(felt[:, scene][moved[:, scene]].float().mean()) > 0.75
