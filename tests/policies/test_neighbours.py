"""Neighbours and pairs: a plain double loop as the oracle, for both ways of searching."""

import math

import pytest
import torch
from torch import Tensor

from pedzoo.policies import neighbours
from pedzoo.policies.neighbours import nearest

WAYS = pytest.mark.parametrize("all_pairs", [10_000, 0], ids=["all pairs", "trees"])


@pytest.fixture(autouse=True)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Search in the way of the parameter."""
    if "all_pairs" in request.fixturenames:
        monkeypatch.setattr(neighbours, "ALL_PAIRS", request.getfixturevalue("all_pairs"))


def scene(kind: str, scenes: int = 3, agents: int = 24) -> tuple[Tensor, Tensor]:
    """Return positions (B, A, 2) and who is there."""
    random = torch.Generator().manual_seed(0)
    position = 12 * torch.rand(scenes, agents, 2, generator=random)
    if kind == "equal":  # whole metres: many equal distances, many at exactly the reach, many at one place
        position = position.round() // 2
    elif kind == "far":  # two groups 10 km apart, and one person at the end of the world
        position = 0.3 * position
        position[:, ::2] += torch.tensor([1e4, -1e4])
        position[0, 0] = 1e30
    elif kind == "one cell":
        position = 0.02 * position - 300
    mask = torch.rand(scenes, agents, generator=random) < 0.8
    mask[-1] = kind == "random"
    return torch.where(mask[..., None], position, math.nan), mask


KINDS = pytest.mark.parametrize("kind", ["random", "equal", "far", "one cell"])


def distance2(a: Tensor, b: Tensor) -> Tensor:
    """In the order of operations of the product, so that equal is equal."""
    gap = b - a
    return gap[0] * gap[0] + gap[1] * gap[1]


def oracle(position: Tensor, mask: Tensor, reach: float, most: int | None) -> list[list[int]]:
    """Return the neighbours of each of the B * A people."""
    agents = mask.shape[1]
    result: list[list[int]] = []
    for b, a in torch.cartesian_prod(torch.arange(len(mask)), torch.arange(agents)).tolist():
        others = [c for c in range(agents) if c != a and mask[b, a] and mask[b, c]]
        gaps = [(float(distance2(position[b, a], position[b, c])), c) for c in others]
        result.append([b * agents + c for gap, c in sorted(gaps)[:most] if gap < reach * reach])
    return result


@WAYS
@KINDS
@pytest.mark.parametrize(("reach", "most"), [(3.0, None), (3.0, 4), (1.0, 1), (40.0, None), (1e-3, 5)])
def test_the_nearest_are_the_oracles(all_pairs: int, kind: str, reach: float, most: int | None) -> None:
    position, mask = scene(kind)
    expected = oracle(position, mask, reach, most)
    for rows in (None, torch.tensor([70, 3, 3, 30]), torch.tensor([], dtype=torch.long)):
        index, near = nearest(position, mask, reach, most, rows)
        near = torch.ones_like(index, dtype=torch.bool) if near is None else near
        asked = list(range(mask.numel())) if rows is None else rows.tolist()
        assert [index[near[:, i], i].tolist() for i in range(len(asked))] == [expected[i] for i in asked]
        assert torch.equal(index[~near], torch.tensor(asked).expand_as(index)[~near])
        assert len(index) == max((len(expected[i]) for i in asked), default=0)


@WAYS
@pytest.mark.parametrize(("shape", "most"), [((0, 3), None), ((3, 0), None), ((2, 1), None), ((2, 3), 0)])
def test_no_people_have_no_neighbours(all_pairs: int, shape: tuple[int, int], most: int | None) -> None:
    index, near = nearest(torch.rand(*shape, 2), torch.ones(shape, dtype=torch.bool), 5.0, most)
    assert index.shape == (0, shape[0] * shape[1])
    assert near is None


@WAYS
def test_double_precision(all_pairs: int) -> None:
    position, mask = scene("random")
    single, double = (nearest(part, mask, 3.0, 6)[0] for part in (position, position.double()))
    assert torch.equal(single, double)
    edge = torch.tensor([[[0.0, 0.0], [3 - 1e-12, 0.0], [0.0, 3.0]]], dtype=torch.float64)
    index, near = nearest(edge, torch.ones(1, 3, dtype=torch.bool), 3.0, None)
    assert near is not None
    assert index[near].tolist() == [1, 0]


def test_a_crowd_is_searched_in_little_memory() -> None:
    """People among 20,000 are not compared with all others: 400 million pairs would be 1.6 GB."""
    position = 400 * torch.rand(1, 20_000, 2, generator=torch.Generator().manual_seed(0))
    mask = torch.ones(1, 20_000, dtype=torch.bool)
    _, near = nearest(position, mask, 3.0, 10)
    assert near is not None
    assert near.sum() == pytest.approx(20_000 * 20_000 * math.pi * 9 / 160_000, rel=0.05)
