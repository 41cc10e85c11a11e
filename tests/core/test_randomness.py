"""Random numbers by counter: the same for every batch, and as random as they must be."""

from __future__ import annotations

import torch

from pedzoo.core.randomness import Draws, join, mix, normal, uniform


def test_a_scene_draws_the_same_in_every_batch() -> None:
    everything = Draws.for_episodes(7, torch.arange(100)).normal("start", 5, 2)
    alone = Draws.for_episodes(7, torch.tensor([42])).normal("start", 5, 2)
    assert torch.equal(everything[42], alone[0])


def test_more_people_keep_the_numbers_of_fewer() -> None:
    draws = Draws.for_episodes(0, torch.arange(3))
    assert torch.equal(draws.uniform("speed", 9)[:, :4], draws.uniform("speed", 4))
    assert torch.equal(draws.uniform("place", 9, 2)[:, :4], draws.uniform("place", 4, 2))


def test_seed_episode_purpose_and_index_all_matter() -> None:
    base = Draws.for_episodes(0, torch.tensor([0])).uniform("a", 1)
    others = [
        Draws.for_episodes(1, torch.tensor([0])).uniform("a", 1),
        Draws.for_episodes(0, torch.tensor([1])).uniform("a", 1),
        Draws.for_episodes(0, torch.tensor([0])).uniform("b", 1),
        Draws.for_episodes(0, torch.tensor([0])).uniform("a", 2)[:, 1:],
        Draws.for_episodes(-1, torch.tensor([0])).uniform("a", 1),
        Draws.for_episodes(2**63, torch.tensor([0])).uniform("a", 1),
    ]
    assert len({float(value) for value in [base, *others]}) == len(others) + 1


def test_splitmix_by_hand() -> None:
    """The hash of 64-bit integers in Python, which have no sign and no overflow."""
    for value in (1, 12345, 2**63 + 17, 2**64 - 1):
        x = value
        x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) % 2**64
        x ^= x >> 31
        signed = value - 2**64 if value >= 2**63 else value
        assert int(mix(torch.tensor([signed]))) % 2**64 == x


def test_distributions() -> None:
    key = join(torch.zeros(200_000, dtype=torch.long), torch.arange(200_000))
    u, n = uniform(key), normal(key)
    assert 0 < float(u.min()) < float(u.max()) < 1
    bins = torch.histc(u, 20, 0, 1)
    chi_squared = float(((bins - 10_000) ** 2 / 10_000).sum())
    assert chi_squared < 50  # 19 degrees of freedom: 1 in 10,000
    assert abs(float(n.mean())) < 0.01
    assert abs(float(n.std()) - 1) < 0.01
    neighbours = torch.stack((u[:-1], u[1:]))
    assert abs(float(torch.corrcoef(neighbours)[0, 1])) < 0.01


def test_whole_numbers_cover_their_range() -> None:
    counts = Draws.for_episodes(3, torch.arange(6000)).integers("die", 6).bincount(minlength=6)
    assert len(counts) == 6
    assert int(counts.min()) > 850
