"""Closed-loop metrics against values computed by hand, on two little episodes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from pedzoo.eval.closed_loop import row
from pedzoo.geometry import identity_pose
from pedzoo.metrics.closed_loop import NAMES
from pedzoo.metrics.intervals import bootstrap, wilson
from pedzoo.metrics.navigation import deadlocked, episode_seconds, finish_seconds, success
from pedzoo.metrics.rollout import Rollout
from pedzoo.metrics.safety import contact_events, least_distance, nearest, person_minutes

INF = float("inf")


def bits(*rows: str) -> torch.Tensor:
    return torch.tensor([[letter == "1" for letter in row] for row in rows])


def two_episodes() -> Rollout:
    """Two people in each: both arrive in the first one, in the second one is late and the other absent."""
    mask = torch.tensor([[True, True], [True, False]])
    trace = torch.zeros(2, 2, 5, 2)
    trace[0, 0, :, 0] = torch.tensor([0.0, 0.1, 0.2, 0.3, 0.3])
    trace[0, 1, :, 0] = torch.tensor([1.0, 0.9, 0.6, 0.4, 0.3])
    trace[0, 1, :, 1] = 0.3
    touching = torch.stack((bits("00100", "00110"), bits("00000", "00000")))
    wall = torch.stack((bits("10100", "00000"), bits("11101", "00000")))
    reached = torch.tensor([[[0, 0, 1, 1, 1], [0, 0, 0, 1, 1]], [[0, 0, 0, 0, 0], [9, 9, 9, 9, 9]]])
    present = torch.stack((bits("11100", "11110"), bits("11111", "00000")))
    return Rollout(
        trace=trace,
        goal=trace,
        present=present,
        controlled=present,
        person=torch.arange(2).view(1, 2, 1).expand(2, 2, 5),
        planned=torch.ones(2, 2, 5),
        agent_contact=touching,
        wall_contact=wall,
        reached=reached,
        late=torch.tensor([[False, False], [True, False]]),
        failed=torch.tensor([False, False]),
        mask=mask,
        past=torch.zeros(2, 2, 29, 2),
        pref_speed=torch.ones(2, 2),
        way=torch.ones(2, 2),
        map_id=torch.full((2,), -1),
        pose=identity_pose(2),
        goals=1,
    )


def test_success_needs_all_goals_in_time_and_an_episode_that_did_not_fail() -> None:
    reached = torch.tensor([[[1, 2], [1, 1], [2, 2], [2, 2]], [[2, 2], [2, 2], [2, 2], [2, 2]]])
    late = torch.tensor([[False, False, True, False]]).expand(2, 4)
    mask = torch.tensor([[True, True, True, False]]).expand(2, 4)
    found = success(reached, 2, late, torch.tensor([False, True]), mask)
    assert found.tolist() == [[True, False, False, False], [False] * 4]


def test_people_finish_at_the_point_at_which_the_last_goal_counts() -> None:
    reached = torch.tensor([[[0, 1, 1, 2], [2, 2, 2, 2], [0, 0, 1, 1]]])
    assert finish_seconds(reached, 2)[0].tolist() == pytest.approx([0.4, 0.1, INF])


def test_an_episode_takes_as_long_as_its_last_person_and_counts_only_if_all_succeed() -> None:
    seconds = torch.tensor([[1.0, 3.0, INF], [1.0, 3.0, 2.0], [1.0, INF, 2.0]])
    done = torch.tensor([[True, True, False], [True, False, True], [True, False, True]])
    mask = torch.tensor([[True, True, False], [True, True, True], [True, True, True]])
    assert episode_seconds(seconds, done, mask).tolist() == [3.0, INF, INF]


def test_a_touch_that_lasts_is_one_event() -> None:
    assert contact_events(bits("0110100", "1111111", "0000000")[None]).tolist() == [[2, 1, 0]]


def test_minutes_are_those_in_which_somebody_is_there() -> None:
    present = torch.zeros(1, 2, 1000, dtype=torch.bool)
    present[0, 0, :600] = present[0, 1, :30] = True
    assert person_minutes(present)[0].tolist() == pytest.approx([1.0, 0.05])


def test_least_distance_is_to_people_who_are_there_at_that_time() -> None:
    walked = two_episodes()
    # the third point is the last that both share: 0.4 along x, 0.3 across; later they would be 0.3 apart
    expected = [[0.5, 0.5], [INF, INF]]
    found = least_distance(nearest(walked.trace, walked.present), walked.scored)
    assert found.tolist() == [pytest.approx(row) for row in expected]


def test_wilson_interval() -> None:
    # 8 of 10: the interval in Brown, Cai and DasGupta's formula, computed by hand
    assert wilson(0.8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    low, high = wilson(0.0, 20)
    assert low == 0.0 and high == pytest.approx(3.8415 / 23.8415, abs=1e-4)


def test_bootstrap_interval_is_that_of_a_mean_and_weighs_episodes_by_their_length() -> None:
    value = torch.randn(400, generator=torch.Generator().manual_seed(0)).double()
    low, high = bootstrap(value, torch.ones(400))
    half = 1.96 * float(value.std()) / 20
    assert (low, high) == pytest.approx((float(value.mean()) - half, float(value.mean()) + half), abs=0.02)
    assert bootstrap(3 * torch.arange(1.0, 6.0), torch.arange(1.0, 6.0)) == pytest.approx((3.0, 3.0))
    assert bootstrap(torch.tensor([4.0, 0.0]), torch.tensor([2, 0])) == pytest.approx((2.0, 2.0))


def test_row_of_two_episodes() -> None:
    found = row("somebody", two_episodes(), 0.4)
    minutes = (3 + 4 + 5) / 600
    second = 1.09**0.5 + 0.1 + 0.3 + 0.2  # metres that the second person walks until the goal
    assert found["metrics"] == pytest.approx(
        {
            "success": 2 / 3,
            "episode_success": 0.5,
            "failed": 0.0,
            "deadlock": 0.0,
            "goals_per_person": 2 / 3,
            "goals_per_person_min": 0.5,
            "goals_per_person_max": 0.5,
            "goals_parity": 1.0,
            "time_s": 0.4,
            "decisions": 1.0,
            "time_ratio": (0.3 + 0.4) / 2,
            "path_ratio": (0.2 + second) / 2,
            "spl": (1 + 1 / second + 0) / 3,
            "stl": (1 + 1 + 0) / 3,
            "agent_contacts_per_min": 2 / minutes,
            "wall_contacts_per_min": 4 / minutes,
            "agent_contacts_per_episode": 1.0,
            "wall_contacts_per_episode": 2.0,
            "agent_contact_episodes": 0.5,
            "wall_contact_episodes": 1.0,
            "personal_space": 1.0,
            "personal_space_igibson": 1.0,
            "least_distance_m": 0.5,
            "speed_m_per_s": (0.5 / 0.4 + 0) / 2,  # two people are there for a whole window
            "path_irregularity_rad_per_m": 0.0,
        }
    )
    assert list(found["metrics"]) == [name for name in NAMES if name in found["metrics"]]
    assert found["name"] == "somebody" and found["n"] == 2 and found["decision_dt_s"] == 0.4
    assert found["ci95"]["episode_success"] == wilson(0.5, 2)
    assert "time_s" not in found["ci95"]  # one episode says nothing about others
    first, second, third = found["per_agent"]
    assert (first["episode"], first["agent"], third["episode"], third["agent"]) == (0, 0, 1, 0)
    assert (first["time_s"], second["time_s"], third["time_s"]) == (0.3, 0.4, None)
    assert (first["agent_contacts"], first["wall_contacts"], third["wall_contacts"]) == (1, 2, 2)
    assert third["least_distance_m"] is None and third["success"] is False


def test_nobody_who_fails_at_once_has_rates() -> None:
    walked = two_episodes()
    nobody = torch.zeros_like(walked.present)
    walked = replace(
        walked,
        present=nobody,
        controlled=nobody,
        failed=torch.tensor([True, True]),
        agent_contact=nobody,
        wall_contact=nobody,
        reached=torch.zeros(2, 2, 5).long(),
    )
    metrics = row("broken", walked, 0.4)["metrics"]
    assert metrics["failed"] == 1.0 and metrics["success"] == metrics["episode_success"] == 0.0
    assert not {"time_s", "least_distance_m", "agent_contacts_per_min"} & set(metrics)


def test_who_stands_still_for_5_s_away_from_the_goal_is_deadlocked() -> None:
    steps = torch.arange(60.0)
    x = torch.zeros(1, 5, 60)
    x[0, 0] = (0.3 * steps).clamp_max(2.4)  # walks until point 8, then stands for 5.1 s
    x[0, 1] = (0.3 * steps).clamp_max(3.0)  # stands for 4.9 s only
    x[0, 2] = 0.003 * steps  # creeps: 0.15 m in 5 s
    trace = torch.stack((x, torch.zeros_like(x)), dim=-1)
    goal = torch.tensor([4.0, 0.0]).expand(1, 5, 60, 2).clone()
    goal[0, 3] = torch.tensor([0.4, 0.0])  # stands before its goal
    present = torch.ones(1, 5, 60, dtype=torch.bool)
    present[0, 4, 50:] = False  # stands, but leaves before 5 s are over
    assert deadlocked(trace, goal, present).tolist() == [[True, False, False, False, False]]
    assert not deadlocked(trace[:, :, 9:59], goal[:, :, 9:59], present[:, :, 9:59]).any()
