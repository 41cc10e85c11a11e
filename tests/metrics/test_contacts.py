"""Distances and times to collision against brute force and values computed by hand."""

import pytest
import torch
from helpers.walks import made
from torch import Tensor

from pedzoo.metrics import contacts
from pedzoo.metrics.contacts import (
    collision_seconds,
    contact_events,
    least_distance,
    nearest,
    person_minutes,
    time_to_collision,
)

INF = float("inf")


def bits(*rows: str) -> Tensor:
    return torch.tensor([[[letter == "1" for letter in row] for row in rows]])


def test_a_touch_that_lasts_is_one_event() -> None:
    assert contact_events(bits("0110100", "1111111", "0000000")).tolist() == [[2, 1, 0]]
    assert person_minutes(bits("110", "000"))[0].tolist() == pytest.approx([0.2 / 60, 0])


@pytest.mark.parametrize("at_once", [1, 100, 10**9])
def test_nearest_is_the_least_distance_to_present_others(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
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
def test_time_to_collision_is_when_discs_first_touch(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
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
