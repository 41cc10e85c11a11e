"""Order and queues at a door, and what a safety layer changes: values by hand, and ORCA's mirror images."""

import math
from itertools import pairwise

import pytest
import torch
from helpers.walks import made, straight
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.core.registry import SCENARIOS
from pedzoo.eval.rollout import rollout
from pedzoo.metrics import door
from pedzoo.metrics.closed_loop import measure
from pedzoo.metrics.smoothness import velocities

INF = float("inf")
BOTH = torch.tensor([[0, 1]])
GATE = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.85]], dtype=torch.float64)


def walk(*corners: tuple[float, float, float]) -> Tensor:
    """Return the path (1 + T, 2) of who is at x, y at these times, seconds, and walks straight in between."""
    points = []
    for (x0, y0, t0), (x1, y1, t1) in pairwise(corners):
        share = torch.arange(round(10 * (t1 - t0)), dtype=torch.float64) / round(10 * (t1 - t0))
        points.append(torch.stack((x0 + share * (x1 - x0), y0 + share * (y1 - y0)), dim=-1))
    return torch.cat((*points, torch.tensor([corners[-1][:2]], dtype=torch.float64)))


def scored(path: Tensor) -> Tensor:
    return torch.ones(*path.shape[:2], path.shape[2] - 1, dtype=torch.bool)


def test_people_pass_when_they_cross_the_door_line_for_good() -> None:
    straight = walk((-0.53, 0.4, 0.0), (3.47, 0.4, 4.0))  # crosses between two points
    there_and_back = walk((-1.0, 0.0, 0.0), (1.0, 0.0, 2.0), (-1.0, 0.0, 4.0))
    at_last = walk((1.0, 0.0, 0.0), (-0.5, 0.0, 1.5), (0.5, 0.0, 2.5), (-1.0, 0.0, 4.0))
    beside = walk((-1.0, 0.43, 0.0), (1.0, 0.43, 4.0))
    waits = walk((-1.0, 0.0, 0.0), (-0.2, 0.0, 4.0))
    path = torch.stack((straight, there_and_back, at_last, beside, waits)).unsqueeze(0)
    result = door.passing_seconds(path, scored(path), GATE)[0].tolist()
    assert result == pytest.approx([0.53, INF, 3.0, INF, INF])
    gone = scored(path) & (torch.arange(40) < 5)
    assert door.passing_seconds(path, gone, GATE)[0, 0] == INF, "who is not there does not pass"


def test_pair_is_of_the_nearest_from_either_side() -> None:
    start = torch.tensor([[[-3.0, 0.0], [2.0, 0.5], [-2.5, 0.1], [1.0, 0.0], [-1.0, 0.0]]]).double()
    mask = torch.tensor([[True, True, True, True, False]])
    pair, met = door.pair(start, mask, GATE)
    assert pair.tolist() == [[2, 3]] and met.tolist() == [True]
    assert door.pair(start, mask & (start[..., 0] < 0), GATE)[1].tolist() == [False]


def test_symmetry_index_of_who_waits_until_the_other_is_through() -> None:
    waits, goes = walk((-2.5, 0.0, 0.0), (-2.5, 0.0, 5.0)), walk((2.5, 0.0, 0.0), (-2.5, 0.0, 5.0))
    path = torch.stack((waits, goes)).unsqueeze(0)
    there = scored(path)
    index, known = door.index_of_symmetry(path, there, GATE, BOTH)
    # the sum of both grows by 0.1 m at each of 50 points: 2.55 m in the mean
    assert known.all() and float(index) == pytest.approx(2.55 / 2.5)
    there[0, 0, 25:] = False
    assert float(door.index_of_symmetry(path, there, GATE, BOTH)[0]) == pytest.approx(1.3 / 2.5)
    metres, known = door.asymmetry(path, there, GATE, BOTH)
    assert known.all() and float(metres) == pytest.approx(1.3)
    mirrored = torch.stack((goes, -goes)).unsqueeze(0)
    assert float(door.index_of_symmetry(mirrored, there, GATE, BOTH)[0]) == 0.0
    assert not door.index_of_symmetry(path, there & False, GATE, BOTH)[1]
    # in metres it ends with the first arrival, at the 21st point
    reached = (torch.arange(50) >= 20).long() * torch.tensor([[[0], [1]]])
    result = measure(made(path, gate=GATE, reached=reached))[0]
    assert result["symmetry_m"] == pytest.approx(0.1 * 22 / 2)
    assert result["symmetry_index"] == pytest.approx(2.55 / 2.5)


def test_yield_delay_and_whether_the_faster_goes_first() -> None:
    seconds = torch.tensor([[3.0, 4.5], [4.5, 3.0], [3.0, INF], [3.0, 4.0], [2.0, 2.0]], dtype=torch.float64)
    speeds = torch.tensor([[1.2, 1.4], [1.2, 1.4], [1.4, 1.2], [1.3, 1.34], [1.3, 1.4]])
    assert door.delay(seconds).tolist() == [1.5, 1.5, INF, 1.0, 0.0]
    first, known = door.faster_is_first(seconds, speeds)
    assert known.tolist() == [True, True, False, False, True]
    assert first.tolist() == [False, True, False, False, False]


def test_yielder_speed_is_the_seconds_least_before_passing() -> None:
    first = walk((2.0, 0.0, 0.0), (-2.0, 0.0, 4.0), (-2.0, 0.0, 8.0))
    # slows down to 0.25 m/s, passes at 5.2 s, and stands only behind the door
    second = walk((-2.0, 0.0, 0.0), (-0.8, 0.0, 1.2), (-0.4, 0.0, 2.8), (1.6, 0.0, 4.8), (1.6, 0.0, 8.0))
    path = torch.stack((first, second)).unsqueeze(0)
    seconds = door.passing_seconds(path, scored(path), GATE)
    assert seconds[0].tolist() == pytest.approx([2.0, 3.2])
    moves = velocities(path, scored(path))
    assert float(door.yielder_speed(*moves, seconds)) == pytest.approx(0.25)
    assert float(door.yielder_speed(*moves, torch.tensor([[2.0, INF]], dtype=torch.float64))) == INF


def test_flow_and_headways_are_from_person_to_person() -> None:
    """Persons per width and time, however they are numbered; people who are not through have none."""
    seconds = torch.tensor([[2.0, 1.0, INF, 3.5], [1.0, INF, INF, INF], [1.0, 1.0, INF, INF]]).double()
    through, room = door.flow(seconds, torch.tensor([0.0, 0.0, 1.0, 0.0, 0.8]).expand(3, 5))
    assert through.tolist() == [3, 0, 0] and room.tolist() == pytest.approx([0.8 * 2.5, 0.0, 0.0])
    assert door.headways(seconds, 0.5).tolist() == pytest.approx([1.25, math.nan, 0.0], nan_ok=True)
    assert door.headways(seconds, 0.0)[0] == pytest.approx(1.0)


def test_metrics_of_a_person_who_yields() -> None:
    quick = walk((-2.5, 0.0, 0.0), (2.5, 0.0, 4.0), (2.5, 0.0, 8.0))
    slow = walk((2.6, 0.3, 0.0), (1.0, 0.3, 2.0), (1.0, 0.3, 4.0), (-2.2, 0.3, 8.0))
    path = torch.stack((slow, quick)).unsqueeze(0)
    result = measure(made(path, gate=GATE, pref_speed=torch.tensor([[0.9, 1.3]])))[0]
    assert result["yield_delay_s"] == pytest.approx(5.25 - 2.0)
    assert result["faster_first"] == 1.0
    assert result["yielder_speed_m_per_s"] == pytest.approx(0.0, abs=1e-6)
    assert result["specific_flow_per_m_s"] == pytest.approx(2 / (0.85 * 3.25))
    alone = measure(made(path[:, :1], gate=GATE))[0]
    assert not {"symmetry_index", "yield_delay_s", "faster_first", "specific_flow_per_m_s"} & set(alone)
    assert "symmetry_index" not in measure(made(path))[0]


def test_no_person_yields_where_orca_walks_in_mirror_images() -> None:
    policy, alike = "orca:radius=0.1,jitter=0,dt=0.4", "door:speed_std=0,jitter=0"
    walked, _ = rollout(policy, alike, "compiled", 1)
    result = measure(walked)[0]
    assert result["success"] == 1.0
    assert result["symmetry_index"] < 1e-3 and result["yield_delay_s"] < 1e-3 and result["symmetry_m"] < 1e-3
    assert "faster_first" not in result  # they like to walk as fast as each other
    yields, _ = rollout(policy, f"{alike},speed_ratio=0.6", "compiled", 1)
    result = measure(yields)[0]
    assert result["faster_first"] == 1.0 and result["symmetry_index"] > 0.1 and result["yield_delay_s"] > 1.0


def test_who_slides_along_the_wall_while_waiting_drifts() -> None:
    """0.3 m to the left before the door, then through; who only walks through does not wait."""
    up = torch.tensor([[-1.0, 0.0]]) + torch.arange(6).view(-1, 1) * torch.tensor([[0.0, 0.06]])
    on = torch.tensor([[-1.0, 0.3]]) + torch.arange(1, 16).view(-1, 1) * torch.tensor([[0.1, 0.0]])
    slides = torch.cat((up, on)).double()
    path = torch.stack((slides, straight(1.3, 20, (-1.0, 0.1)))).unsqueeze(0)
    metres, waits = door.wall_drift(path, scored(path), GATE, torch.tensor([[1.5, 0.8]]))
    assert waits.tolist() == [[True, False]] and metres[0].tolist() == pytest.approx([0.3, 0.0])


def test_people_wait_within_a_metre_and_a_half_before_the_door() -> None:
    """Who has begun on this side, and stands beyond the wall later, does not wait there."""
    stands = (
        torch.tensor([[-1.4, 0.1], [-1.6, 0.1], [0.2, 0.1]]).double().view(1, 3, 1, 2).repeat(1, 1, 11, 1)
    )
    stands[..., 0, 0] = -2.0
    stands[..., 1:, 1] += 0.05 * torch.arange(10)
    metres, there = door.wall_drift(stands, scored(stands), GATE, torch.full((1, 3), 9.0))
    assert there.tolist() == [[True, False, False]] and metres[0].tolist() == pytest.approx([0.45, 0, 0])
    assert not door.wall_drift(stands, ~scored(stands), GATE, torch.full((1, 3), 9.0))[1].any()


def test_a_right_angle_at_speed_is_a_sharp_turn() -> None:
    """Moments 0.4 s apart on both sides of the corner count; a person who slows down for it turns none."""
    east, north = torch.tensor([0.1, 0.0]).double(), torch.tensor([0.0, 0.1]).double()
    steps = torch.stack((*[east] * 10, *[north] * 10))
    slow = torch.stack((*[east] * 8, *[0.3 * east] * 4, *[0.3 * north] * 4, *[north] * 4))
    path = torch.cat((torch.zeros(2, 1, 2).double(), torch.stack((steps, slow)).cumsum(1)), 1).unsqueeze(0)
    turns, walks = door.sharp(path, scored(path), GATE)
    assert turns.sum(2).tolist() == [[4, 0]] and walks[0, 0].all()
    far = path - torch.tensor([4.5, 0.0])  # the corner is 3.5 m from the door
    assert not door.sharp(far, scored(far), GATE)[0].any()


def test_interventions_are_those_of_policies_with_a_layer() -> None:
    """By hand: of 4 steps one is changed by 0.1 m and one by 1 cm; a policy without a layer has no number."""
    path = torch.stack((straight(points=8), straight(points=8) + 3)).unsqueeze(0)
    changed = torch.tensor([[[0.1] * 4 + [0.01] * 4, [0.0] * 8]])
    result = measure(made(path, changed=changed))[0]
    assert result["intervention_share"] == 0.25 and result["intervention_m"] == pytest.approx(0.11 / 4)
    assert "intervention_m" not in measure(made(path))[0]


def test_the_layer_does_much_for_those_who_do_not_avoid_others() -> None:
    """Two who walk straight at each other at a door."""
    walked, _ = rollout("go_to_goal:safety=true", "door", "compiled", 1)
    assert 0.05 < measure(walked)[0]["intervention_share"] < 1


@pytest.mark.parametrize("name", ["door", "room_exit"])
def test_gates_are_as_wide_as_the_free_cells_between_the_jambs(name: str) -> None:
    scenario = SCENARIOS.get(name)(width=[0.75, 0.9, 1.2])
    prepared = scenario.prepare(0.25)
    draws = Draws.for_episodes(0, torch.arange(12))
    gates = scenario.gate(draws)
    rows = prepared.bank.index(prepared.layout(draws).map_id)
    assert gates is not None and len(set(gates[:, 4].tolist())) == 3
    for gate, row in zip(gates, rows.tolist(), strict=True):
        grid = prepared.bank.grids[row]
        x0, y0, _ = grid.origin
        wall = grid.cells[:, math.floor((float(gate[0]) - x0) / grid.resolution + 1e-6)]
        free = [y0 + (i + 0.5) * grid.resolution for i, cell in enumerate(wall) if cell == 0]
        inside = [y for y in free if abs(y) < 1.5]
        assert len(inside) * grid.resolution == pytest.approx(float(gate[4]))
        assert sum(inside) / len(inside) == pytest.approx(float(gate[1]), abs=1e-6)
    assert gates[:, 2:4].tolist() == [[1.0, 0.0]] * 12
