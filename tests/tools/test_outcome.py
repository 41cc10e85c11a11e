"""How two get past each other at a door, and how long people walk for a goal."""

from __future__ import annotations

import math

import pytest
import torch
from helpers.walks import made

from pedzoo.metrics.arrival import seconds_per_goal
from pedzoo.metrics.ratios import summarised
from tools.paper.meetings import OUTCOMES, bearing_sweep, outcome_ratios, outcomes


def test_time_per_goal_by_hand() -> None:
    """Two people are finished after 20 s with 3 and 5 goals: 40 s for 8. In the other none is in time."""
    reached = torch.tensor([[[1, 3], [2, 5]], [[0, 1], [0, 0]]])
    above, below = seconds_per_goal(torch.tensor([20.0, math.inf]), reached, torch.ones(2, 2).bool())
    assert above.tolist() == [40.0, 0.0] and below.tolist() == [8, 0]
    alone = torch.tensor([[True, False], [True, True]])
    assert [v.tolist() for v in seconds_per_goal(torch.tensor([20.0, 8.0]), reached, alone)] == [
        [20.0, 16.0],
        [3, 1],
    ]


def test_bearing_turns_while_two_are_close() -> None:
    """The second walks a quarter around the first at 0.5 m, with steps at 3 m that do not count."""
    far, angles = [[0.0, -3.0], [3.0, 0.0]], torch.linspace(0, math.pi / 2, 10)
    close = 0.5 * torch.stack((angles.cos(), angles.sin()), dim=-1)
    second = torch.cat((torch.tensor(far), close)).unsqueeze(0)
    trace = torch.stack((torch.zeros_like(second), second), dim=1)
    both = torch.ones(1, 12, dtype=torch.bool)
    assert float(bearing_sweep(trace, both)) == pytest.approx(math.pi / 2, abs=1e-5)
    back = torch.cat((trace, trace.flip(2)), dim=2)
    assert float(bearing_sweep(back, both.repeat(1, 2))) == pytest.approx(0.0, abs=1e-5)
    assert float(bearing_sweep(trace * 9, both)) == math.inf


def test_every_episode_has_one_outcome() -> None:
    nan = math.inf
    arrived = torch.tensor([False, False, True, True, True, True])
    stuck = torch.tensor([True, False, False, False, False, False])
    least = torch.tensor([1.0, 0.4, 0.1, 0.2, 0.5, nan])
    sweep = torch.deg2rad(torch.tensor([0.0, 170.0, 170.0, 120.0, 60.0, nan]))
    result = outcomes(arrived, stuck, least, sweep, torch.full((6,), 0.15))
    names = [next(name for name in OUTCOMES if result[name][i]) for i in range(6)]
    assert names == ["blocked", "lost", "through", "circle", "pass", "pass"]
    assert torch.stack(list(result.values())).sum(0).tolist() == [1] * 6


@pytest.mark.parametrize(("aside", "expected"), [(0.02, "through"), (0.1, "circle"), (0.4, "pass")])
def test_outcome_of_two_who_walk_straight_through_a_door(aside: float, expected: str) -> None:
    """They pass at 0.04, 0.2 and 0.8 m; the bearing turns by 2 acos(0.2 / 0.6) = 141 degrees at 0.2 m."""
    x = torch.linspace(-2, 2, 401)
    first = torch.stack((x, torch.full_like(x, aside)), dim=-1)
    path = torch.stack((first, -first)).unsqueeze(0)
    reached = torch.zeros(1, 2, 400, dtype=torch.long)
    reached[..., -1] = 1
    rollout = made(path, reached=reached, gate=torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.85]]))
    metrics, _ = summarised(outcome_ratios(rollout))
    assert {name for name in OUTCOMES if metrics[f"outcome_{name}"] == 1} == {expected}
    if expected == "circle":
        assert metrics["bearing_sweep_deg"] == pytest.approx(math.degrees(2 * math.acos(1 / 3)), abs=2)
    alone = made(path[:, :1], reached=reached[:, :1], gate=rollout.gate)
    assert summarised(outcome_ratios(alone))[0]["outcome_pass"] == 1
