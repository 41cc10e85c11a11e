"""Realism against values computed by hand, scipy's, and crowds whose faults are known."""

import json
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.walks import made
from scipy.stats import wasserstein_distance
from tensordict import TensorDictBase

from pedzoo.core.geometry import rotate
from pedzoo.eval.realism import reference_rows, replay_row
from pedzoo.eval.rollout import prepare, walk
from pedzoo.metrics.contacts import time_to_collision
from pedzoo.metrics.ratios import drawn_people
from pedzoo.metrics.realism import crowds
from pedzoo.metrics.realism.crowds import (
    CrowdSums,
    added,
    contact_intervals,
    crowd,
    densities,
    density_speed,
    main_axis,
    measured,
    only,
    together,
)
from pedzoo.metrics.realism.distances import (
    Samples,
    closed_loop_error,
    counted,
    dtw,
    grid,
    halves,
    padded,
    resampled,
    wasserstein,
)
from pedzoo.metrics.realism.features import SampledRollout, every_step, features, surroundings
from pedzoo.metrics.realism.walks import by_person, of_people, tracks_of, walks_of
from pedzoo.metrics.realism.wosac import step_values
from pedzoo.policies.rule_based.go_to_goal import GoToGoal
from pedzoo.sim.rollout import Rollout, joined
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay

NAN = float("nan")


def a_rollout(positions: torch.Tensor, person: torch.Tensor, controlled: torch.Tensor) -> Rollout:
    """Walks of (E, A, S, 2) every 0.4 s, straight in between; the first position is where the episode begins.

    ``person`` (E, A, S - 1) says who is there until each further position, ``controlled`` whom a policy
    moves.
    """
    part = torch.arange(1, 5).view(4, 1) / 4
    dense = positions[:, :, :-1, None] * (1 - part) + positions[:, :, 1:, None] * part
    path = torch.cat((positions[:, :, :1], dense.flatten(2, 3)), 2)
    person, controlled = (value.repeat_interleave(4, 2) for value in (person, controlled))
    return made(path, person >= 0, controlled=controlled, person=person, mask=person[..., 0] >= 0)


def line(*points: tuple[float, float]) -> torch.Tensor:
    return torch.tensor(points)


def found_features(rollout: Rollout, start: torch.Tensor, goal: torch.Tensor) -> dict[str, list[float]]:
    steps = every_step(rollout)
    samples = features(steps, surroundings(steps), start, goal)
    return {name: sorted(value.tolist()) for name, (value, _) in samples.items()}


def test_wasserstein_is_how_far_values_are_moved() -> None:
    values = [torch.tensor(value) for value in ([0.0, 1.0], [3.0, 0.0], [1.0] * 3, [])]
    # 1 becomes 3, 0 stays; two halves move by 1; of nothing there is no distance
    assert [float(wasserstein(values[0], other)) for other in values[1:]] == pytest.approx([1.0, 0.5, 0.0])


@pytest.mark.parametrize("size", [40, 512])
@pytest.mark.parametrize("shape", ["normal", "long tail", "capped", "few values"])
def test_resamples_are_within_the_bound_of_the_exact_distance(shape: str, size: int) -> None:
    generator = torch.Generator().manual_seed(0)
    people, sides = 30, []
    for spread, shift in ((1.0, 0.0), (1.3, 0.1)):
        value = torch.randn(2000, generator=generator).double() * spread + shift
        if shape in ("long tail", "capped"):
            value = (2 * value).exp()
        value = {"capped": value.clamp(max=10.0), "few values": value.round()}.get(shape, value)
        sides.append(Samples(value, torch.randint(people, (2000,), generator=generator)))
    edges = grid(sides[0].value, sides[1].value, size)
    assert len(edges) <= size and (edges.diff() > 0).all()
    low, high = (float(end) for end in torch.cat([side.value for side in sides]).aminmax())
    assert np.isin(np.linspace(low, high, size // 4), edges).all() or len(edges) < size // 2
    first, second = (counted(side, edges, people) for side in sides)
    weights = torch.cat((torch.ones(1, people).double(), drawn_people(people, 5)))
    distance = resampled(first, second, edges, weights, weights)
    # within a cell that holds shares p and q the distributions' distance is within max(p, q) of that at its
    # ends, for weights of 1; values on edges are exact
    both = (first, second)
    inside = [(before[:, 1:] - until[:, :-1]).sum(0) / until[:, -1].sum() for until, before in both]
    bound = float(torch.maximum(*inside) @ edges.diff())
    for weight, value in zip(weights, distance.tolist(), strict=True):
        values = (*(side.value for side in sides), *(weight[side.person] for side in sides))
        exact = wasserstein_distance(*values)
        # weights of people up to 4 can make cells heavier than the bound of equal weights says
        assert value == pytest.approx(exact, abs=max(bound * float(weight.max()), 1e-9))
        if size == 512:
            assert value == pytest.approx(exact, rel=0.01)
    if shape == "few values":
        assert bound == 0.0


def test_both_sides_draw_the_same_people() -> None:
    drawn, split = drawn_people(7, 50), halves(7, 50)
    assert (drawn.sum(1) == 7).all() and (drawn.std(0) > 0).all()
    assert set(split.unique().tolist()) == {0.0, 1.0} and (split.sum(1) == 3).all()
    assert torch.equal(drawn, drawn_people(7, 50)) and torch.equal(split, halves(7, 50))
    assert not torch.equal(drawn, drawn_people(7, 50, seed=1))
    side = Samples(torch.rand(40).double(), torch.arange(40) % 7)
    edges = grid(side.value, side.value)
    both = counted(side, edges, 7)
    assert (resampled(both, both, edges, drawn, drawn) == 0).all()
    assert (resampled(both, both, edges, split, 1 - split) > 0).all()


def test_features_of_a_corner() -> None:
    walk = line((0, 0), (0.4, 0), (0.8, 0), (0.8, 0.4), (0.8, 0.4), (0.8, 0.42))[None, None]
    neighbours = torch.zeros(1, 1, 5).long()
    # the policy takes over after the first step
    controlled = torch.tensor([[[False, True, True, True, True]]])
    result = found_features(a_rollout(walk, neighbours, controlled), line((0.4, 0)), line((3.4, 0)))
    assert result["speed"] == pytest.approx([0.0, 0.05, 1.0, 1.0])
    # straight on, a corner, a stop, a creep
    assert result["acceleration"] == pytest.approx([0.0, 0.125, 2.5, 2.5 * 2**0.5], abs=1e-5)
    assert result["heading_rate"] == pytest.approx([0.0, torch.pi / 2 / 0.4], abs=1e-5)
    assert result["lateral_deviation"] == pytest.approx([0.0, 0.4, 0.4, 0.42], abs=1e-6)
    assert result["nearest_distance"] == result["time_to_collision"] == []  # alone


def test_played_back_people_are_met_and_not_scored() -> None:
    one = line((0, 0), (0.4, 0), (0.8, 0), (1.2, 0))
    # comes the other way, leaves after the first step; its slot is taken by a person far away
    other = line((4, 0), (3.6, 0), (9, 9), (9, 8.6))
    person = torch.tensor([[[0, 0, 0], [1, 2, 2]]])
    controlled = torch.tensor([[[True, True, True], [False, True, True]]])
    rollout = a_rollout(torch.stack((one, other))[None], person, controlled)
    steps = every_step(rollout)
    around = surroundings(steps)
    # the newcomer has no velocity in the first step
    assert steps.person[steps.scored].tolist() == [0, 0, 0, 2]
    far = [(8.2**2 + 81) ** 0.5, (7.8**2 + 8.6**2) ** 0.5]
    assert around.place[:, 0].norm(dim=1).tolist() == pytest.approx([3.2, far[0], far[1], far[1]])
    # 3.2 m apart at 2 m/s, they touch after 2.9 m; the velocity of a newcomer is not known
    assert around.collision.tolist() == pytest.approx([1.45, 10.0, 10.0, 10.0])
    assert around.close.tolist() == [0, 0, 0, 0]


def test_surroundings_are_those_of_the_safety_metrics() -> None:
    generator = torch.Generator().manual_seed(3)
    positions = torch.rand(3, 6, 12, 2, generator=generator).cumsum(2) * 0.5
    person = torch.arange(6).view(1, 6, 1).expand(3, 6, 11).clone()
    person[1, 4:] = -1
    controlled = (torch.rand(3, 6, 11, generator=generator) > 0.4) & (person >= 0)
    controlled[..., 0] = person[..., 0] >= 0
    steps = every_step(a_rollout(positions, person, controlled))
    around = surroundings(steps)
    there = steps.person >= 0
    expected = time_to_collision(steps.xy, steps.velocity, there & steps.known)
    assert around.collision.tolist() == pytest.approx(expected[steps.scored].tolist(), abs=1e-4)
    apart = torch.cdist(steps.xy.transpose(1, 2), steps.xy.transpose(1, 2)).transpose(1, 2)
    apart = apart.masked_fill(~there.transpose(1, 2).unsqueeze(1), torch.inf)
    apart = apart.masked_fill(torch.eye(6).bool().view(1, 6, 1, 6), torch.inf)
    assert around.place[:, 0].norm(dim=1).tolist() == pytest.approx(apart.amin(-1)[steps.scored].tolist())
    assert around.close.tolist() == (apart < 2.0).sum(-1)[steps.scored].tolist()
    assert (around.collision < 10).float().mean() > 0.2


def test_features_do_not_depend_on_the_frame_or_on_slots() -> None:
    generator = torch.Generator().manual_seed(5)
    positions = torch.randn(2, 5, 9, 2, generator=generator).cumsum(2) * 0.3
    person = torch.arange(10).view(2, 5, 1).expand(2, 5, 8)
    controlled = torch.rand(2, 5, 8, generator=generator) > 0.3
    start, goal = positions[:, :, 0].flatten(0, 1), positions[:, :, -1].flatten(0, 1)
    base = found_features(a_rollout(positions, person, controlled), start, goal)
    turn = torch.tensor([[0.6, -0.8], [0.8, 0.6]])
    moved = [value @ turn.T + torch.tensor([5.0, -3.0]) for value in (positions, start, goal)]
    turned = found_features(a_rollout(moved[0], person, controlled), moved[1], moved[2])
    order = torch.tensor([3, 1, 4, 0, 2])
    mixed = a_rollout(positions[:, order], person[:, order], controlled[:, order])
    shuffled = found_features(mixed, start, goal)
    for name, values in base.items():
        assert len(values) > 20
        assert turned[name] == pytest.approx(values, abs=2e-3)
        assert shuffled[name] == pytest.approx(values)


def test_speeds_by_density() -> None:
    # three stand in a row 1 m apart, a fourth walks far away
    place = torch.tensor([[0.0, 0.0], [1.0, 0.0], [2.5, 0.0], [50.0, 0.0]])
    positions = place.view(1, 4, 1, 2).repeat(1, 1, 3, 1)
    positions[0, 3, :, 0] += torch.tensor([0.0, 0.4, 0.8])
    positions[0, 1, :, 1] += torch.tensor([0.0, 0.08, 0.16])
    person = torch.arange(4).view(1, 4, 1).expand(1, 4, 2)
    rollout = a_rollout(positions, person, person >= 0)
    steps = every_step(rollout)
    result = crowd(rollout, steps, surroundings(steps), 0, 1, place, place)
    speed, count = density_speed(result, torch.ones(1, 4).double())
    assert count[0, :4].tolist() == [2, 4, 2, 0]
    assert speed[0, :3].tolist() == pytest.approx([1.0, 0.0, 0.2], abs=1e-5)
    assert densities()[:2].tolist() == pytest.approx([0.0796, 0.1592], abs=1e-4)
    assert result.minutes.tolist() == pytest.approx([0.8 / 60] * 4)
    both = together([result, crowd(rollout, steps, surroundings(steps), 1, 1, place, place)])
    assert both.minutes.tolist() == pytest.approx([1.6 / 60] * 4) and both.round.unique().tolist() == [0, 1]
    some = only(both, torch.tensor([True, False, True, True]))
    assert set(some.samples["speed"].person.tolist()) == {0, 2, 3} and len(some.round) == 12


def test_walks_are_compared_while_both_last() -> None:
    result, length = padded(torch.arange(10.0).view(5, 2), torch.tensor([1, 0, 1, 1, 0]), 3)
    assert length.tolist() == [2, 3, 0]
    assert result[..., 0].tolist() == [[2, 8, 0], [0, 4, 6], [0, 0, 0]]
    walk = torch.tensor([1.0, 2.0, 3.0, 9.0]).view(1, 4, 1) * torch.tensor([0.6, 0.8])
    error = closed_loop_error(walk.expand(2, 4, 2), torch.zeros(2, 3, 2), torch.tensor([3, 0]))
    assert error[0] == pytest.approx(2.0) and error[1].isnan()


def test_dtw_is_that_of_a_plain_loop(monkeypatch) -> None:
    generator = torch.Generator().manual_seed(1)
    points, others = (torch.randint(0, most, (25,), generator=generator) for most in (9, 14))
    points[:2], others[:2] = torch.tensor([5, 0]), torch.tensor([0, 5])
    first, second = (torch.randn(25, most, 2, generator=generator) for most in (9, 14))
    alike = torch.arange(25).expand(2, -1)

    def plain(a: np.ndarray, b: np.ndarray) -> float:
        cost = np.full((len(a) + 1, len(b) + 1), np.inf)
        cost[0, 0] = 0
        for i in range(len(a)):
            for j in range(len(b)):
                d = np.linalg.norm(a[i] - b[j])
                cost[i + 1, j + 1] = min(cost[i, j] + 2 * d, cost[i, j + 1] + d, cost[i + 1, j] + d)
        return cost[-1, -1] / (len(a) + len(b)) if len(a) and len(b) else NAN

    expected = [plain(first[i, : points[i]].numpy(), second[i, : others[i]].numpy()) for i in range(25)]
    result = dtw(first, points, second, others, alike)
    assert result.tolist() == pytest.approx(expected, abs=1e-5, nan_ok=True)
    assert dtw(first, points, first, points, alike).nansum() == 0
    monkeypatch.setattr("pedzoo.metrics.realism.distances._AT_ONCE", 500)
    assert torch.equal(dtw(first, points, second, others, alike).nan_to_num(), result.nan_to_num())


def test_walks_of_two_rounds() -> None:
    there = line((0, 0), (0.4, 0), (0.8, 0), (1.2, 0), (1.6, 0), (2, 0))
    still = torch.zeros(6, 2)
    person = torch.tensor([[[0] * 5], [[1] * 5]])
    controlled = torch.tensor([[[False, True, True, True, True]], [[True] * 5]])
    up = torch.stack((still[:, 0], torch.linspace(0, 5, 6)), -1)
    arrived = torch.zeros(2, 1, 20).long()
    arrived[0, 0, 17:] = arrived[1, 0, 18:] = 1
    real = replace(a_rollout(torch.stack((there, up))[:, None], person, controlled), reached=arrived)
    slow = there * 0.5
    # three scenes: the second round was not finished
    walks = torch.stack((slow, up, there))[:, None]
    reached = torch.stack((arrived[0] * 0, arrived[1], arrived[0]))
    rollout = a_rollout(walks, torch.cat((person, person[:1])), controlled[[0, 1, 0]])
    rollout = replace(rollout, reached=reached)
    tracks = tracks_of([real.episodes(slice(1)), real.episodes(slice(1, 2))], 3)
    # the step in which they arrive is no sample
    assert tracks.scene.tolist() == [0, 1, -1] and tracks.points.tolist() == [3, 4, 0]
    assert tracks.seconds.tolist() == pytest.approx([1.4, 1.9, NAN], nan_ok=True)
    result = walks_of(rollout, every_step(rollout), 4, 2, tracks)
    result = {name: values.tolist() for name, values in result.items()}
    assert (result["episode"], result["person"]) == ([4, 5, 6], [0, 1, 0])
    assert result["seconds"] == pytest.approx([NAN, 1.9, 1.4], nan_ok=True)
    assert result["ade"] == pytest.approx([(0.4 + 0.6 + 0.8) / 3, 0.0, 0.0])
    assert result["dtw"][1:] == [0.0, 0.0] and result["dtw"][0] > 0.1
    table = by_person(walks_of(rollout, every_step(rollout), 0, 2, tracks), 2, 3)["ade"]
    assert table.tolist()[1] == pytest.approx([0.0, NAN, NAN], nan_ok=True) and len(table) == 2


def test_numbers_of_people_are_weighted() -> None:
    seconds = torch.tensor([[2.0, 6.0, NAN, 9.0], [4.0, 6.0, NAN, NAN]]).double()
    success = torch.tensor([[1.0, 1.0, 0.0, 1.0], [1.0, 1.0, 0.0, NAN]]).double()
    ade = torch.tensor([[1.0, 2.0, NAN, 8.0], [3.0, 1.0, NAN, NAN]]).double()
    tables = {"success": success, "deadlock": success, "seconds": seconds, "ade": ade, "dtw": ade}
    weights = torch.tensor([[1.0, 1.0, 1.0, 1.0], [3.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0]]).double()
    found = of_people(tables, torch.full((4,), 2.0).double(), weights)
    result = {key: value.tolist() for key, value in found.items()}
    # ratios are 1 and 2 (the lower is taken), 3, none, 4.5
    assert result["time_ratio_median"][:2] == [3.0, 1.0] and np.isnan(result["time_ratio_median"][2])
    assert result["success"] == pytest.approx([5 / 7, 7 / 9, 0.0])
    assert result["closed_loop_ade_m"][:2] == pytest.approx([(2 + 1.5 + 8) / 3, (6 + 8) / 4])
    assert result["closed_loop_min_ade_2_m"][0] == pytest.approx((1 + 1 + 8) / 3)


def abreast(steps: int = 10) -> SampledRollout:
    """Two who walk 1 m apart at 1 m/s, one who stands 5 m beside, and one who walks towards them."""
    time = 0.4 * torch.arange(steps)
    nothing = torch.zeros(steps)
    walks = [(time, nothing), (time, nothing + 1), (nothing, nothing + 5), (4 - time, nothing + 0.2)]
    xy = torch.stack([torch.stack(walk, 1) for walk in walks])
    person = torch.arange(4).view(1, 4, 1).expand(1, 4, steps)
    known = torch.ones(1, 4, steps, dtype=torch.bool)
    known[..., 0] = False
    velocity = torch.cat((torch.zeros(4, 1, 2), xy.diff(dim=1) / 0.4), 1)[None]
    return SampledRollout(xy[None], person, velocity, known, known, torch.full((1, 4), 0.15))


def test_company_standing_touching_and_lanes_by_hand() -> None:
    result = measured(abreast(), 4, torch.tensor([1.0, 0.0]))
    each = {name: (sums[0] / sums[1]).tolist() for name, sums in result.items()}
    assert each["standing_share"] == [0, 0, 1, 0]
    # of nine scored steps those from the eighth place on, the seventh step
    assert each["company_share"] == pytest.approx([3 / 9, 3 / 9, 0, 0])
    # at 1.8 and 2.2 s they are 0.2 m aside and 0.4 m apart or less: never nearer than 0.2 m
    assert each["crowdes_collision"] == [0, 0, 0, 0]
    near = abreast()
    near.xy[0, 1] = near.xy[0, 0] + torch.tensor([0.0, 0.19])
    again = measured(near, 4, torch.tensor([1.0, 0.0]))["crowdes_collision"]
    assert again.tolist() == [[9, 9, 0, 1], [9] * 4]
    assert crowds.ratios(again, torch.tensor([[1.0, 0.0, 1.0, 0.0]])).tolist() == [0.5]
    # pairs of walkers at a moment: 2 of 6 walk the same way; in the strip of 0 to 0.6 m none of 2 does
    assert result["lane_order"][0].tolist() == pytest.approx([-9 / 3, 0, 0, -9 / 3])
    assert result["lane_order"][1].tolist() == pytest.approx([9 * 2 / 3, 0, 0, 9 * 2 / 3])
    assert added([result, result])["lane_order"][1, 0] == pytest.approx(12)
    # the main axis is of either way
    start = torch.tensor([[0.0, 0.0], [3.0, 3.0], [0.0, 0.0]])
    goal = torch.tensor([[2.0, 2.0], [0.0, 0.0], [0.1, -0.1]])
    assert main_axis(start, goal).abs().tolist() == pytest.approx([0.5**0.5] * 2)


def test_company_needs_eight_steps_of_the_same_two() -> None:
    steps = abreast(8)
    axis = torch.tensor([1.0, 0.0])
    assert measured(steps, 5, axis)["company_share"][0].tolist() == [1, 1, 0, 0, 0]
    assert measured(abreast(7), 5, axis)["company_share"][0].tolist() == [0] * 5
    person = steps.person.clone()
    person[0, 1, 3] = 4  # another one in the slot for a moment
    assert measured(steps._replace(person=person), 5, axis)["company_share"][0].sum() == 0
    steps.xy[0, 1, 0, 0] += 0.51  # has come nearer since
    assert measured(steps, 5, axis)["company_share"][0].sum() == 0


def test_values_of_steps_have_signs_and_no_heading_at_rest() -> None:
    place = torch.tensor([[0.0, 0], [0.4, 0], [0.8, 0], [0.8, 0.8], [0.8, 0.8], [0.8, 0.4]]).view(1, 1, 6, 2)
    velocity = torch.cat((torch.zeros(1, 1, 1, 2), place.diff(dim=2) / 0.4), 2)
    known = torch.tensor([[[False, True, True, True, True, True]]])
    person = torch.zeros(1, 1, 6, dtype=torch.long)
    steps = SampledRollout(place, person, velocity, known, known, torch.full((1, 1), 0.15))
    wall = torch.arange(6.0).view(1, 1, 6)
    values = {name: value.flatten().tolist() for name, value in step_values(steps, wall).items()}
    assert values["speed"] == pytest.approx([NAN, 1, 1, 2, 0, 1], nan_ok=True)
    assert values["acceleration"] == pytest.approx([NAN, NAN, 0, 2.5, -5, 2.5], nan_ok=True)
    quarter = torch.pi / 2 / 0.4
    assert values["turn_rate"] == pytest.approx([NAN, NAN, 0, quarter, NAN, NAN], nan_ok=True)
    assert values["turn_acceleration"] == pytest.approx([NAN] * 3 + [quarter / 0.4] + [NAN] * 2, nan_ok=True)
    assert values["wall_distance"][1:] == [1, 2, 3, 4, 5] and np.isnan(values["nearest_distance"]).all()


def test_people_of_one_speed_have_no_spread() -> None:
    """Rounding makes their variance negative on some processors: it is 0 all the same."""
    value, weights = torch.full((1, 7), 0.05, dtype=torch.float64), torch.ones(1, 7, dtype=torch.float64)
    alike = {"speed": Samples(value[0], torch.arange(7))}
    crowd = CrowdSums(alike, weights[0], value, value, torch.zeros(7).long(), value, value)
    assert crowds._speed_spread(crowd, weights).tolist() == pytest.approx([0.0], abs=1e-8)


def touching(people: int) -> CrowdSums:
    """A crowd of 20 people, of whom some touch others for half of their minute."""
    touch = (torch.arange(20) < people).double()
    zero = torch.zeros(20, 3).double()
    contact = torch.stack((touch / 2, touch))
    return CrowdSums({}, torch.ones(20).double(), contact, 0 * contact, torch.zeros(0), zero, zero)


@pytest.mark.parametrize(("people", "known"), [((5, 4), False), ((5, 5), True)])
def test_contacts_of_few_people_have_no_excess(people: tuple[int, int], known: bool) -> None:
    found = contact_intervals(touching(people[0]), touching(people[1]), torch.arange(20), 20)
    assert ("agent_contact_excess" not in found) == known and found["wall_contact_excess"] is None
    low, high = found["agent_contact_share"] or (0, 0)
    assert low < 5 / 2 / 20 < high and found["wall_contact_share"] is None
    low, high = found["agent_contacts_per_min"] or (0, 0)
    assert low < 5 / 20 < high


class Swaying(GoToGoal):
    """People go to their goals with a share of their speed, swaying by an angle to either side."""

    share, angle = 1.0, torch.pi / 3

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        wanted = self.share * cast("torch.Tensor", tensordict["agents", "desired_velocity"])
        angle = self.angle * torch.sin(5 * cast("torch.Tensor", tensordict["time"]))
        direction = torch.cat((angle.cos(), angle.sin()), dim=1).unsqueeze(1).expand_as(wanted)
        tensordict["agents", "action"] = rotate(wanted, direction)
        return tensordict


Rows = dict[str, dict[str, Any]]


def row_of(replay: PreparedReplay, policy: GoToGoal | None = None) -> tuple[Rollout, dict[str, Any]]:
    """Return what a policy does in a replay, by default who goes to the goal, and its row."""
    usual, env = prepare("go_to_goal", replay, "compiled", replay.scenes)
    rollout = joined(list(walk(policy or usual, env, replay.scenes)))
    return rollout, replay_row("go_to_goal", rollout, replay, 0.4)


@pytest.fixture(scope="module")
def few() -> tuple[PreparedReplay, Rollout, dict[str, float]]:
    """Those who come first on the plaza, and what becomes of them when they go to their goals."""
    replay = Replay(fold="embedded", share=0.2).prepare(0.25)
    rollout, row = row_of(replay)
    return replay, rollout, row["metrics"]


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Rows of everybody on the embedded plaza: the real crowd, its halves, and a baseline."""
    plaza = Replay(fold="embedded").prepare(0.25)
    return {row["name"]: row for row in (*reference_rows(plaza), row_of(plaza)[1])}


def test_the_real_crowd_is_at_no_distance_from_itself(rows: Rows) -> None:
    real, halves = rows["real"], rows["real halves"]
    away = [key for key in real["metrics"] if key.startswith("w1_") or "excess" in key or "rmse" in key]
    assert len(away) == 17
    for key in [*away, "realism", "closed_loop_ade_m", "dtw_m"]:
        assert real["metrics"][key] == 0.0 and key not in real["ci95"]
    assert real["metrics"]["success"] == 1.0 and real["metrics"]["time_ratio_median"] == 1.0
    for key in ("acceleration_p95_ratio", "acceleration_p99_ratio"):
        assert real["metrics"][key] == 1.0 and key not in real["ci95"]
        assert halves["metrics"][key] == pytest.approx(1.0, abs=0.2)
    # what is no comparison is that of the crowd
    for key in ("speed_std_m_per_s", "agent_contact_share"):
        assert halves["metrics"][key] == pytest.approx(real["metrics"][key], rel=0.3)
    assert real["n"] == halves["n"] == len(real["per_agent"])
    # no policy is nearer than they are
    floor, (low, high) = halves["metrics"]["realism"], halves["ci95"]["realism"]
    assert 0 < low < floor < high and rows["go_to_goal"]["metrics"]["realism"] > floor


def test_bad_policies_are_caught(few: tuple[PreparedReplay, Rollout, dict[str, float]]) -> None:
    replay, _, sober = few
    still = Swaying()
    still.share = 0.0
    frozen = row_of(replay, still)[1]["metrics"]
    drunk = row_of(replay, Swaying())[1]["metrics"]
    for key in ("w1_speed", "density_speed_rmse_m_per_s", "closed_loop_ade_m"):
        assert frozen[key] > 3 * sober[key]
    assert frozen["success"] == 0.0 and frozen["deadlock"] > 0.5 and frozen["speed_std_m_per_s"] == 0.0
    # no person arrives, no person has a heading
    assert "time_ratio_median" not in frozen and "w1_heading_rate" not in frozen
    for key in ("w1_heading_rate", "w1_acceleration", "realism"):
        assert drunk[key] > 3 * sober[key]
    assert drunk["acceleration_p95_ratio"] > 3 and drunk["acceleration_p99_m_per_s2"] > 1
    # every person is where they really were, except that they jump by 3 m and back every 2 s
    real = replay.real()
    away = (torch.arange(real.trace.shape[2]) // 20 % 2).view(1, 1, -1, 1) * torch.tensor([3.0, 0.0])
    jumps = replace(real, trace=real.trace + away * real.controlled.unsqueeze(-1))
    teleporting = replay_row("teleporting", jumps, replay, 0.4)["metrics"]
    assert all(teleporting[key] > 3 * sober[key] for key in ("w1_acceleration", "w1_speed"))


def test_a_row_says_who_did_what_and_how_sure_it_is(rows: Rows) -> None:
    row = rows["go_to_goal"]
    metrics, intervals, people = row["metrics"], row["ci95"], row["per_agent"]
    assert row["n"] == len(people) == len({(one["recording"], one["agent"]) for one in people})
    assert sum(one["success"] for one in people) / row["n"] == pytest.approx(metrics["success"])
    ade = np.mean([one["closed_loop_ade_m"] for one in people])
    assert ade == pytest.approx(metrics["closed_loop_ade_m"], abs=1e-3)
    for key, (low, high) in intervals.items():
        assert low < high
        if key in ("realism", "closed_loop_ade_m", "dtw_m", "success", "w1_acceleration") or "_p9" in key:
            assert low <= metrics[key] <= high + 1e-9
    assert sum(bin["real_share"] for bin in row["density_speed"]) == pytest.approx(1.0, abs=1e-3)
    json.dumps(row, allow_nan=False)


def test_rounds_and_the_first_scenes_alone(few: tuple[PreparedReplay, Rollout, dict[str, float]]) -> None:
    replay, once, metrics = few
    twice = replay_row("twice", joined([once, once]), replay, 0.4)
    assert twice["rounds"] == 2 and twice["n"] == len(twice["per_agent"])
    for key, value in metrics.items():
        assert twice["metrics"][key] == pytest.approx(value, abs=1e-9)
    assert twice["metrics"]["closed_loop_min_ade_2_m"] == pytest.approx(metrics["closed_loop_ade_m"])
    # the second round stands still: half as good, but for the best of both
    still = replace(once, trace=once.trace[:, :, :1].expand_as(once.trace), reached=once.reached * 0)
    mixed = replay_row("mixed", joined([once, still]), replay, 0.4)["metrics"]
    assert mixed["success"] == pytest.approx(metrics["success"] / 2)
    assert mixed["closed_loop_ade_m"] > 2 * metrics["closed_loop_ade_m"]
    assert mixed["closed_loop_min_ade_2_m"] <= metrics["closed_loop_ade_m"]


def test_one_person_among_recorded_ones() -> None:
    replay = Replay(fold="embedded", simulated="one", share=0.1).prepare(0.25)
    result = {row["name"]: row["metrics"] for row in reference_rows(replay)}
    rollout, row = row_of(replay)
    assert row["n"] == replay.scenes and row["metrics"]["success"] > 0.9
    assert result["real"]["realism"] == 0.0 and row["metrics"]["realism"] > 0
    parts = (rollout.episodes(slice(i, i + 3)) for i in range(0, replay.scenes, 3))
    assert replay_row("go_to_goal", parts, replay, 0.4)["metrics"] == pytest.approx(row["metrics"])
    # the scenes that were run are those that count
    first = replay_row("first", rollout.episodes(slice(3)), replay, 0.4)
    persons = {one["person"] for one in first["per_agent"]}
    assert first["n"] == 3
    assert first["per_agent"] == [one for one in row["per_agent"] if one["person"] in persons]
