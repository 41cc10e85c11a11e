"""Whether and when people arrive, and how far they walked: values computed by hand."""

from typing import Any

import pytest
import torch
from helpers.walks import made
from torch import Tensor

from pedzoo.metrics.arrival import (
    arrived_in_time,
    finish_seconds,
    goals_parity,
    goals_per_person_max,
    goals_per_person_min,
    over_spans,
    planned_metres,
    seconds_per_goal,
    stuck,
    time_s,
    walked_metres,
    weighted,
)
from pedzoo.sim.rollout import Rollout

INF = float("inf")


def standing(reached: Tensor, **fields: Any) -> Rollout:
    """People who stand (E, A, T), with the goals that they have ``reached`` by then."""
    present = fields.get("mask", torch.ones(reached.shape[:2], dtype=torch.bool)).unsqueeze(2)
    path = torch.zeros(*reached.shape[:2], reached.shape[2] + 1, 2)
    return made(path, present.expand_as(reached), reached=reached, **fields)


def test_success_needs_all_goals_in_time() -> None:
    reached = torch.tensor([[[1, 2], [1, 1], [2, 2], [2, 2]], [[2, 2], [2, 2], [2, 2], [2, 2]]])
    late = torch.tensor([[False, False, True, False]]).expand(2, 4)
    mask = torch.tensor([[True, True, True, False]]).expand(2, 4)
    walked = standing(reached, goals=2, overdue=late, failed=torch.tensor([False, True]), mask=mask)
    assert arrived_in_time(walked).tolist() == [[True, False, False, False], [False] * 4]


def test_an_episode_takes_as_long_as_its_last_person() -> None:
    """In the second one a person is late, in the third one never arrives."""
    reached = torch.tensor([[[0, 1, 1, 2], [2, 2, 2, 2], [0, 0, 1, 1]]])
    assert finish_seconds(reached, 2)[0].tolist() == pytest.approx([0.4, 0.1, INF])
    reached = (torch.arange(40) >= torch.tensor([9, 29, 99])[:, None]).long().expand(3, 3, 40).clone()
    reached[1, 2] = reached[2, 0]
    late = torch.tensor([[False] * 3, [False, True, False], [False] * 3])
    mask = torch.tensor([[True, True, False], [True, True, True], [True, True, True]])
    ratio = time_s(standing(reached, overdue=late, mask=mask))
    assert ratio.above.tolist() == pytest.approx([3.0, 0, 0]) and ratio.below.tolist() == [1, 0, 0]


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
    assert stuck(trace, goal, present).any(2).tolist() == [[True, False, False, False, False]]
    assert not stuck(trace[:, :, 9:59], goal[:, :, 9:59], present[:, :, 9:59]).any()
    present[0, 0, 30] = False  # two people who stand in the same slot
    assert not stuck(trace, goal, present).any()


def test_who_comes_back_within_5_s_is_not_deadlocked() -> None:
    seconds = torch.arange(80) / 10
    there_and_back = torch.stack((1.3 * (seconds - 4).abs(), torch.zeros(80)), dim=-1)
    swaying = torch.stack((0.04 * (9 * seconds).sin(), torch.zeros(80)), dim=-1)
    trace = torch.stack((there_and_back, swaying))[None]
    result = stuck(trace, torch.full_like(trace, 20.0), torch.ones(1, 2, 80, dtype=torch.bool))
    # at every point of the one who sways, from 5 s on
    assert result[0].tolist() == [[False] * 80, [False] * 50 + [True] * 30]


def test_way_and_plan_end_where_the_last_goal_is_reached() -> None:
    path = torch.zeros(1, 3, 6, 2)
    path[0, :, :, 1] = torch.tensor([0.0, 1.0, 3.0, 6.0, 10.0, 15.0])
    reached = torch.tensor([[[0, 1, 1, 2, 2], [0, 0, 1, 1, 1], [2, 2, 2, 2, 2]]])
    planned = torch.tensor([[[4.0, 4, 9, 9, 20], [4.0, 4, 4, 9, 9], [0.0, 5, 5, 5, 5]]])
    scored = torch.ones(1, 3, 5, dtype=torch.bool)
    scored[0, 1, 3:] = False
    assert walked_metres(path, scored, reached, 2).tolist() == [[10.0, 6.0, 1.0]]
    assert planned_metres(planned, reached, 2).tolist() == [[9.0, 9.0, 0.0]]
    assert walked_metres(path, scored, reached, 1).tolist() == [[3.0, 6.0, 1.0]]


def test_success_and_seconds_are_weighted_by_what_they_took() -> None:
    done = torch.tensor([[True, True, False, True]])
    least, taken = torch.tensor([[4.0, 4.0, 4.0, 0.0]]), torch.tensor([[5.0, 3.0, 4.0, 0.0]])
    assert weighted(done, least, taken)[0].tolist() == pytest.approx([0.8, 1.0, 0.0, 1.0])
    reached, mask = torch.tensor([[[2], [3]], [[2], [9]]]), torch.tensor([[True, True], [True, False]])
    seconds, goals = seconds_per_goal(torch.tensor([INF, 4.0]), reached, mask)
    assert (seconds.tolist(), goals.tolist()) == ([0.0, 4.0], [0, 2]), "nothing of an unfinished episode"


def test_fewest_and_most_goals_are_of_people_who_took_part() -> None:
    """By hand: 2 and 3 in the first episode, 0 and 4 in the second."""
    reached = torch.tensor([[[0, 2], [0, 3], [9, 9]], [[0, 1], [0, 0], [0, 4]]])
    mask = torch.tensor([[True, True, False], [True, True, True]])
    walked = standing(reached, mask=mask)
    assert goals_per_person_min(walked).above.tolist() == [2, 0]
    assert goals_per_person_max(walked).above.tolist() == [3, 4]
    assert goals_parity(walked).above.tolist() == pytest.approx([2 / 3, 0])


def test_people_of_a_slot_are_told_apart_by_gaps() -> None:
    rows = ("0110111", "1000000", "0000000")
    scored = torch.tensor([[[letter == "1" for letter in row] for row in rows]])
    assert over_spans(scored, scored.long()).tolist() == [[[2, 3], [1, 0], [0, 0]]]
    assert over_spans(scored, torch.arange(7).expand(1, 3, 7)).tolist() == [[[3, 15], [0, 0], [0, 0]]]
