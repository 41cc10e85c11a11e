"""Batches of scenes of similar size: every scene once, within the caps, the same again for the same seed."""

from itertools import pairwise
from typing import Any

import pytest
import torch

from pedzoo.data.datamodule import BucketSampler, Draw

SIZES = torch.randint(2, 40, (501,), generator=torch.Generator().manual_seed(0))
SIZES[17] = 150  # 22500 ordered pairs: more than any cap here


def epoch(sampler: BucketSampler, number: int = 0) -> list[Draw]:
    sampler.set_epoch(number)
    return list(sampler)


def scenes(draws: list[Draw]) -> list[list[int]]:
    return [draw.scenes.tolist() for draw in draws]


def drawn(number: int, shuffle: bool = True, **options: Any) -> list[list[int]]:
    return scenes(epoch(BucketSampler(SIZES, 64, 8192, shuffle, **options), number))


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize(
    ("batch_size", "max_pairs", "groups"),
    [(64, 10**9, 1), (64, 8192, 1), (1, 8192, 1), (1000, 10**9, 1), (16, 8192, 3)],
)
def test_every_scene_once_within_the_caps(shuffle, batch_size, max_pairs, groups):
    group = torch.arange(501) % groups * 10
    sampler = BucketSampler(SIZES, batch_size, max_pairs, shuffle, groups=group)
    for number in range(3):
        draws = epoch(sampler, number)
        assert len(draws) == len(sampler)
        assert sorted(scene for draw in draws for scene in draw.scenes.tolist()) == list(range(501))
        for draw in draws:
            assert len(draw.scenes) <= batch_size and len(group[draw.scenes].unique()) == 1
            assert (SIZES[draw.scenes] ** 2).sum() <= max_pairs or len(draw.scenes) == 1
    if max_pairs == 8192:
        assert [17] in scenes(draws)
    if groups == 1:
        assert scenes(draws) == scenes(epoch(BucketSampler(SIZES, batch_size, max_pairs, shuffle), 2))


def test_batches_are_full_and_of_similar_sizes():
    for draw, following in pairwise(epoch(BucketSampler(SIZES, 64, 8192, shuffle=False))):
        more = torch.cat((draw.scenes, following.scenes[:1]))
        assert len(more) > 64 or (SIZES[more] ** 2).sum() > 8192
    sizes = [SIZES[draw.scenes] for draw in epoch(BucketSampler(SIZES, 64, 16384, shuffle=True))]
    padded = sum(int(len(part) * part.max() ** 2) for part in sizes)
    assert padded < 1.2 * sum(int((part**2).sum()) for part in sizes)
    shuffled = sum(int(len(part) * part.max() ** 2) for part in SIZES[torch.randperm(501)].split(64))
    assert shuffled > 3 * padded


def test_an_epoch_depends_on_seed_and_number_only():
    first = BucketSampler(SIZES, 64, 8192, True, seed=1)
    epoch(first, 0)  # a resumed run has not drawn the earlier epochs
    fifth, sixth = epoch(first, 5), epoch(first, 6)
    assert scenes(fifth) == drawn(5, seed=1) and drawn(5, seed=2) != scenes(fifth) != scenes(sixth)
    assert [draw.seed for draw in fifth] == [draw.seed for draw in epoch(first, 5)]
    assert {draw.seed for draw in fifth}.isdisjoint(draw.seed for draw in sixth)
    still = BucketSampler(SIZES, 64, 8192, shuffle=False)
    assert drawn(0, shuffle=False) == drawn(1, shuffle=False)
    assert [draw.seed for draw in epoch(still, 0)] == [draw.seed for draw in epoch(still, 1)]


def test_shuffling_mixes_scenes_of_a_size_and_batches():
    one, two = drawn(0), drawn(1)
    assert {frozenset(batch) for batch in one} != {frozenset(batch) for batch in two}
    means = [float(SIZES[batch].float().mean()) for batch in one]
    assert means != sorted(means)


@pytest.mark.parametrize("replicas", [2, 3])
def test_processes_share_the_batches_evenly(replicas):
    alone = drawn(2, seed=4)
    shares = [drawn(2, seed=4, rank=rank, replicas=replicas) for rank in range(replicas)]
    assert {len(share) for share in shares} == {-(-len(alone) // replicas)}
    together = [batch for share in shares for batch in share]
    assert {tuple(batch) for batch in together} == {tuple(batch) for batch in alone}
    # only what fills the last round comes twice
    assert len(together) - len(alone) == -len(alone) % replicas
