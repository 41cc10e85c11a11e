"""The classifier two-sample test against crowds that are equal, shuffled or plainly different."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pedzoo.metrics.realism.features import (
    CHANNELS,
    LENGTH,
    Clips,
    SampledRollout,
    clips,
    coarse,
    surroundings,
    to_millimetres,
)
from pedzoo.metrics.realism.two_sample import FOLDS, TREES, Verdict, auc, boosted, nearest_parts, two_sample


@pytest.fixture(autouse=True)
def few_trees(monkeypatch) -> None:
    monkeypatch.setitem(TREES, "max_iter", 10)


def steps_of(xy: torch.Tensor, scored_from: int = 1) -> SampledRollout:
    """Steps of people (A, S, 2) who are there all the time, and scored from a step on."""
    people, length = xy.shape[:2]
    there = torch.ones(1, people, length, dtype=torch.bool)
    known, scored = there.clone(), there.clone()
    known[..., 0], scored[..., :scored_from] = False, False
    velocity = torch.zeros(1, people, length, 2)
    velocity[:, :, 1:] = xy.diff(dim=1) / 0.4
    person = torch.arange(people).view(1, -1, 1).expand(1, people, length)
    return SampledRollout(xy.unsqueeze(0), person, velocity, known, scored, torch.full((1, people), 0.15))


def clips_of(xy: torch.Tensor, start: torch.Tensor, goal: torch.Tensor) -> Clips:
    """Clips of people (A, S, 2) who are scored from the third step on."""
    steps = steps_of(xy, 2)
    return clips(steps, surroundings(steps), start, goal)


@pytest.mark.parametrize("column", range(3))
@pytest.mark.parametrize("bump", [False, True])
def test_trees_learn_a_step_or_a_bump_and_say_by_which_feature(column: int, bump: bool) -> None:
    generator = np.random.default_rng(0)
    rows, test = generator.normal(size=(2000, 3)), generator.normal(size=(1000, 3))
    labels = [(abs(one[:, column]) > 0.6 if bump else one[:, column] > 0.3) for one in (rows, test)]
    odds, gain = boosted(rows, labels[0].astype(float), np.ones(len(rows)), test)
    assert ((odds > 0) == labels[1]).mean() > 0.96
    assert gain.argmax() == column and gain[column] > 0.9 * gain.sum()


def test_auc_counts_pairs_with_ties_as_half() -> None:
    odds, simulated = torch.tensor([2.0, 1.0, 1.0, 0.0]), torch.tensor([True, True, False, False])
    verdict = Verdict(odds, simulated, torch.tensor([0, 1, 0, 1]), torch.ones(len(CHANNELS)))
    once = torch.ones(1, 2)
    # pairs: 2 > 1, 2 > 0, 1 = 1 and 1 > 0
    assert float(auc(verdict, once, once)) == pytest.approx(3.5 / 4)
    first_twice = torch.tensor([[2.0, 0.0]])
    assert float(auc(verdict, first_twice, once)) == pytest.approx(1.0)


def test_clips_are_in_the_frame_of_the_way() -> None:
    time = torch.arange(12).float() * 0.4
    walks = torch.stack((torch.stack((torch.zeros(12), time), 1), torch.stack((torch.ones(12), time), 1)))
    start, goal = walks[:, 0], torch.tensor([[0.0, 10.0], [1.0, 10.0]])
    result = clips_of(walks, start, goal)
    assert len(result.person) == 2 * (10 - LENGTH + 1)
    step = dict(zip(CHANNELS, result.value[0, : len(CHANNELS)].tolist(), strict=True))
    expected = {"velocity along the way": 1, "velocity across the way": 0, "nearest person ahead": 0}
    expected |= {"nearest person aside": -1, "second person ahead": 20, "distance to the exit": 10 - 0.8}
    assert {key: step[key] for key in expected} == pytest.approx(expected, abs=1e-5)
    turned = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    again = clips_of(walks @ turned, start @ turned, goal @ turned)
    torch.testing.assert_close(again.value, result.value, atol=1e-4, rtol=0)


def test_coarse_positions_are_means_of_three() -> None:
    xy = torch.tensor([[0.0, 3.0, 0.0, 3.0, 0.0, 3.0]]).unsqueeze(2).expand(1, 6, 2)
    result = coarse(steps_of(xy))
    assert result.xy[0, 0, 1:-1, 0].tolist() == [1.0, 2.0, 1.0, 2.0]
    assert result.scored[0, 0].tolist() == [False, False, True, True, True, False]


def test_rounding_hides_the_decimals_of_files() -> None:
    xy = torch.rand(3, 9, 2)
    rounded = to_millimetres(steps_of((xy * 1e4).round() / 1e4))
    assert float((rounded.xy - to_millimetres(steps_of(rounded.xy[0])).xy).abs().max()) == 0
    assert float((rounded.xy * 1000 - (rounded.xy * 1000).round()).abs().max()) < 1e-3


def crowd_of(noise: float, people: int, seed: int) -> Clips:
    generator = torch.Generator().manual_seed(seed)
    speed = 1 + 0.2 * torch.randn(people, 1, 2, generator=generator)
    change = noise * torch.randn(people, 18, 2, generator=generator).cumsum(1)
    place = 20 * torch.rand(people, 1, 2, generator=generator)
    xy = place + ((speed + change) * 0.4).cumsum(1)
    return clips_of(xy, xy[:, 0], xy[:, -1])


PARTS, ONCE = torch.arange(40) % FOLDS, torch.ones(1, 40)


def found_auc(one: Clips, other: Clips, parts: torch.Tensor = PARTS) -> float:
    return float(auc(two_sample(one, other, parts, PARTS), ONCE, ONCE))


def test_constant_velocity_is_told_apart_and_equal_crowds_not() -> None:
    real = crowd_of(0.05, 40, 0)
    assert found_auc(real, real) == pytest.approx(0.5, abs=0.02)
    assert found_auc(crowd_of(0.05, 40, 1), real) == pytest.approx(0.5, abs=0.1)
    assert found_auc(crowd_of(0.0, 40, 2), real) > 0.95


def test_numbers_of_people_do_not_matter() -> None:
    one, other = crowd_of(0.05, 40, 3), crowd_of(0.08, 40, 4)
    shuffled, moved = torch.randperm(40, generator=torch.Generator().manual_seed(0)), torch.empty_like(PARTS)
    moved[shuffled] = PARTS
    again = found_auc(Clips(one.value, shuffled[one.person]), other, moved)
    assert found_auc(one, other) == pytest.approx(again, abs=1e-9)


def test_no_part_gets_more_than_half_of_the_strangers() -> None:
    real = crowd_of(0.1, 4, 7)
    walk = Clips(*(value[real.person == 2] for value in real))
    # five who walk like the recorded person of part 2, and one with a clip of another
    others = Clips(*(value[real.person == 1][:1] for value in real))
    clips_of_all = torch.cat((walk.value.repeat(5, 1), others.value))
    person = torch.cat((torch.arange(5).repeat_interleave(len(walk.person)), torch.tensor([5])))
    parts = nearest_parts(Clips(clips_of_all, person), real, torch.arange(4), 6)
    assert torch.bincount(parts, minlength=4)[2] == 3 and parts[5] == 1
    four = nearest_parts(
        Clips(walk.value.repeat(2, 1), person[: 2 * len(walk.person)]), real, torch.arange(4), 2
    )
    assert torch.bincount(four, minlength=4).max() == 1 and four[0] == 2


def test_a_stranger_is_like_those_of_most_of_their_clips() -> None:
    real = crowd_of(0.1, 4, 7)
    first, other = (real.value[real.person == number][:2] for number in (1, 3))
    stranger = Clips(torch.cat((first[:1], other)), torch.zeros(3, dtype=torch.long))
    assert nearest_parts(stranger, real, torch.arange(4), 1).tolist() == [3]


def test_trees_are_those_of_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "score.md").read_text()
    assert f"of depth {TREES['max_depth']})" in page and TREES["max_leaf_nodes"] is None
    assert (TREES["learning_rate"], TREES["max_bins"], TREES["min_samples_leaf"]) == (0.1, 64, 20)


def test_larger_crowds_are_thinned_evenly(monkeypatch) -> None:
    monkeypatch.setattr("pedzoo.metrics.realism.two_sample.MOST", 100)
    real, other = crowd_of(0.05, 40, 0), crowd_of(0.05, 40, 1)
    verdict = two_sample(real, other, PARTS, PARTS)
    assert len(real.person) == 360 and verdict.simulated.sum() == (~verdict.simulated).sum() == 90
    assert verdict.person.unique().tolist() == list(range(40))
    assert sum(verdict.gain.tolist()) == pytest.approx(1) and len(verdict.telling) == 3
