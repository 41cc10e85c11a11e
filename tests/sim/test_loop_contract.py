"""The loop contract of the design, clause by clause."""

import math
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS, TOP_SPEED_RATIO
from pedzoo.eval.rollout import rollout
from pedzoo.policies.load import load_policy
from pedzoo.policies.rule_based.go_to_goal import GoToGoal
from pedzoo.sim import kernel
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, prepare_scenario
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.scenario import Layout, PreparedScenario, Rules
from pedzoo.sim.scenarios.door import BEFORE, Door
from pedzoo.sim.state import Decision, State

SCENES = ("door", "goals:people=[2,4],goals=2,pool=6")


def walked(env: PedestrianEnv, steps: int, policy: Any = None) -> list[Any]:
    """Return the results of some steps, without resets in between."""
    policy = policy or GoToGoal()
    now, results = env.reset(), []
    for _ in range(steps):
        results.append(env.step(policy(now)))
        now = step_mdp(results[-1])
    return results


def positions(results: list[Any]) -> Tensor:
    """Return every person's trace (B, A, T, 2)."""
    return torch.cat([result["next", "agents", "info", "trace"] for result in results], dim=2)


# 1. Time


@pytest.mark.parametrize("dt", [0.1, 0.2, 0.4])
def test_history_has_a_step_of_0_4_s_for_every_decision_dt(dt: float) -> None:
    results = walked(make_env("door", num_envs=2, decision_dt=dt), round(1.6 / dt))
    expected = positions(results)[:, :, [3, 7, 11, 15]]  # 0.4, 0.8, 1.2, 1.6 s
    last = results[-1]["next"]
    assert torch.equal(last["agents", "history"][:, :, -4:], expected)
    assert last["agents", "valid"].all() and torch.allclose(last["time"], torch.tensor(1.6))


@pytest.mark.parametrize(
    ("scenario", "values", "message"),
    [
        ("door", (0.25, 0.0, 0.04, 3.2, math.nan), r"expected a multiple of 0\.1 s up to 2\.8 s"),
        ("replay:share=0.1", (0.3, 0.5, 0.8), r"every 0\.4 s, so a decision takes 0\.1, 0\.2 or 0\.4 s"),
    ],
)
def test_decisions_take_whole_tenths_of_a_second(scenario: str, values: tuple, message: str) -> None:
    made = prepare_scenario(scenario)
    for dt in values:
        with pytest.raises(UserError, match=message):
            make_env(made, decision_dt=dt)


def test_a_learned_model_is_refused_another_step_than_its_own() -> None:
    with pytest.raises(UserError, match=r"decides every 0\.4 s, not every 0\.1 s"):
        rollout("sgan_goal.zara1", "door", "compiled", 1, decision_dt=0.1)
    with pytest.raises(UserError, match=r"make_env\(\.\.\., decision_dt=0\.4\)"):
        make_env("door", decision_dt=0.1).rollout(2, load_policy("sgan_goal.zara1"))


# 2. Speed


def test_preferred_speeds_and_the_same_draw_for_every_policy() -> None:
    speed = make_env("goals:people=5,pool=2", 400, warm_start="static").reset()["agents", "pref_speed"]
    assert float(speed.mean()) == pytest.approx(1.3, abs=0.02)
    assert float(speed.std()) == pytest.approx(0.2, abs=0.02)
    one, other = (rollout(policy, "door", "compiled", 3)[0] for policy in ("go_to_goal", "orca:radius=0.3"))
    assert torch.equal(one.pref_speed, other.pref_speed) and torch.equal(one.past, other.past)


def test_no_person_is_faster_than_their_top_speed() -> None:
    env = make_env("door", num_envs=3)
    now = env.reset()
    now["agents", "action"] = torch.full((3, 2, 2), 50.0)
    after = env.step(now)["next"]
    top = TOP_SPEED_RATIO * now["agents", "pref_speed"]
    trace = torch.cat((now["agents", "history"][:, :, -1:], after["agents", "info", "trace"]), 2)
    speed = trace.diff(dim=2).norm(dim=-1) / 0.1
    assert (speed <= top + 1e-3).all()
    assert torch.allclose(speed[..., 1:], top.expand_as(speed[..., 1:]), atol=1e-3)


# 3. Radii


def test_bodies_touch_at_twice_their_radius_and_walls_at_one() -> None:
    env = make_env("door:jitter=0,offset=0,speed_std=0", physics="compiled", decision_dt=0.1)
    touched = []
    for result in walked(env, 80, GoToGoal(0.1)):
        info = result["next", "agents", "info"]
        apart = info["trace"][0, 0, -1] - info["trace"][0, 1, -1]
        touched.append((float(apart.norm()), bool(info["agent_contact"].any())))
    assert any(hit for _, hit in touched)
    for apart, hit in touched:
        assert hit or apart >= 2 * BODY_RADIUS
        # sub-steps in between may be closer than the trace point, by what two people walk in 0.1 s
        assert not hit or apart < 2 * BODY_RADIUS + 2 * 0.1 * 1.3


# 4. Goal: the carrot itself is tested with the planner


def test_the_short_term_goal_leads_the_desired_velocity() -> None:
    now = make_env("door", num_envs=8).reset()
    ahead = now["agents", "goal"] - now["agents", "history"][:, :, -1]
    velocity = now["agents", "desired_velocity"]
    assert torch.allclose(velocity.norm(dim=-1), now["agents", "pref_speed"][..., 0], atol=1e-4)
    assert (torch.nn.functional.cosine_similarity(ahead, velocity, dim=-1) > 0.7).all()
    assert (ahead.norm(dim=-1) <= 3.2 * now["agents", "pref_speed"][..., 0] + 1e-4).all()


# 5. Success


def test_the_goal_is_noticed_between_two_decisions() -> None:
    """At 3 m/s a person passes through the goal's whole disk within one decision of 0.8 s."""
    env = make_env("door:people=1,jitter=0,offset=0,speed=3,speed_std=0", decision_dt=0.8)
    results = walked(env, 6)
    reached = torch.cat([result["next", "agents", "info", "reached"] for result in results], dim=2)[0, 0]
    trace = positions(results)[0, 0]
    goal = torch.tensor([3.0, 0.0])
    decisions = (trace[7::8] - goal).norm(dim=-1)
    assert (decisions > GOAL_RADIUS).all()
    assert int(reached[-1]) == 1


def test_time_limits_and_how_scenes_end() -> None:
    """Of people who stand."""
    env = make_env("door", num_envs=2)
    now: Any = env.reset()
    way, speed, until = env.state.remaining_path, env.state.pref_speed, env.state.deadline
    assert torch.allclose(until, torch.clamp(4 * way / speed, min=20.0))
    done = []
    for _ in range(math.ceil(float(until.max()) / 0.4) + 1):
        now["agents", "action"] = torch.zeros_like(now["agents", "velocity"])
        now = step_mdp(result := env.step(now))
        done.append(bool(result["next", "done"][0]))
    last = result["next"]
    assert last["truncated"].all() and not last["terminated"].any()
    assert last["agents", "info", "overdue"].all()
    assert 0.4 * (done.index(True) + 1) > float(until[0].max())


@pytest.mark.parametrize("physics", ["compiled", "torch"])
def test_a_deadline_of_ones_own_is_that_of_every_goal(physics: str) -> None:
    env = make_env("goals:people=2,goals=2", physics=physics, deadline=200.0)
    now, policy = env.reset(), GoToGoal()
    assert (env.state.deadline == 200).all()
    while not env.state.reached.any():
        now = step_mdp(env.step(policy(now)))
    begun = torch.where(env.state.reached > 0, env.state.clock.unsqueeze(1), 0.0)
    assert torch.allclose(env.state.deadline, begun + 200) and begun.any()


@pytest.mark.parametrize(("deadline", "overdue"), [(0.3, False), (0.15, True)])
def test_deadlines_lie_between_decisions_too(deadline: float, overdue: bool) -> None:
    """The goal is reached 0.2 s into a decision of 0.4 s."""
    env = make_env("door:people=1,jitter=0,offset=0,speed_std=0", warm_start="static")
    now: Any = env.reset()
    goal = env.state.goal_point
    past = (goal - torch.tensor([GOAL_RADIUS + 0.2 * 1.3 - 0.02, 0.0])).unsqueeze(2).expand(1, 1, 29, 2)
    walks = torch.tensor([[[1.3, 0.0]]])
    begun = env.state._replace(past=past, deadline=torch.tensor([[deadline]]), velocity=walks)
    assert env._scenes is not None
    env._scenes = env._scenes._replace(state=begun)
    now["agents", "action"] = torch.tensor([[[1.3, 0.0]]])
    after = env.step(now)["next"]
    assert after["agents", "info", "reached"][0, 0].tolist() == [0, 1, 1, 1]
    assert bool(after["agents", "info", "overdue"]) is overdue


def test_gradients_of_a_return_over_two_decisions() -> None:
    """Against finite differences: what the first decision does to the second one's reward counts, too."""
    env = make_env("goals:people=4,pool=8", 3, seed=1)
    env.reset()
    begun = env.state

    def total(action: Tensor) -> Tensor:
        state, guidance, first = kernel.step(begun, action, env.physics, env.rules)
        _, _, second = kernel.step(
            state, action + 0.1 * guidance.desired_velocity.detach(), env.physics, env.rules
        )
        return first.reward.sum() + second.reward.sum()

    generator = torch.Generator().manual_seed(0)
    action = (0.8 * torch.randn(3, 4, 2, generator=generator)).requires_grad_()
    (gradient,) = torch.autograd.grad(total(action), action)
    step, result = 3e-3, []
    for index in range(action.numel()):
        shift = torch.zeros(action.numel()).index_fill(0, torch.tensor([index]), step).view_as(action)
        result.append((total(action.detach() + shift) - total(action.detach() - shift)) / (2 * step))
    error = (torch.stack(result).view_as(action) - gradient).abs()
    assert (error < 0.05).float().mean() > 0.85  # a waypoint that changes in between has no gradient
    assert gradient.abs().amax() > 0.3


def test_rewards_are_finite_wherever_people_get_to(shared: Path) -> None:
    env = make_env(f"goals:map={shared}/maps/aws_small_house.yaml,people=5,pool=6", num_envs=32)
    now: Any = env.reset()
    angle = 6.3 * torch.rand(32, 5)
    for _ in range(60):
        angle = angle + 0.3 * torch.randn(32, 5)
        now["agents", "action"] = 1.8 * torch.stack((angle.cos(), angle.sin()), dim=-1)
        result = env.step(now)
        assert result["next", "agents", "reward"].isfinite().all()
        now = step_mdp(result)


def test_who_is_finished_draws_goals_until_all_are() -> None:
    result, _ = rollout("go_to_goal", "goals:people=3,goals=2,pool=8", "compiled", 6)
    most = (result.reached * result.present).amax(2)
    assert (most >= 2).all()  # every person has reached both
    assert (most > 2).any()  # and some went on
    assert (result.present.any(1) == result.present.all(1)).all()  # no person leaves before the end


# 6. Warm start


@pytest.mark.parametrize("scenario", ["door", "door:people=6,speed_std=0.3", "door:speed_ratio=1.4"])
def test_all_people_are_2_5_m_from_the_door_after_seven_steps(scenario: str) -> None:
    now = make_env(scenario, num_envs=16).reset()
    history = now["agents", "history"]
    assert float(history[:, :, -1, 0].abs().min()) >= BEFORE - 0.02
    assert (history.diff(dim=2).norm(dim=-1)[..., -1] > 0.1).all()
    assert not now["time"].any() and not now["agents", "info", "reached"].any()


def test_static_warm_start() -> None:
    history = make_env("goals:pool=2", num_envs=3, warm_start="static").reset()["agents", "history"]
    assert (history == history[:, :, :1]).all()


class Recorded(Door):
    """The door with people who come as they were recorded."""

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Add histories that walk towards the door."""
        layout = super().layout(prepared, draws)
        steps = torch.arange(8).view(1, 1, 8, 1)
        towards = -layout.start.sign() * torch.tensor([0.4, 0.0])
        return layout._replace(history=layout.start.unsqueeze(2) + steps * towards.unsqueeze(2))


def test_the_warm_start_leads_to_the_first_goal() -> None:
    """People who begin to walk keep their first goal, unless they reach it on these steps."""
    scenes = "goals:map=apartment.7,people=4,goals=2,pool=8"
    still, rolled = (make_env(scenes, num_envs=50, seed=5, warm_start=kind) for kind in ("static", "orca"))
    for env in (still, rolled):
        env.reset()
    same = rolled.state.goal_id == still.state.goal_id
    assert same.float().mean() > 0.9
    assert torch.equal(rolled.state.goal_index > 0, ~same)
    came = rolled.state.past[~same][:, -1] - still.state.goal_point[~same]
    assert (came.norm(dim=-1) < 2).all()


class Counting(Compiled):
    """Counts the decisions of 0.1 s and of 0.4 s that it is asked for."""

    def decide(self, state: State, commands: Tensor, rules: Rules) -> Decision | None:
        asked.append(rules.ticks)
        return super().decide(state, commands, rules)


asked: list[int] = []


def test_the_warm_start_of_igibson_is_in_physics_at_10_hz() -> None:
    prepared = prepare_scenario("circle:people=4")
    cases: list[tuple[Any, list[int]]] = [("igibson", [1] * 28), ("orca", []), ("static", [])]
    for kind, expected in cases:
        asked.clear()
        PedestrianEnv(prepared, Counting(prepared.bank), warm_start=kind).reset()
        assert asked == expected


@pytest.mark.parametrize("physics", ["compiled", "torch", "bullet"])
def test_the_warm_start_of_igibson_keeps_people_a_metre_apart(physics: str) -> None:
    """As its ORCA does. Nobody is faster than they like to be, and alone they walk just as they like."""
    if physics == "bullet":
        pytest.importorskip("pybullet")

    def starts(scenario: str, kind: Any) -> tuple[Tensor, Tensor]:
        env = make_env(scenario, 6, physics, warm_start=kind, seed=2)
        env.reset()
        return env.state.past, env.state.pref_speed

    least = {}
    for kind in ("igibson", "orca"):
        past, speed = starts("goals:map=flat,people=4,pool=8", kind)
        apart = (past.unsqueeze(2) - past.unsqueeze(1)).norm(dim=-1)
        least[kind] = float(apart[:, *torch.triu_indices(4, 4, 1)].min())
    assert least["igibson"] > 0.99 > least["orca"]
    past, speed = starts("door:people=1", "igibson")
    steps = past.diff(dim=2).norm(dim=-1)
    torch.testing.assert_close(steps, (0.1 * speed).unsqueeze(2).expand_as(steps), atol=2e-3, rtol=0)


def test_recorded_warm_start() -> None:
    now = make_env(Recorded(), num_envs=2, warm_start="recorded").reset()
    steps = now["agents", "history"].diff(dim=2)
    assert torch.allclose(steps.abs(), torch.tensor([0.4, 0.0]).expand_as(steps), atol=1e-5)
    assert torch.allclose(now["agents", "velocity"].abs(), torch.tensor([1.0, 0.0]), atol=1e-4)


# 7. Seeds


@pytest.mark.parametrize("scenario", SCENES)
def test_scene_i_of_a_seed_is_the_same_in_every_batch(scenario: str) -> None:
    """To the last bit, and so is all that comes of it."""
    made, policy = prepare_scenario(scenario), load_policy("orca:dt=0.4")
    whole = walked(make_env(made, num_envs=24, seed=3), 12, policy)
    for i in (0, 5, 23):
        alone = walked(make_env(made, num_envs=1, seed=3, first_episode=i), 12, policy)
        for one, many in zip(alone, whole, strict=True):
            assert torch.equal(one["scene_key"][0], many["scene_key"][i])
            for key in ("history", "goal", "desired_velocity", "pref_speed", "mask", ("info", "reached")):
                assert torch.equal(one["next", "agents"][key][0], many["next", "agents"][key][i]), key


def test_seeding_again_starts_again() -> None:
    env = make_env("goals:pool=6", num_envs=2)
    first, second = env.reset(), env.reset()
    assert not torch.equal(first["scene_key"], second["scene_key"])
    env.set_seed(0)
    assert torch.equal(env.reset()["agents", "history"], first["agents", "history"])


def test_environments_share_a_scenario() -> None:
    prepared = Door().prepare(0.25)
    first, second = (make_env(prepared, num_envs=2) for _ in range(2))
    assert first.prepared is second.prepared is prepared
    assert torch.equal(first.reset()["scene_key"], second.reset()["scene_key"])
    wider = make_env(prepared, clearance=0.3).prepared
    assert wider.scenario is prepared.scenario and wider.planner.clearance == 0.3
    assert prepared.planner.clearance == 0.25


def test_environments_go_to_workers_and_are_the_same_there() -> None:
    """Which another process shows: no draw depends on the order of a set, or on a hash."""
    env = make_env("goals:pool=6", num_envs=2, seed=3, physics="bullet")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = pool.submit(PedestrianEnv.reset, env).result()["agents", "history"]
    assert torch.allclose(there, env.reset()["agents", "history"], atol=1e-5)


@pytest.mark.parametrize("scenario", ["door", "circle:people=4"])
def test_both_worlds_show_the_same_episode(scenario: str) -> None:
    """With walls and without any."""
    envs = [make_env(scenario, num_envs=2, physics=physics) for physics in ("compiled", "bullet")]
    results = [walked(env, 12) for env in envs]
    envs[1].physics.close()
    for one, other in zip(*results, strict=True):
        for key in ("trace", "agent_contact", "wall_contact", "reached"):
            assert torch.equal(one["next", "agents", "info", key], other["next", "agents", "info", key]), key


def test_noise_belongs_to_the_scene_not_to_the_batch() -> None:
    small, _ = rollout("sgan_goal.zara1", "door", "compiled", 2)
    large, _ = rollout("sgan_goal.zara1", "door", "compiled", 5)
    steps = min(small.trace.shape[2], 20)
    assert torch.allclose(small.trace[:, :, :steps], large.trace[:2, :, :steps], atol=1e-4)


# 8. Bodies: see test_dynamics.py and test_backends.py


# 9. Failure


class Breaks(GoToGoal):
    """Says a ``number`` that is none for one person at the third decision."""

    number = 0.0

    def forward(self, tensordict: Any) -> Any:
        super().forward(tensordict)
        if abs(float(tensordict["time"][0, 0]) - 0.8) < 1e-3:
            tensordict["agents", "action"] = tensordict["agents", "action"].clone()
            tensordict["agents", "action"][1, 0, 1] = self.number
        return tensordict


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_action_fails_its_scene_only(bad: float) -> None:
    fine, policy, env = walked(make_env("door", num_envs=3), 6), Breaks(), make_env("door", num_envs=3)
    policy.number, env.policy_name = bad, "mine"
    with pytest.warns(UserWarning, match="mine gave the action .* for agent 0 of scene 1"):
        hurt = walked(env, 6, policy)
    assert torch.equal(positions(fine)[[0, 2]], positions(hurt)[[0, 2]])
    later = hurt[5]["next"]
    assert bool(later["truncated"][1]) and not bool(later["terminated"][1])
    assert torch.equal(positions(hurt)[1, :, 8], positions(hurt)[1, :, -1])
    for key in ("failed", "truncated"):
        assert hurt[2]["next", key].flatten().tolist() == [False, True, False]
    assert torch.isfinite(positions(hurt)).all()


# 11. Auto-reset


def test_a_partial_reset_changes_only_the_scenes_that_are_reset() -> None:
    env = make_env("goals:people=2,pool=6", num_envs=3)
    results = walked(env, 3)
    before = env.state
    flags = torch.tensor([[False], [True], [False]])
    after = env.reset(results[-1]["next"].clone().set("_reset", flags))
    assert torch.equal(after["agents", "history"][[0, 2]], results[-1]["next", "agents", "history"][[0, 2]])
    assert torch.equal(env.state.clock, torch.tensor([1.2, 0.0, 1.2]))
    assert not torch.equal(env.state.key[1], before.key[1])
    # the scene that follows is the one a batch of three comes to next
    assert torch.equal(env.state.key[1:2], Draws.for_episodes(0, torch.tensor([4])).key)


def test_rows_begin_the_episodes_of_their_numbers_whole() -> None:
    settings: dict[str, Any] = {"scenario": "goals:map=apartment.7,people=2,goals=1", "num_envs": 6}
    env, other = make_env(**settings), make_env(**settings, first_episode=6)
    now, ended = env.reset(), torch.zeros(6, dtype=torch.bool)
    while not ended.any():
        before, now = env.step_and_maybe_reset(GoToGoal()(now))
        ended = before["next", "done"][:, 0]
    other.reset()
    for name, mine, theirs in zip(env.state._fields, env.state, other.state, strict=True):
        assert torch.equal(mine[ended], theirs[ended]), name


def test_step_and_maybe_reset_is_torchrls() -> None:
    """Key by key, through many ends of scenes, with keys that a policy has added."""
    mine, other = (make_env("circle:people=2,jitter=0.1", 3, "compiled", seed=2) for _ in range(2))
    now, then, ends = mine.reset(), other.reset(), 0
    for step in range(120):
        for scenes in (now, then):
            scenes["agents", "action"] = scenes["agents", "desired_velocity"]
            scenes["memory"] = torch.full((3, 1), float(step))
            scenes["agents", "note"] = torch.full((3, 2, 1), float(step))
        before, now = mine.step_and_maybe_reset(now)
        earlier, then = EnvBase.step_and_maybe_reset(other, then)
        ends += int(before["next", "done"].sum())
        for one, two in ((before, earlier), (now, then)):
            one, two = (part.exclude("maps", ("next", "maps")) for part in (one, two))
            assert set(one.keys(True)) == set(two.keys(True)) and bool((one == two).all()), step
    assert ends >= 6


def test_states_are_never_written_in_place() -> None:
    env = make_env("door", num_envs=2)
    results = walked(env, 4)
    for before, after in pairwise(results):
        assert torch.equal(before["next", "agents", "history"], after["agents", "history"])
        assert not torch.equal(after["agents", "history"], after["next", "agents", "history"])


# 12. Replay: see test_replay.py


# Bad input


@pytest.mark.parametrize(
    ("scenario", "settings", "message"),
    [
        ("goals:people=500", {}, "500 people do not fit on map 'flat'"),
        ("dor", {}, "did you mean 'door'"),
        ("goals:persons=3", {}, "known: .*people"),
        ("door", {"physics": "bulet"}, "did you mean 'bullet'"),
        ("door", {"warm_start": "statick"}, "did you mean 'static'"),
        ("door", {"warm_start": "recorded"}, "no recorded histories"),
        ("door:width=0.4", {}, r"no way from .* to the goal \(3\.0, -0\.6\) keeps 0\.25 m"),
        *(("door", {"deadline": given}, "seconds above 0") for given in (0.0, -1.0, math.inf, math.nan)),
        ("replay:fold=embedded", {"deadline": 5.0}, r"deadline 5\.0: people of recordings have the time"),
    ],
)
def test_what_cannot_be_says_what_can(scenario: str, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_env(scenario, **settings).reset()


def test_a_smaller_clearance_leads_through_narrow_doors() -> None:
    make_env("door:width=0.4", clearance=0.15).reset()


def test_a_different_number_of_people_per_scene() -> None:
    env = make_env("goals:people=[2,4],pool=2", num_envs=60, warm_start="static")
    counts = env.reset()["agents", "mask"].sum(1)
    assert sorted(counts.unique().tolist()) == [2, 3, 4]
