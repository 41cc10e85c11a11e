"""Whether and when people arrive, and how far they walked: values computed by hand."""

from __future__ import annotations

import pytest
import torch

from pedzoo.metrics.arrival import (
    arrived_in_time,
    deadlocked,
    episode_seconds,
    fewest_goals,
    finish_seconds,
    most_goals,
    planned_metres,
    seconds_per_goal,
    stuck,
    walked_metres,
    weighted,
)

INF = float("inf")


def test_success_needs_all_goals_in_time() -> None:
    reached = torch.tensor([[[1, 2], [1, 1], [2, 2], [2, 2]], [[2, 2], [2, 2], [2, 2], [2, 2]]])
    late = torch.tensor([[False, False, True, False]]).expand(2, 4)
    mask = torch.tensor([[True, True, True, False]]).expand(2, 4)
    result = arrived_in_time(reached, 2, late, torch.tensor([False, True]), mask)
    assert result.tolist() == [[True, False, False, False], [False] * 4]


def test_people_finish_when_the_last_goal_counts() -> None:
    reached = torch.tensor([[[0, 1, 1, 2], [2, 2, 2, 2], [0, 0, 1, 1]]])
    assert finish_seconds(reached, 2)[0].tolist() == pytest.approx([0.4, 0.1, INF])


def test_an_episode_takes_as_long_as_its_last_person() -> None:
    seconds = torch.tensor([[1.0, 3.0, INF], [1.0, 3.0, 2.0], [1.0, INF, 2.0]])
    done = torch.tensor([[True, True, False], [True, False, True], [True, False, True]])
    mask = torch.tensor([[True, True, False], [True, True, True], [True, True, True]])
    assert episode_seconds(seconds, done, mask).tolist() == [3.0, INF, INF]


def test_standing_for_5_s_away_from_the_goal_is_a_deadlock() -> None:
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


def test_who_comes_back_within_5_s_is_not_deadlocked() -> None:
    seconds = torch.arange(80) / 10
    there_and_back = torch.stack((1.3 * (seconds - 4).abs(), torch.zeros(80)), dim=-1)
    swaying = torch.stack((0.04 * (9 * seconds).sin(), torch.zeros(80)), dim=-1)
    trace = torch.stack((there_and_back, swaying))[None]
    goal, scored = torch.full_like(trace, 20.0), torch.ones(1, 2, 80, dtype=torch.bool)
    assert deadlocked(trace, goal, scored).tolist() == [[False, True]]
    # at every point of the one who sways, from 5 s on
    assert stuck(trace, goal, scored)[0, 1].tolist() == [False] * 50 + [True] * 30


def test_one_person_stands_for_all_of_the_5_s() -> None:
    trace, goal = torch.zeros(1, 2, 60, 2), torch.full((1, 2, 60, 2), 9.0)
    scored = torch.ones(1, 2, 60, dtype=torch.bool)
    scored[0, 0, 30] = False  # two people who stand in the same slot, 3 s each
    assert deadlocked(trace, goal, scored).tolist() == [[False, True]]


def test_way_and_plan_end_where_the_last_goal_is_reached() -> None:
    path = torch.zeros(1, 3, 6, 2)
    path[0, :, :, 1] = torch.tensor([0.0, 1.0, 3.0, 6.0, 10.0, 15.0])
    reached = torch.tensor([[[0, 1, 1, 2, 2], [0, 0, 1, 1, 1], [2, 2, 2, 2, 2]]])
    planned = torch.tensor(
        [[[4.0, 4.0, 9.0, 9.0, 20.0], [4.0, 4.0, 4.0, 9.0, 9.0], [0.0, 5.0, 5.0, 5.0, 5.0]]]
    )
    scored = torch.ones(1, 3, 5, dtype=torch.bool)
    scored[0, 1, 3:] = False
    assert walked_metres(path, scored, reached, 2).tolist() == [[10.0, 6.0, 1.0]]
    assert planned_metres(planned, reached, 2).tolist() == [[9.0, 9.0, 0.0]]
    assert walked_metres(path, scored, reached, 1).tolist() == [[3.0, 6.0, 1.0]]


def test_success_is_weighted_by_what_it_took() -> None:
    done = torch.tensor([[True, True, False, True]])
    least, taken = torch.tensor([[4.0, 4.0, 4.0, 0.0]]), torch.tensor([[5.0, 3.0, 4.0, 0.0]])
    assert weighted(done, least, taken)[0].tolist() == pytest.approx([0.8, 1.0, 0.0, 1.0])


def test_an_episode_that_is_not_finished_has_no_seconds_per_goal() -> None:
    reached, mask = torch.tensor([[[2], [3]], [[2], [9]]]), torch.tensor([[True, True], [True, False]])
    seconds, goals = seconds_per_goal(torch.tensor([INF, 4.0]), reached, mask)
    assert (seconds.tolist(), goals.tolist()) == ([0.0, 4.0], [0, 2])


def test_fewest_and_most_goals_are_of_people_who_took_part() -> None:
    reached = torch.tensor([[[0, 2], [0, 3], [9, 9]], [[0, 1], [0, 0], [0, 4]]])
    mask = torch.tensor([[True, True, False], [True, True, True]])
    assert fewest_goals(reached, mask).tolist() == [2, 0]
    assert most_goals(reached, mask).tolist() == [3, 4]
