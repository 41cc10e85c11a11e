"""Queues at a door and the interventions of a safety layer: values computed by hand."""

from __future__ import annotations

import math

import pytest
import torch
from helpers.walks import made, straight
from torch import Tensor

from pedzoo.eval.rollout import rollout
from pedzoo.metrics.closed_loop import closed_loop
from pedzoo.metrics.door import headways, sharp, wall_drift
from pedzoo.metrics.ratios import summarised

INF = float("inf")
GATE = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.8]], dtype=torch.float64)


def scored(path: Tensor) -> Tensor:
    return torch.ones(*path.shape[:2], path.shape[2] - 1, dtype=torch.bool)


def test_headways_are_times_from_person_to_person() -> None:
    """In whatever order they are numbered; people who are not through have none."""
    seconds = torch.tensor([[5.0, 1.0, 2.0, INF, 2.5], [3.0, INF, INF, INF, INF]])
    assert headways(seconds, 0.5).tolist() == pytest.approx([1.0, math.nan], nan_ok=True)
    assert headways(seconds, 0.0)[0] == pytest.approx(0.5)


def test_who_slides_along_the_wall_while_waiting_drifts() -> None:
    """0.3 m to the left before the door, then through; who only walks through does not wait."""
    up = torch.tensor([[-1.0, 0.0]]) + torch.arange(6).view(-1, 1) * torch.tensor([[0.0, 0.06]])
    on = torch.tensor([[-1.0, 0.3]]) + torch.arange(1, 16).view(-1, 1) * torch.tensor([[0.1, 0.0]])
    slides = torch.cat((up, on)).double()
    path = torch.stack((slides, straight(1.3, 20, (-1.0, 0.1)))).unsqueeze(0)
    metres, waits = wall_drift(path, scored(path), GATE, torch.tensor([[1.5, 0.8]]))
    assert waits.tolist() == [[True, False]] and metres[0].tolist() == pytest.approx([0.3, 0.0])


@pytest.mark.parametrize(("before", "waits"), [(1.4, True), (1.6, False), (-0.2, False)])
def test_people_wait_within_a_metre_and_a_half_before_the_door(before: float, waits: bool) -> None:
    """Who has begun on this side, and stands beyond the wall later, does not wait there."""
    stands = torch.tensor([-before, 0.1], dtype=torch.float64).expand(1, 1, 11, 2).clone()
    stands[..., 0, 0] = -2.0
    stands[..., 1:, 1] += 0.05 * torch.arange(10)
    metres, there = wall_drift(stands, scored(stands), GATE, torch.tensor([[9.0]]))
    assert there.item() == waits and metres.item() == pytest.approx(0.45 * waits)
    assert not wall_drift(stands, ~scored(stands), GATE, torch.tensor([[9.0]]))[1].any()


@pytest.mark.parametrize(("off", "turns"), [(2.5, 4), (4.0, 0)])
def test_turns_count_within_three_metres_of_the_door(off: float, turns: int) -> None:
    east, north = torch.tensor([0.1, 0.0]).double(), torch.tensor([0.0, 0.1]).double()
    steps = torch.stack((*[east] * 4, *[north] * 4)).cumsum(0) + torch.tensor([-off, 0.0])
    path = steps.view(1, 1, 8, 2)
    assert int(sharp(path, scored(path), GATE)[0].sum()) == max(0, turns - 1) * (turns > 0)


def test_a_right_angle_at_speed_is_a_sharp_turn() -> None:
    """Moments 0.4 s apart on both sides of the corner count; a person who slows down for it turns none."""
    east, north = torch.tensor([0.1, 0.0]).double(), torch.tensor([0.0, 0.1]).double()
    steps = torch.stack((*[east] * 10, *[north] * 10))
    slow = torch.stack((*[east] * 8, *[0.3 * east] * 4, *[0.3 * north] * 4, *[north] * 4))
    path = torch.cat((torch.zeros(2, 1, 2).double(), torch.stack((steps, slow)).cumsum(1)), 1).unsqueeze(0)
    turns, walks = sharp(path, scored(path), GATE)
    assert turns.sum(2).tolist() == [[4, 0]] and walks[0, 0].all()


def test_interventions_are_those_of_policies_with_a_layer() -> None:
    """By hand: of 4 steps one is changed by 0.1 m and one by 1 cm; a policy without a layer has no number."""
    path = torch.stack((straight(points=8), straight(points=8) + 3)).unsqueeze(0)
    changed = torch.tensor([[[0.1] * 4 + [0.01] * 4, [0.0] * 8]])
    result = summarised(closed_loop(made(path, changed=changed)))[0]
    assert result["intervention_share"] == 0.25 and result["intervention_m"] == pytest.approx(0.11 / 4)
    assert "intervention_m" not in summarised(closed_loop(made(path)))[0]


def test_the_layer_does_much_for_those_who_do_not_avoid_others() -> None:
    """Two who walk straight at each other at a door; without a layer nothing is said."""
    result = {}
    for policy in ("go_to_goal:safety=true", "go_to_goal"):
        walked, _ = rollout(policy, "door", "compiled", 3)
        result[policy] = summarised(closed_loop(walked))[0]
    assert 0.05 < result["go_to_goal:safety=true"]["intervention_share"] < 1
    assert "intervention_share" not in result["go_to_goal"]
