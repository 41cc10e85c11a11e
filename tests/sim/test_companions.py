"""Who walks with whom: in recordings, as far as is seen of them, and in what policies see of a replay."""

from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.walks import as_desired
from torch import Tensor

from pedzoo.core.batch import companions_of
from pedzoo.sim.make import make_env
from pedzoo.sim.recorded_people import companies
from pedzoo.sim.scenarios.replay import Replay

FRAMES = 20


def tracks(*people: tuple[int, float, float, float]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return rows of people: first frame, y, x at frame 0, metres per frame along x; 20 frames each."""
    rows = [[x + step * frame, y] for first, y, x, step in people for frame in range(first, first + FRAMES)]
    first = torch.tensor([one[0] for one in people])
    begin = FRAMES * torch.arange(len(people))
    return torch.tensor(rows), begin, first, first + FRAMES - 1


def test_companions_are_near_and_keep_their_places() -> None:
    rows = tracks(
        *((0, 0.0, 0.0, 0.5), (0, 0.8, 0.0, 0.5), (2, 1.6, 0.0, 0.5)),  # three abreast, one seen later
        (0, 9.0, 0.0, 0.5),  # alone
        (0, 10.6, 0.0, 0.5),  # 1.6 m beside
        (0, 9.5, 0.0, 0.6),  # 0.5 m beside, and 0.7 m ahead after 7 steps
    )
    group, shown = companies(*rows)
    assert len(group[:3].unique()) == 1 and (group[:3] >= 0).all()
    assert group[3:].tolist() == [-1, -1, -1]
    # when the first of two has been seen for 8 frames
    assert shown[:3].tolist() == [7, 7, 7]


@pytest.mark.parametrize(("later", "company"), [(4, True), (5, False)])
def test_companions_are_seen_together_in_four_frames(later: int, company: bool) -> None:
    group, _ = companies(*tracks((3, 0.0, 0.0, 0.5), (3 + later, 0.5, 0.0, 0.5)))
    assert (group >= 0).tolist() == [company] * 2


def test_less_time_together_allows_less_drift() -> None:
    """Over 3 steps 3/7 of 0.5 m: 0.214 m."""
    for drift, company in ((0.07, True), (0.073, False)):
        group, _ = companies(*tracks((0, 0.0, 0.0, 0.5), (4, 0.5, 0.0, 0.5 + drift)))
        assert bool((group >= 0).all()) == company


def test_nothing_later_is_looked_at() -> None:
    rows, begin, first, last = tracks((0, 0.0, 0.0, 0.5), (2, 0.8, 0.0, 0.5), (1, 3.0, 0.0, 0.5))
    expected, shown = companies(rows, begin, first, last)
    unseen = torch.cat(
        [torch.arange(int(b) + 8 - int(f), int(b) + FRAMES) for b, f in zip(begin, first, strict=True)]
    )
    rows[unseen] += 50 * torch.rand(len(unseen), 2)
    changed, again = companies(rows, begin, first, last)
    assert torch.equal(expected, changed) and torch.equal(shown, again)


def test_people_are_companions_in_any_order() -> None:
    people = [
        (0, 0.0, 0.0, 0.5),
        (2, 0.8, 0.0, 0.5),
        (1, 3.0, 0.0, 0.5),
        (0, 3.5, 0.0, 0.5),
        (9, 0.0, 0.0, 0.5),
    ]
    group, _ = companies(*tracks(*people))
    order = [3, 1, 4, 0, 2]
    other, _ = companies(*tracks(*(people[i] for i in order)))
    same = group[order].unsqueeze(1) == group[order]
    assert torch.equal(same, other.unsqueeze(1) == other)


def pairs_seen(folder: Path, decisions: int, *people: tuple[int, float, float, float]) -> list[list[Any]]:
    """Return the pairs of persons that a policy sees as companions before each decision of a replay."""
    xy, begin, first, _ = tracks(*people)
    rows = [
        (int(first[who]) + row, who, *xy[int(begin[who]) + row].tolist())
        for who in range(len(people))
        for row in range(FRAMES)
    ]
    file = folder / "rows.txt"
    file.write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in sorted(rows)))
    env = make_env(Replay(files=[str(file)], dt=0.4).prepare(0.25))
    result = []
    for now, state in zip(*as_desired(env, decisions - 1), strict=True):
        pairs = now["agents", "id"][0][companions_of(now)[0].nonzero()]
        result.append(sorted(pairs.tolist()))
        assert torch.equal(state.group[0] >= 0, torch.isin(state.person[0], pairs.flatten()))
    return result


def test_policies_see_companies_as_soon_as_these_show(tmp_path: Path) -> None:
    """The clock begins in frame 7, in which who comes in frame 0 has been seen eight times."""
    alone = (0, 5.0, 12.0, -0.4)
    both = [[0, 1], [1, 0]]
    two = (0, 0.0, 0.0, 0.4), (3, 0.7, 0.0, 0.4)
    assert pairs_seen(tmp_path, 4, *two, alone) == [both] * 4
    later = (4, 0.0, 0.0, 0.4), (5, 0.7, 0.0, 0.4)
    assert pairs_seen(tmp_path, 6, *later, alone) == [[]] * 4 + [both] * 2
