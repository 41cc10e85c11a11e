"""Pieces of metrics by hand and by brute force: contacts, arrival, ways and smoothness."""

import math
from typing import Any

import pytest
import torch
from helpers.walks import made, straight
from torch import Tensor

from pedzoo.metrics import contacts
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
from pedzoo.metrics.closed_loop import measure
from pedzoo.metrics.contacts import (
    collision_seconds,
    contact_events,
    least_distance,
    nearest,
    person_minutes,
    time_to_collision,
)
from pedzoo.metrics.smoothness import acceleration, heading_rate, jerk, length, turning, velocities
from pedzoo.sim.rollout import Rollout

INF = float("inf")


def bits(*rows: str) -> Tensor:
    return torch.tensor([[[letter == "1" for letter in row] for row in rows]])


def test_a_touch_that_lasts_is_one_event() -> None:
    assert contact_events(bits("0110100", "1111111", "0000000")).tolist() == [[2, 1, 0]]
    assert person_minutes(bits("110", "000"))[0].tolist() == pytest.approx([0.2 / 60, 0])


@pytest.mark.parametrize("at_once", [1, 100, 10**9])
def test_nearest_is_the_least_distance_to_present_others(at_once: int, monkeypatch) -> None:
    monkeypatch.setattr(contacts, "_AT_ONCE", at_once)
    generator = torch.Generator().manual_seed(0)
    trace = 5 * torch.rand(3, 4, 50, 2, generator=generator)
    present = torch.rand(3, 4, 50, generator=generator) > 0.4
    result = nearest(trace, present)
    for e, a, t in torch.cartesian_prod(torch.arange(3), torch.arange(4), torch.arange(50)).tolist():
        others = [b for b in range(4) if b != a and present[e, b, t]]
        apart = [float((trace[e, a, t] - trace[e, b, t]).norm()) for b in others]
        expected = min(apart, default=INF) if present[e, a, t] else INF
        assert float(result[e, a, t]) == pytest.approx(expected)


def test_who_is_scored_may_come_near_anybody_who_is_there() -> None:
    path = torch.zeros(1, 3, 5, 2)
    path[0, 1, :, 0] = torch.tensor([3.0, 3.0, 2.0, 0.4, 1.0])
    path[0, 2, :, 0] = 5.0
    walked = made(path, bits("1111", "1110", "1111"), controlled=bits("1111", "0000", "0011"))
    # the third person's second point is the first one that is scored and has a point before it
    assert least_distance(walked)[0].tolist() == pytest.approx([0.4, INF, 4.6])
    above, below, *_ = contacts.personal_space(walked)
    assert (above.item(), below.item()) == (5, 6)
    assert contacts.personal_space_igibson(walked).above.item() == pytest.approx(1 - 1 / 500 + 1 + 1)


def test_igibson_divides_by_500_steps_always() -> None:
    """Two people 0.4 m apart: 90 s of one, of whom nothing is left, and 5 s of the other."""
    path = torch.zeros(1, 2, 901, 2)
    path[:, 1, :, 0] = 0.4
    controlled = torch.ones(1, 2, 900, dtype=torch.bool)
    controlled[0, 1, 50:] = False
    kept = contacts.personal_space_igibson(made(path, controlled=controlled)).above
    assert kept.item() == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("apart", "velocity", "expected"),
    [
        ((4.0, 0.0), (-2.0, 0.0), 3.7 / 2),
        ((3.0, 4.0), (-0.6, -0.8), 4.7),
        ((4.0, 0.18), (-1.0, 0.0), 4.0 - 0.24),  # 0.18, 0.24, 0.3
        ((4.0, 0.31), (-1.0, 0.0), 10.0),  # passes
        ((4.0, 0.0), (1.0, 0.0), 10.0),  # walks away
        ((40.0, 0.0), (-1.0, 0.0), 10.0),  # later
        ((4.0, 0.0), (0.0, 0.0), 10.0),  # as far for ever
        ((0.1, 0.2), (3.0, 0.0), 0.0),  # touches now
    ],
)
def test_time_to_collision_of_simple_encounters(
    apart: tuple[float, float], velocity: tuple[float, float], expected: float
) -> None:
    position = torch.tensor([(1.0, 2.0), (1.0 + apart[0], 2.0 + apart[1])]).view(1, 2, 1, 2)
    speeds = torch.tensor([(0.3, -0.4), (0.3 + velocity[0], -0.4 + velocity[1])]).view(1, 2, 1, 2)
    result = time_to_collision(position, speeds, torch.ones(1, 2, 1, dtype=torch.bool))
    assert result.flatten().tolist() == pytest.approx([expected, expected])


@pytest.mark.parametrize("at_once", [1, 10**9])
def test_time_to_collision_is_when_discs_first_touch(at_once: int, monkeypatch) -> None:
    monkeypatch.setattr(contacts, "_AT_ONCE", at_once)
    generator = torch.Generator().manual_seed(0)
    position = 3 * torch.randn(2, 5, 20, 2, generator=generator)
    velocity = torch.randn(2, 5, 20, 2, generator=generator)
    there = torch.rand(2, 5, 20, generator=generator) > 0.2
    result = time_to_collision(position, velocity, there)
    times = torch.linspace(0, 10, 5001)
    walked = position.unsqueeze(3) + velocity.unsqueeze(3) * times.unsqueeze(1)  # (E, A, S, N, 2)
    touches = (walked.unsqueeze(1) - walked.unsqueeze(2)).norm(dim=-1) < 0.3
    touches &= (there.unsqueeze(1) & there.unsqueeze(2)).unsqueeze(-1)
    touches &= ~torch.eye(5, dtype=torch.bool).view(1, 5, 5, 1, 1)
    first = torch.where(touches.any(-1), times[touches.int().argmax(-1)], 10.0).amin(2)
    meets = there & (there.sum(1, keepdim=True) > 1)
    assert (result[~meets] == INF).all() and (result[meets] < 9.9).sum() > 20
    torch.testing.assert_close(result[meets], first[meets], atol=0.02, rtol=0)


@pytest.mark.parametrize(("radii", "expected"), [([[0.15, 0.5]], 0.675), (None, 0.85)])
def test_wide_bodies_touch_earlier(radii: list | None, expected: float) -> None:
    """2 m apart, 2 m/s towards each other: bodies of 0.15 and 0.5 m touch after 1.35 m."""
    position = torch.tensor([[[[0.0, 0.0]], [[2.0, 0.0]]]])
    velocity = torch.tensor([[[[1.0, 0.0]], [[-1.0, 0.0]]]])
    there, radius = torch.ones(1, 2, 1, dtype=torch.bool), torch.tensor(radii) if radii else None
    result = time_to_collision(position, velocity, there, radius)
    assert result.flatten().tolist() == pytest.approx([expected, expected])
    # who only grazes the other touches
    away, moves = torch.tensor([4.0, 3.0]), torch.tensor([-1.0, 0.0])
    assert collision_seconds(away, moves, torch.tensor(3.0)).item() == 4.0


# Arrival


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


# Smoothness


SECONDS = 0.1 * torch.arange(41, dtype=torch.float64)


def along_x(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return velocities of one person who is at ``x`` (1 + T,) all the time."""
    path = torch.stack((x, torch.zeros_like(x)), dim=-1)[None, None]
    return velocities(path, torch.ones(1, 1, len(x) - 1, dtype=torch.bool))


def corners(*steps: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """Return velocities of one person who goes these steps in windows of 0.4 s."""
    path = torch.tensor([(0.0, 0.0), *steps], dtype=torch.float64).cumsum(0)[None, None]
    path = torch.cat((path[:, :, :1], path[:, :, 1:].repeat_interleave(4, dim=2)), dim=2)
    return velocities(path, torch.ones(1, 1, 4 * len(steps), dtype=torch.bool))


def test_constant_speed_acceleration_and_jerk_are_found_exactly() -> None:
    for power, function in ((1, None), (2, acceleration), (3, jerk)):
        velocity, known = along_x(1.7 * SECONDS**power / math.factorial(power))
        value, known = function(velocity, known) if function else (velocity.norm(dim=-1), known)
        assert known.all() and value.shape[2] == 11 - power
        torch.testing.assert_close(value, torch.full_like(value, 1.7))
    velocity, known = along_x(1.7 * SECONDS)
    assert float(length(velocity, known)) == pytest.approx(6.8)


def test_on_a_circle_headings_turn_as_fast_as_the_person() -> None:
    speed, radius = 1.2, 2.0
    angle = speed / radius * SECONDS
    path = radius * torch.stack((angle.cos(), angle.sin()), dim=-1)[None, None]
    velocity, known = velocities(path, torch.ones(1, 1, 40, dtype=torch.bool))
    rate, walks = heading_rate(velocity, known)
    assert walks.all()
    torch.testing.assert_close(rate, torch.full_like(rate, speed / radius))
    chord = 2 * radius * math.sin(speed / radius * 0.4 / 2)
    amount, _ = acceleration(velocity, known)
    torch.testing.assert_close(amount, torch.full_like(amount, chord / 0.4 * 2 * math.sin(0.12) / 0.4))
    assert float(turning(velocity, known)) == pytest.approx(9 * 0.24)
    assert float(length(velocity, known)) == pytest.approx(10 * chord)
    irregular = scores(path[0, 0])["path_irregularity_rad_per_m"]
    assert irregular == pytest.approx(9 * 0.24 / (10 * chord), rel=1e-3)


def test_left_and_right_turns_add_up_and_angles_wrap() -> None:
    velocity, known = corners((-0.4, 0.1), (-0.4, -0.1), (-0.4, 0.1))
    expected = 2 * math.atan2(0.1, 0.4)
    rate, walks = heading_rate(velocity, known)
    assert walks.all() and rate[0, 0].tolist() == pytest.approx([expected / 0.4] * 2)
    assert float(turning(velocity, known)) == pytest.approx(2 * expected)


def test_a_turn_at_a_stop_has_no_rate() -> None:
    velocity, known = corners((0.4, 0.0), (0.0, 0.0), (0.01, 0.01), (0.0, 0.4), (0.0, 0.4))
    assert float(turning(velocity, known)) == pytest.approx(math.pi / 2)
    rate, walks = heading_rate(velocity, known)
    assert walks[0, 0].tolist() == [False, False, False, True] and float(rate[0, 0, 3]) == 0.0
    # standing has no heading: who sets out has not turned
    assert float(turning(*corners((0.0, 0.0), (0.0, 0.4), (0.0, 0.4)))) == 0.0


def test_nothing_is_measured_across_a_gap() -> None:
    path = torch.cat((straight(1.0, 12), straight(1.0, 12, (0.0, 50.0)).flip(0)))[None, None]
    scored = torch.ones(1, 1, 25, dtype=torch.bool)
    scored[0, 0, 12] = False  # the step between them
    velocity, known = velocities(path, scored)
    assert known[0, 0].tolist() == [True, True, True, False, True, True]
    assert velocity.norm(dim=-1)[known].tolist() == pytest.approx([1.0] * 5)
    assert acceleration(velocity, known)[1].sum() == 3 and jerk(velocity, known)[1].sum() == 1
    assert float(turning(velocity, known)) == 0.0  # both walk straight, though in opposite directions
    assert float(length(velocity, known)) == pytest.approx(2.0)


def scores(path: Tensor) -> dict[str, float]:
    return measure(made(path[None, None].float()))[0]


def test_a_teleporting_trace_scores_visibly_badly() -> None:
    walking = scores(straight())
    assert walking["acceleration_m_per_s2"] < 0.01 and walking["jerk_m_per_s3"] < 0.05
    jumping = straight()[::20].repeat_interleave(20, dim=0)[:201]  # stands, and jumps 2.6 m every 2 s
    result = scores(jumping)
    # each fifth window has 2.6 m: 6.5 m/s, twice a change of that, three times one of its change
    assert result["speed_m_per_s"] == pytest.approx(1.3, abs=0.05)
    assert result["acceleration_m_per_s2"] == pytest.approx(6.5, rel=0.05)
    assert result["jerk_m_per_s3"] == pytest.approx(32.5, rel=0.05)
    once = straight()
    once[100:] += torch.tensor([0.0, 4.0])
    assert scores(once)["acceleration_m_per_s2"] > 0.5 and scores(once)["jerk_m_per_s3"] > 1.5
