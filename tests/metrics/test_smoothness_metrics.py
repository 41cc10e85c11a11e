"""Speeds, accelerations, turning: values computed by hand on simple ways."""

import math

import pytest
import torch
from helpers.walks import made, straight
from torch import Tensor

from pedzoo.metrics.closed_loop import measure
from pedzoo.metrics.smoothness import acceleration, heading_rate, jerk, length, turning, velocities

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
