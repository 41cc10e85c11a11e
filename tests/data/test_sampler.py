"""Batches of scenes of similar size: every scene once, within the caps, the same again for the same seed."""

from __future__ import annotations

from itertools import pairwise

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


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize(("batch_size", "max_pairs"), [(64, 10**9), (64, 8192), (1, 8192), (1000, 10**9)])
def test_every_scene_once_within_the_caps(shuffle: bool, batch_size: int, max_pairs: int) -> None:
    sampler = BucketSampler(SIZES, batch_size, max_pairs, shuffle)
    for number in range(3):
        draws = epoch(sampler, number)
        assert len(draws) == len(sampler)
        assert sorted(scene for draw in draws for scene in draw.scenes.tolist()) == list(range(501))
        for draw in draws:
            assert len(draw.scenes) <= batch_size
            assert (SIZES[draw.scenes] ** 2).sum() <= max_pairs or len(draw.scenes) == 1
    if max_pairs == 8192:
        assert [17] in scenes(draws)


@pytest.mark.parametrize("shuffle", [True, False])
def test_batches_of_groups_are_of_one_each(shuffle: bool) -> None:
    groups = torch.arange(501) % 3 * 10
    sampler = BucketSampler(SIZES, 16, 8192, shuffle, groups=groups)
    draws = epoch(sampler, 1)
    assert len(draws) == len(sampler)
    assert sorted(scene for draw in draws for scene in draw.scenes.tolist()) == list(range(501))
    assert all(len(groups[draw.scenes].unique()) == 1 for draw in draws)
    assert all((SIZES[draw.scenes] ** 2).sum() <= 8192 or len(draw.scenes) == 1 for draw in draws)
    one = BucketSampler(SIZES, 16, 8192, shuffle, groups=torch.zeros(501, dtype=torch.long))
    assert scenes(epoch(one)) == scenes(epoch(BucketSampler(SIZES, 16, 8192, shuffle)))


def test_caps_are_used() -> None:
    """Batches are as large as they may be: one more scene of the next batch would not fit."""
    sampler = BucketSampler(SIZES, 64, 8192, shuffle=False)
    draws = epoch(sampler)
    for draw, following in pairwise(draws):
        more = torch.cat((draw.scenes, following.scenes[:1]))
        assert len(more) > 64 or (SIZES[more] ** 2).sum() > 8192


def test_sizes_within_a_batch_are_close() -> None:
    padded = stored = 0
    for draw in epoch(BucketSampler(SIZES, 64, 16384, shuffle=True)):
        sizes = SIZES[draw.scenes]
        padded += int(len(sizes) * sizes.max() ** 2)
        stored += int((sizes**2).sum())
    assert padded < 1.2 * stored
    shuffled = sum(int(len(part) * part.max() ** 2) for part in SIZES[torch.randperm(501)].split(64))
    assert shuffled > 3 * padded


def test_an_epoch_depends_on_seed_and_number_only() -> None:
    first = BucketSampler(SIZES, 64, 8192, True, seed=1)
    epoch(first, 0)  # a resumed run has not drawn the earlier epochs
    same = BucketSampler(SIZES, 64, 8192, True, seed=1)
    assert scenes(epoch(first, 5)) == scenes(epoch(same, 5))
    assert [draw.seed for draw in epoch(first, 5)] == [draw.seed for draw in epoch(same, 5)]
    assert scenes(epoch(first, 5)) != scenes(epoch(first, 6))
    assert {draw.seed for draw in epoch(first, 5)}.isdisjoint(draw.seed for draw in epoch(first, 6))
    assert scenes(epoch(first, 5)) != scenes(epoch(BucketSampler(SIZES, 64, 8192, True, seed=2), 5))


def test_shuffling_mixes_scenes_of_a_size_and_the_order_of_batches() -> None:
    sampler = BucketSampler(SIZES, 64, 8192, True)
    one, two = epoch(sampler, 0), epoch(sampler, 1)
    assert {frozenset(batch) for batch in scenes(one)} != {frozenset(batch) for batch in scenes(two)}
    means = [float(SIZES[draw.scenes].float().mean()) for draw in one]
    assert means != sorted(means)


def test_without_shuffling_every_epoch_is_the_same() -> None:
    sampler = BucketSampler(SIZES, 64, 8192, shuffle=False)
    first, second = epoch(sampler, 0), epoch(sampler, 1)
    assert scenes(first) == scenes(second)
    assert [draw.seed for draw in first] == [draw.seed for draw in second]


@pytest.mark.parametrize("replicas", [2, 3])
def test_processes_share_the_batches_evenly(replicas: int) -> None:
    alone = scenes(epoch(BucketSampler(SIZES, 64, 8192, True, seed=4), 2))
    shares = [
        scenes(epoch(BucketSampler(SIZES, 64, 8192, True, 4, rank, replicas), 2)) for rank in range(replicas)
    ]
    assert {len(share) for share in shares} == {-(-len(alone) // replicas)}
    together = [batch for share in shares for batch in share]
    assert {tuple(batch) for batch in together} == {tuple(batch) for batch in alone}
    # only what fills the last round comes twice
    assert len(together) - len(alone) == -len(alone) % replicas
