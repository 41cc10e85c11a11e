"""Robots among people for Gymnasium, PettingZoo and Stable-Baselines3. Needs the extra ``gym``."""

import importlib
import re
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers
from pettingzoo.test import parallel_api_test
from torchrl.envs.utils import check_env_specs

import pedzoo.sim.gym
from pedzoo.core.errors import UserError, install_command
from pedzoo.sim.gym import IDS
from pedzoo.sim.gym.parallel import parallel_env

CROSSING = "pedzoo/Crossing-v0"
QUICK = {"people": "go_to_goal", "time_limit": 1.0}
"""Settings with which episodes take 5 decisions at most."""

pytestmark = pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value")


def made(name: str, **settings: Any) -> Any:
    return gymnasium.make(name, **settings)


def vectors(name: str, **settings: Any) -> Any:
    return gymnasium.make_vec(name, **settings)


def same(first: dict[str, Any], second: dict[str, Any]) -> bool:
    assert first.keys() == second.keys()
    return all(np.allclose(first[name], second[name], atol=1e-3) for name in first)


def row(batch: dict[str, Any], scene: int) -> dict[str, Any]:
    return {name: value[scene] for name, value in batch.items() if not name.startswith(("_", "final"))}


@pytest.mark.parametrize("name", IDS)
def test_every_id_passes_the_checks_of_gymnasium_and_torchrl(name: str) -> None:
    env = made(name, render_mode="rgb_array").unwrapped
    check_env(env)
    picture = env.render()
    assert isinstance(picture, np.ndarray) and picture.shape == (480, 640, 3) and picture.std() > 0
    check_env_specs(env.batched.env)
    env.close()
    env.close()


def test_a_vector_environment_has_the_scenes_of_single_ones() -> None:
    """Over several episodes: observations, rewards, ends and infos, and the last ones before a reset."""
    scenes, chance, ends = 3, np.random.default_rng(0), 0
    many = vectors(CROSSING, num_envs=scenes, vectorization_mode="vector_entry_point", **QUICK)
    assert many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    singles = [made(CROSSING, first_episode=i, stride=scenes, **QUICK) for i in range(scenes)]
    (seen, infos), now = many.reset(seed=7), [single.reset(seed=7) for single in singles]
    for _ in range(12):
        for scene, (observation, info) in enumerate(now):
            assert same(observation, row(seen, scene)) and same(info, row(infos, scene))
        actions = chance.uniform(-1, 1, (scenes, 2)).astype(np.float32)
        (seen, rewards, *all_over, infos), now = many.step(actions), []
        for scene, single in enumerate(singles):
            observation, reward, *over, info = single.step(actions[scene])
            assert reward == pytest.approx(rewards[scene], abs=1e-3)
            assert over == [flags[scene] for flags in all_over]
            if any(over):
                ends += 1
                assert same(observation, infos["final_obs"][scene])
                assert same(info, row(infos["final_info"], scene))
                observation, info = single.reset()
            now.append((observation, info))
    assert ends >= 2 * scenes


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, "Disabled"])
def test_scenes_begin_anew_as_those_of_gymnasium_do(mode: AutoresetMode | str) -> None:
    """Of its own vector environment of single ones: step by step, with seeds of their own."""
    chance, seeds = np.random.default_rng(1), [7, np.int64(8), 2**40]
    own = vectors(CROSSING, num_envs=3, autoreset_mode=mode, **QUICK)
    assert own.metadata["autoreset_mode"] is AutoresetMode(mode)
    other = SyncVectorEnv([lambda: made(CROSSING, **QUICK)] * 3, autoreset_mode=mode)
    seen, infos = own.reset(seed=seeds)
    theirs, their_infos = other.reset(seed=[int(seed) for seed in seeds])
    over, ends = np.zeros(3, bool), 0
    for _ in range(14):
        assert same(seen, theirs)
        assert all(np.allclose(infos[key], value, atol=1e-3) for key, value in their_infos.items())
        if over.any() and own.autoreset_mode is AutoresetMode.DISABLED:
            with pytest.raises(UserError, match="are over: expected reset"):
                own.step(np.zeros((3, 2)))
            seen, infos = own.reset(options={"reset_mask": over.copy()})
            theirs, their_infos = other.reset(options={"reset_mask": over.copy()})
            assert same(seen, theirs) and infos["_SUCCESS"].tolist() == over.tolist()
        actions = chance.uniform(-1, 1, (3, 2)).astype(np.float32)
        (seen, *results, infos), (theirs, *expected, their_infos) = own.step(actions), other.step(actions)
        assert all(np.allclose(*pair, atol=1e-3) for pair in zip(results, expected, strict=True))
        over = results[1] | results[2]
        ends += int(over.sum())
    assert ends >= 3
    kept, mask = own.reset(seed=[1, None, 3])[0], np.array([False, False, True])
    for seeds, seed, scene in (([5, 6, 1], 1, 0), (3, 3, 2)):
        seen, _ = own.reset(seed=seeds, options={"reset_mask": mask})
        first = vectors(CROSSING, num_envs=3, **QUICK).reset(seed=seed)[0]
        assert all(same(row(seen, i), row(kept, i)) for i in (0, 1))
        assert same(row(seen, 2), row(first, scene))


def test_gymnasiums_vector_wrappers_take_it() -> None:
    plain = vectors(CROSSING, num_envs=2, autoreset_mode="NextStep", **QUICK)
    env = wrappers.RecordEpisodeStatistics(wrappers.FlattenObservation(plain))
    env = wrappers.NormalizeReward(wrappers.NormalizeObservation(wrappers.ClipAction(env)))
    env.reset(seed=0)
    episodes = []
    for _ in range(14):
        *_, infos = env.step(env.action_space.sample())
        episodes += infos["episode"]["l"][infos["_episode"]].tolist() if "episode" in infos else []
    assert len(episodes) >= 4 and 5 in episodes and max(episodes) == 5


def test_an_id_needs_no_import_of_its_package(monkeypatch) -> None:
    """Gymnasium has read no entry points since 1.0: the id names the module that knows it."""
    monkeypatch.delitem(gymnasium.registry, CROSSING)
    monkeypatch.delitem(sys.modules, "pedzoo.sim.gym")
    monkeypatch.setattr(pedzoo.sim, "gym", pedzoo.sim.gym)  # which comes back at the end
    assert made(f"pedzoo.sim.gym:{CROSSING}", **QUICK).reset(seed=0)[0]["mask"].any()


def test_a_seed_is_the_same_scene_and_none_is_one_by_chance() -> None:
    env, given = made(CROSSING, **QUICK), made(CROSSING, seed=3, **QUICK)
    first, second, other = env.reset(seed=3)[0], env.reset()[0], env.reset(seed=4)[0]
    assert same(first, env.reset(seed=3)[0]) and same(second, env.reset()[0])
    assert same(first, given.reset()[0])
    by_chance = made(CROSSING, **QUICK).reset()[0]
    assert not any(same(first, one) for one in (second, other, by_chance))


def test_an_action_that_is_no_number_ends_its_scene_alone() -> None:
    one, other = (vectors(CROSSING, num_envs=3, people="go_to_goal") for _ in range(2))
    for env in (one, other):
        env.reset(seed=0)
    actions = np.full((3, 2), 0.5, np.float32)
    expected = other.step(actions)
    actions[1] = np.nan
    with pytest.warns(UserWarning, match="scene 1"):
        seen, rewards, terminated, truncated, infos = one.step(actions)
    assert truncated.tolist() == [False, True, False] and not terminated.any()
    assert infos["final_info"]["FAILED"].tolist() == [False, True, False]
    for scene in (0, 2):
        assert same(row(seen, scene), row(expected[0], scene)) and rewards[scene] == expected[1][scene]
    assert all(np.isfinite(value).all() for value in seen.values())


@pytest.mark.parametrize("people", [0, 100])
def test_any_number_of_people(people: int) -> None:
    name = f"goals:map=office.7,people={people},pool=8"
    env = made("pedzoo/Goals-v0", scenario=name, people="go_to_goal")
    seen, info = env.reset(seed=0)
    assert seen["mask"].sum() == min(people, 10)
    assert np.isinf(info["MINIMUM_DISTANCE_TO_HUMAN"]) == (people == 0)
    seen, reward, *_ = env.step(env.action_space.sample())
    assert seen in env.observation_space and np.isfinite(reward)


def test_info_says_what_became_of_the_robot() -> None:
    """A robot that goes straight to its goal at top speed has no way and no time to lose."""
    env = made("pedzoo/Goals-v0", scenario="goals:map=flat,people=0")
    columns = env.unwrapped.batched.observations.columns
    seen, info = env.reset(seed=3)
    way = seen["robot"][columns["remaining_path"]].item()
    assert not info["SUCCESS"] and info["SPL"] == 0
    terminated = truncated = False
    while not (terminated or truncated):
        ahead = seen["robot"][columns["waypoint"]]
        seen, _, terminated, truncated, info = env.step(ahead / np.linalg.norm(ahead))
    assert terminated and info["SUCCESS"] and info["is_success"] and not info["COLLISION"]
    assert info["PATH_LENGTH"] == pytest.approx(way - 0.3, abs=0.3)
    assert info["TIME_TO_REACH_GOAL"] == pytest.approx(way - 0.3, abs=0.4)
    assert info["SPL"] > 0.95 and info["STL"] > 0.95 and info["PERSONAL_SPACE_COMPLIANCE"] == 1


def test_a_person_who_is_met_is_a_collision() -> None:
    """A wide robot goes head-on towards those who come from the other side and do not see it."""
    settings = {"scenario": "circle:radius=3,people=5", "robot": "disc:radius=0.6", "people": "go_to_goal"}
    env = made(CROSSING, **settings)
    env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        *_, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
    assert terminated and info["COLLISION"] and info["COLLISION_HUMAN"] and not info["COLLISION_WALL"]
    assert info["MINIMUM_DISTANCE_TO_HUMAN"] <= 0 and 0 < info["PERSONAL_SPACE_COMPLIANCE"] < 1
    assert info["SPL"] == info["STL"] == 0


def test_recorded_people_do_not_react() -> None:
    """Whatever the robot does, the others walk as they were recorded; it is in the place of one of them."""
    paths = []
    for action in ([0.0, 0.0], [1.0, 0.3]):
        env = made("pedzoo/Replay-v0", ends_at="none")
        env.reset(seed=0)
        for _ in range(8):
            env.step(np.array(action))
        state = env.unwrapped.batched.env.state
        assert state.mask[0, -1] and state.kind[0].tolist() == [0] * (state.kind.shape[1] - 1) + [1]
        paths.append(state.past[0])
    assert torch.equal(paths[0][:-1], paths[1][:-1]) and not torch.equal(paths[0][-1], paths[1][-1])
    seen, _ = made("pedzoo/CrowdNav-v0").reset(seed=0)
    np.testing.assert_allclose(seen["people"][:, 4], 0.3, atol=1e-6)


def test_settings_make_other_robots_and_spaces() -> None:
    sensors = ["goal", "lidar:beams=16,reach=4", "patch:cells=8"]
    env = made("pedzoo/Door-v0", robot="unicycle:reverse=false,top_turn=1.5", sensors=sensors)
    assert set(env.observation_space) == {"robot", "lidar", "map"}
    assert env.observation_space["lidar"].shape == (16,) and env.observation_space["lidar"].high.max() == 4
    np.testing.assert_allclose(env.action_space.low, [0.0, -1.5])
    np.testing.assert_allclose(env.action_space.high, [1.0, 1.5])
    assert env.reset(seed=0)[0] in env.observation_space


def test_pictures_show_the_robot_and_a_window_needs_a_display(monkeypatch) -> None:
    env = made(CROSSING, render_mode="rgb_array", render_size=(320, 240), **QUICK)
    env.reset(seed=0)
    before = env.render().astype(int)
    env.step(np.array([1.0, 0.0]))
    after = env.render().astype(int)
    assert before.shape == (240, 320, 3) and (before.sum(-1) == 0).any()
    assert (before != after).any()
    many = vectors(CROSSING, num_envs=2, render_mode="rgb_array", **QUICK)
    many.reset(seed=0)
    assert [picture.shape for picture in many.render()] == [(480, 640, 3)] * 2
    monkeypatch.setenv("MPLBACKEND", "agg")
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    with pytest.raises(UserError, match="display"):
        made(CROSSING, render_mode="human", **QUICK)


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (made, {"num_envs": 4}, "make_vec"),
        (made, {"robot": ["disc", "disc"]}, "parallel_env"),
        (made, {"robot": "disk"}, "did you mean"),
        (made, {"render_size": (0, 80)}, r"size .0, 80.: expected width and height in pixels"),
        (vectors, {"autoreset_mode": "Next"}, "autoreset_mode 'Next': did you mean 'NextStep'"),
    ],
)
def test_settings_that_do_not_fit_are_named(make: Any, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make(CROSSING, **settings)


def test_seeds_masks_and_actions_that_do_not_fit_are_named() -> None:
    env = vectors(CROSSING, num_envs=2, **QUICK)
    for seed in ([1], [1, 2, 3], np.arange(3)):
        with pytest.raises(UserError, match="expected one, or 2"):
            env.reset(seed=seed)
    for mask in ([True, False], np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        with pytest.raises(UserError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
    env.reset(seed=1)
    for shape in ((2, 3), (1, 2), (2, 1), (4,)):
        with pytest.raises(UserError, match=r"expected \(1, 2\) per scene"):
            env.step(np.zeros(shape))
    env.step(np.zeros((2, 2)))


def test_without_gymnasium_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setattr("pedzoo.core.errors.find_spec", lambda name: None)
    with pytest.raises(UserError, match=re.escape(install_command("gym"))):
        importlib.reload(pedzoo.sim.gym)


def test_several_robots_pass_pettingzoos_check() -> None:
    settings = {"people": "go_to_goal", "time_limit": 4.0}
    env = parallel_env("perpendicular:people=6", robot=["disc", "jackal", "unicycle"], **settings)
    parallel_api_test(env, num_cycles=60)
    first, again = env.reset(seed=2)[0], env.reset(seed=2)[0]
    assert all(same(first[agent], again[agent]) for agent in env.possible_agents)
    assert env.observation_space("robot_0") != env.action_space("robot_0")
    radius = [one["robot"][env.batched.observations.columns["radius"]].item() for one in first.values()]
    assert radius[0] == radius[2] != radius[1]


def test_crowdnavs_dictionary_has_its_layout() -> None:
    """Positions and velocities are those of the world, nearest first, and people go on as they do."""
    sensors = ["attn_graph:most=4,reach=6,predicted=2,seconds=0.5"]
    env = made(CROSSING, scenario="perpendicular:people=9", sensors=sensors, people="go_to_goal")
    shapes = {name: space.shape for name, space in env.observation_space.items()}
    edges = {"robot_node": (1, 7), "temporal_edges": (1, 2), "spatial_edges": (4, 6)}
    assert shapes == edges | {"visible_masks": (4,), "detected_human_num": (1,)}
    env.reset(seed=0)
    for _ in range(10):
        seen = env.step(np.array([0.8, 0.0]))[0]
    state = env.unwrapped.batched.env.state
    here, moves = state.position[0], state.velocity[0]
    own = (here[-1], state.radius[0, -1:], state.goal_point[0, -1], torch.ones(1), state.heading[0, -1:])
    np.testing.assert_allclose(seen["robot_node"][0], torch.cat(own), atol=1e-5)
    np.testing.assert_allclose(seen["temporal_edges"][0], moves[-1], atol=1e-5)
    place = here[:-1] - here[-1]
    order = place.norm(dim=1).argsort()
    order = order[place.norm(dim=1)[order] <= 6][:4]
    assert 1 <= len(order) == seen["detected_human_num"].item() == seen["visible_masks"].sum()
    expected = torch.cat([place[order] + step * moves[:-1][order] for step in (0.0, 0.5, 1.0)], 1)
    np.testing.assert_allclose(seen["spatial_edges"][: len(order)], expected, atol=1e-4)
    assert (seen["spatial_edges"][len(order) :] == 15).all()


def test_stable_baselines3_trains_on_it_unchanged() -> None:
    baselines = pytest.importorskip("stable_baselines3", reason="needs stable-baselines3 (pedzoo[dev])")
    env = made("pedzoo/Goals-v0", scenario="goals:map=flat,people=2", people="go_to_goal")
    model = baselines.PPO("MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0)
    model.learn(128)
    assert model.num_timesteps == 128
    action, _ = model.predict(env.reset(seed=0)[0])
    assert action in env.action_space
