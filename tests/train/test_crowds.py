"""Training on whole recorded crowds: excerpts, walking on, what is compared, and the loss."""

import math
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from pedzoo.core.batch import agents_of, companions_of
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.planner import Planner
from pedzoo.metrics.realism import features as score_features
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.models.architectures.social_walker import SocialWalker
from pedzoo.policies.walker import Walker
from pedzoo.train.crowds.comparison import MANNER_DIM, coarse, compared, parted, summaries
from pedzoo.train.crowds.crowd_walk import CrowdWalk, recorded, walked_on
from pedzoo.train.crowds.excerpts import Excerpts, RecordedCrowd, excerpts
from pedzoo.train.crowds.module import whole_replays
from pedzoo.train.crowds.realism_loss import CrowdDiscriminator, CrowdLikeness, largest, legible

EARLY, LATE, SHORT = 0, 1, 2
PLANNER = Planner(MapBank())


def tracks(people: int = 6, frames: int = 44) -> Tracks:
    """Return people who wind their ways across a square: number 1 comes later, number 2 is brief."""
    random = np.random.default_rng(0)
    rows = []
    for agent in range(people):
        first, last = (12, frames) if agent == LATE else (0, 6) if agent == SHORT else (agent, frames - agent)
        begin, heading, speed = 6 * random.random(2), 6 * random.random(), 0.3 + 0.3 * random.random()
        for frame in range(first, last):
            angle = heading + 0.3 * math.sin(frame / 5 + agent)
            begin = (
                begin + speed * np.array([math.cos(angle), math.sin(angle)]) + 0.01 * random.normal(size=2)
            )
            rows.append((frame, agent, *begin))
    return Tracks.from_table("crowd", np.array(rows))


@pytest.fixture(scope="module")
def crowd() -> RecordedCrowd:
    return RecordedCrowd.of(tracks(), -1, PLANNER)


@pytest.fixture(scope="module")
def whole(crowd: RecordedCrowd) -> Excerpts:
    return excerpts(crowd, [1 - OBS_LEN], crowd.frames)


class AsRecorded:
    """Walks every person to where they really were."""

    def __init__(self, real: Excerpts) -> None:
        self.real = real

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        frame = OBS_LEN + round(float(batch["time"][0, 0]) / STEP_SECONDS)
        there = self.real.xy[:, :, frame] - agents_of(batch)["history"][:, :, -1]
        batch["agents", "action"] = there / STEP_SECONDS
        return batch


def walker(seed: int = 0) -> Walker:
    torch.manual_seed(seed)
    return Walker(SocialWalker.of(safety=False))


def test_a_recording_becomes_a_table(crowd: RecordedCrowd) -> None:
    own = tracks()
    rows = own.agent == LATE
    assert int(crowd.first[LATE]) == 12 and int(crowd.last[LATE]) == 43
    np.testing.assert_allclose(crowd.xy[LATE, 12:44], own.xy[rows], atol=1e-5)
    assert not crowd.there[LATE, :12].any() and crowd.there[LATE, 12:].all()
    assert not crowd.walks[SHORT]
    np.testing.assert_allclose(crowd.head[LATE], own.xy[rows][:8], atol=1e-5)
    np.testing.assert_allclose(crowd.exit[LATE], own.xy[rows][-1], atol=1e-5)


def test_a_crowd_that_is_annotated_anew(crowd: RecordedCrowd) -> None:
    deviation = torch.full((len(crowd.first),), 0.05)
    deviation[0] = 0.0
    anew = crowd.annotated_anew(deviation, torch.Generator().manual_seed(0))
    error = (anew.xy - crowd.xy)[1:][crowd.there[1:]]
    assert float(error.std()) == pytest.approx(0.05, rel=0.15) and abs(float(error.mean())) < 0.01
    assert torch.equal(anew.xy[0], crowd.xy[0]) and not anew.xy[~crowd.there].any()
    assert torch.equal(anew.head[LATE], anew.xy[LATE, 12:20])
    assert torch.equal(anew.start[LATE], anew.xy[LATE, 19])
    walked = anew.head[LATE].diff(dim=0).norm(dim=1).sum() / (7 * STEP_SECONDS)
    assert float(anew.pref_speed[LATE]) == pytest.approx(float(walked))
    assert anew.pref_speed[0] == crowd.pref_speed[0] and torch.equal(anew.goal, crowd.goal)


def test_an_excerpt_has_all_people_who_are_there_meanwhile(crowd: RecordedCrowd) -> None:
    early, late = excerpts(crowd, [0], 3), excerpts(crowd, [0], 10)
    assert early.xy.shape == (1, 5, 11, 2)  # before number 1 comes
    assert late.xy.shape == (1, 6, 18, 2)
    assert int(late.taken[0, LATE]) == 12 + OBS_LEN - 1


def test_excerpts_of_different_sizes_are_padded(crowd: RecordedCrowd) -> None:
    both = excerpts(crowd, [0, 20], 3)
    assert both.walks.shape == both.there.shape[:2] == (2, 5)
    assert both.there.any(2).sum(1).tolist() == [5, 5]
    assert not both.xy[~both.there].any()


def test_excerpts_know_groups() -> None:
    """Two abreast, one of whom comes 3 frames later, and four alone, two of whom come after 20."""
    places = [(0.0, 0.0), (0.0, 0.7), (5.0, 5.0), (9.0, 10.0), (0.0, 15.0), (5.0, 20.0)]
    came = [0, 3, 0, 0, 20, 20]
    rows = [
        (frame, agent, x + 0.4 * frame, y)
        for agent, (x, y) in enumerate(places)
        for frame in range(came[agent], 40)
    ]
    crowd = RecordedCrowd.of(Tracks.from_table("two", np.array(rows)), -1, PLANNER)
    assert crowd.group[0] == crowd.group[1] >= 0 and (crowd.group[2:] == -1).all()
    both = excerpts(crowd, [2, 18], 4)
    assert both.group.shape == (2, 6)
    assert both.group[0].tolist() == [*crowd.group[:4].tolist(), -1, -1]  # padding
    assert both.grouped[0, :2].tolist() == [7 - 2] * 2
    assert torch.equal(both.repeated(2).group, both.group.repeat(2, 1))
    seen = []

    def policy(batch: TensorDictBase) -> TensorDictBase:
        seen.append(companions_of(batch))
        agents = agents_of(batch)
        batch["agents", "action"] = agents["velocity"]
        return batch

    walked_on(policy, excerpts(crowd, [-4], 8), PLANNER, torch.tensor([0]))
    # the first frame seen is number 3, and frame 7 shows who walks together
    assert [bool(pairs[0, 0, 1]) for pairs in seen] == [frame >= 7 for frame in range(3, 11)]
    assert not torch.stack(seen)[:, :, 2:].any()


def test_mirrored_excerpts_have_the_other_sign_of_y(crowd: RecordedCrowd) -> None:
    plain, mirrored = excerpts(crowd, [0, 0], 8, [False, True])._replace(map_id=torch.zeros(2)).xy
    torch.testing.assert_close(mirrored, plain * torch.tensor([1.0, -1.0]))


def test_people_who_walk_as_they_did_are_the_recorded_crowd(whole: Excerpts) -> None:
    walk, real = walked_on(AsRecorded(whole), whole, PLANNER, torch.tensor([0])), recorded(whole)
    assert torch.equal(walk.scored, real.scored) and real.scored.sum() > 50
    torch.testing.assert_close(walk.xy[real.scored], real.xy[real.scored], atol=1e-4, rtol=0)
    made, true = compared(walk, whole), compared(real, whole)
    for name, values in true.features.items():
        torch.testing.assert_close(made.features[name], values, atol=2e-2, rtol=1e-2, msg=name)


def test_people_are_taken_over_after_eight_rows_until_their_exit(whole: Excerpts) -> None:
    walk = walked_on(AsRecorded(whole), whole, PLANNER, torch.tensor([0]))
    begin = OBS_LEN - 1 + 12  # of the excerpt's frames: it begins seven before the recording
    scored = walk.scored[0, LATE].nonzero()[:, 0]
    assert int(scored[0]) == begin + OBS_LEN
    assert walk.there[0, LATE, begin] and not walk.there[0, LATE, begin - 1]
    assert not walk.there[0, LATE, -1]  # arrived


def test_steps_before_are_neither_scored_nor_differentiated(crowd: RecordedCrowd) -> None:
    policy = walker()
    real = excerpts(crowd, [0], 14)
    walk = walked_on(policy, real, PLANNER, torch.tensor([0]), before=10)
    assert not walk.scored[..., : OBS_LEN + 10].any() and walk.scored[..., OBS_LEN + 10 :].any()
    assert walk.asked is not None and walk.asked.shape[2] == 4
    weight = cast("SocialWalker", policy.model).head.weight
    before, after = (
        torch.autograd.grad(walk.xy[:, :, frame].sum(), weight, retain_graph=True)[0]
        for frame in (OBS_LEN + 9, OBS_LEN + 12)
    )
    assert not before.any() and after.any() and after.isfinite().all()


def as_steps(walk: CrowdWalk) -> score_features.SampledRollout:
    """Return a crowd as `pedzoo score` has it."""
    person = torch.arange(walk.xy.shape[1]).view(1, -1, 1).where(walk.there, -1)
    known = torch.zeros_like(walk.there)
    known[..., 1:] = walk.there[..., 1:] & walk.there[..., :-1]
    velocity = torch.zeros_like(walk.xy)
    velocity[:, :, 1:] = walk.xy.diff(dim=2) / STEP_SECONDS
    radius = torch.full(walk.there.shape[:2], 0.15)
    return score_features.SampledRollout(walk.xy, person, velocity, known, walk.scored & known, radius)


@pytest.mark.parametrize("positions", ["fine", "coarse"])
def test_features_and_clips_are_those_of_the_score(whole: Excerpts, positions: str) -> None:
    walk = recorded(whole)
    steps = as_steps(walk)
    if positions == "coarse":
        walk, steps = coarse(walk), score_features.coarse(steps)
    mine = compared(walk, whole)
    around = score_features.surroundings(steps)
    theirs = score_features.features(steps, around, whole.start[0], whole.exit[0])
    assert {*mine.features} == {*theirs}
    for name, values in mine.features.items():
        expected = theirs[name].value.to(values)
        expected = expected.abs() if name == "heading_rate" else expected
        torch.testing.assert_close(
            values.sort().values, expected.sort().values, atol=2e-3, rtol=1e-3, msg=name
        )
    expected_clips = score_features.clips(steps, around, whole.start[0], whole.exit[0])
    assert len(mine.clips) == len(expected_clips.value) > 10
    order = [clips.flatten(1).sum(1).argsort() for clips in (mine.clips, expected_clips.value)]
    made, true = mine.clips.flatten(1)[order[0]], expected_clips.value[order[1]]
    torch.testing.assert_close(made, true, atol=5e-3, rtol=1e-3)


def test_summaries_by_hand() -> None:
    frames, speed = 20, 0.5
    xy = torch.zeros(1, 1, frames, 2)
    xy[0, 0, :, 0] = speed * STEP_SECONDS * torch.arange(frames)
    xy[..., 1] = 0.3
    there = torch.ones(1, 1, frames, dtype=torch.bool)
    none = torch.zeros(1, 1)
    real = Excerpts(
        xy, there, none.long(), none.long() + 19, there[..., 0], torch.zeros(1, 1, 2),
        torch.tensor([[[4.0, 0.0]]]), torch.tensor([[[4.0, 0.0]]]), none.long(), none + 4,
        xy[:, :, :8], none + 0.5, none.long() - 1, none.long(), torch.tensor([-1]), torch.zeros(1, 4),
    )  # fmt: skip
    scored = there.clone()
    scored[..., :OBS_LEN] = False
    numbers, has = summaries(CrowdWalk(xy, there, scored), real)
    assert has.all()
    mean_speed, spread, _, _, aside, aside_spread, stands = numbers[0, 0].tolist()
    assert mean_speed == pytest.approx(1.0, abs=1e-3) and spread == pytest.approx(0.05, abs=1e-2)
    assert aside == pytest.approx(0.5, abs=1e-3) and aside_spread == pytest.approx(1 / 30, abs=1e-2)
    assert stands == pytest.approx(0.0, abs=1e-3)


def test_the_loss_is_least_for_the_recorded_crowd(crowd: RecordedCrowd) -> None:
    likeness, random = CrowdLikeness(judged=0.0), torch.Generator().manual_seed(0)
    whole = excerpts(crowd, [4], 24)
    real = recorded(whole)
    same = likeness(real, whole, 1, 0, None, random)
    noise = 0.2 * torch.randn(real.xy.shape, generator=random)
    other = likeness(real._replace(xy=real.xy + noise), whole, 1, 0, None, random)
    for name in ("distribution", "places", "persons"):
        assert float(same[name]) == pytest.approx(0.0, abs=1e-3)
        assert float(other[name]) > 0.05


def test_companions_who_part_are_told(crowd: RecordedCrowd) -> None:
    whole = excerpts(crowd, [4], 24)
    whole = whole._replace(group=torch.tensor([[3, -1, -1, 3, -1, -1]]))
    real = recorded(whole)
    apart = (real.xy[0, 0] - real.xy[0, 3]).norm(dim=1)
    pairs = [(real.scored[0, one] & real.there[0, other]) for one, other in ((0, 3), (3, 0))]
    distance = torch.cat([apart[both] for both in pairs])
    assert not parted(real, real, whole, whole)
    away = torch.zeros_like(real.xy)
    away[:, 0] = 4 * (real.xy[:, 0] - real.xy[:, 3])
    far = real._replace(xy=(real.xy + away).requires_grad_(True))
    value = parted(far, real, whole, whole)
    # five times as far: the farther quantile is that of the same frame
    beyond = ((5 * distance - 2).clamp_min(0) - (distance - 2).clamp_min(0)).mean()
    by_hand = 4 * distance.mean() / 0.5 + beyond
    assert float(value.detach()) == pytest.approx(float(by_hand), rel=1e-4)
    (gradient,) = torch.autograd.grad(value, far.xy)
    assert gradient[0, 0].any() and not gradient[0, [1, 2, 4]].any()
    alone = whole._replace(group=torch.full_like(whole.group, -1))
    assert not parted(far, real, alone, alone)
    twice = CrowdWalk(*(value.repeat(2, *[1] * (value.dim() - 1)) for value in far[:3]))
    likeness = CrowdLikeness(judged=0.0, company=3.0)
    terms = likeness(twice, whole, 2, 0, None, torch.Generator())
    assert float(terms["company"].detach()) == pytest.approx(3 * float(by_hand), rel=1e-4)


def test_the_loss_sees_one_large_acceleration(crowd: RecordedCrowd) -> None:
    whole, random = excerpts(crowd, [4], 24), torch.Generator()
    real = recorded(whole)
    likeness = CrowdLikeness(judged=0.0, distribution=1.0)
    jump = torch.zeros_like(real.xy)
    jump[0, 0, 20:] = 0.4  # metres in one step
    jumping = real._replace(xy=real.xy + jump)
    made, true = (compared(walk, whole).features["acceleration"] for walk in (jumping, real))
    assert float(wasserstein(largest(made), largest(true))) > 10 * float(wasserstein(made, true)) > 0
    assert len(largest(true)) == math.ceil(0.03 * len(true))
    assert not wasserstein(largest(true), largest(true))
    value, none = (
        float(likeness(walk, whole, 1, 0, None, random)["distribution"]) for walk in (jumping, real)
    )
    parts = [
        weight * float(wasserstein(largest(mine), largest(theirs))) / 0.3
        for weight, walk, truth in ((1, jumping, real), (2, coarse(jumping), coarse(real)))
        for mine, theirs in [[compared(one, whole).features["acceleration"] for one in (walk, truth)]]
    ]
    assert value - none > sum(parts) / 20


def test_a_judge_learns_to_distinguish_and_judges_untrained() -> None:
    random = torch.Generator().manual_seed(0)
    judge = CrowdDiscriminator(hidden_dim=16)
    clips = [torch.randn(200, 8, 14, generator=random) for _ in range(2)]
    clips[1][..., :2] += 1.0
    true, made = (legible(some, torch.zeros(200, MANNER_DIM)) for some in clips)
    optimizer = torch.optim.Adam(judge.parameters(), 3e-3)
    judge.remember(made, true)
    for _ in range(60):
        optimizer.zero_grad()
        judge.learning(random).backward()
        optimizer.step()
    assert float((judge(true) > 0).float().mean()) > 0.9 > 0.1 > float((judge(made) > 0).float().mean())
    optimizer.zero_grad()
    made.requires_grad_(True)
    judge.passing(made).backward()
    assert made.grad is not None and made.grad.any()
    assert all(parameter.grad is None for parameter in judge.parameters())


def test_whole_replays_of_people_who_walk_as_they_did(crowd: RecordedCrowd, whole: Excerpts) -> None:
    same = whole_replays(AsRecorded(whole), [crowd], PLANNER)
    torch.manual_seed(0)
    other = whole_replays(walker(), [crowd], PLANNER)
    assert same["realism"] < 0.05 < other["realism"]
    assert other["unlike"] == pytest.approx(other["realism"] + (other["auc"] + other["auc_coarse"]) / 2)


def test_training_lowers_the_loss(tmp_path) -> None:
    random = torch.Generator().manual_seed(1)
    policy, likeness = walker(), CrowdLikeness(judged=0.0)
    optimizer = torch.optim.Adam(policy.parameters(), 3e-3)
    real = excerpts(RecordedCrowd.of(tracks(12), -1, PLANNER), [0], 20)
    losses = []
    for _ in range(12):
        key = torch.randint(2**62, (2,), generator=random)
        walk = walked_on(policy, real.repeated(2), PLANNER, key)
        loss = torch.stack(list(likeness(walk, real, 2, 0, None, random).values())).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert min(losses[-3:]) < 0.9 * losses[0]
