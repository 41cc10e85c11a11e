"""The nearest neighbours of people, for scenes of two and for crowds.

Up to `ALL_PAIRS` people per scene all pairs are compared. In larger scenes people are sorted into square
cells as wide as they can see, and compared with those in the nine cells around them (cell lists: Allen and
Tildesley, "Computer Simulation of Liquids", 1987, section 5.3.2). Both ways give the same answers.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

ALL_PAIRS = 128
"""People per scene beyond which cells are used.

For 10 neighbours within 5 m on one CPU thread, both ways take the same time at 80 people (32 scenes, 0.1 per
square metre) to 500 (one scene, 1 per square metre).
"""

NETWORK, NETWORK_PEOPLE = 9, 500
"""Most people per scene, and fewest in the batch, for a sorting network over a few long rows.

For 1024 scenes of 5 it takes a quarter of the time of many short sorts, for a few scenes more.
"""

_BITS = 21
"""Largest number of a cell along x, and along y; cells at the rim hold all people beyond them."""

_MARGIN = 1 + 1e-6
"""How much wider than necessary cells are, so that rounding a distance loses no neighbour."""


class Neighbors(NamedTuple):
    """Up to K people near each of N people, nearest first (in single precision), equally near ones in order.

    Attributes:
        index: Their places b * A + a in the flattened batch (K, N) long; the person's own where not ``near``.
        near: Which of the K there are (K, N) bool; None: all.
    """

    index: Tensor
    near: Tensor | None


@torch.no_grad()
def nearest(
    position: Tensor, mask: Tensor, reach: float, most: int | None, rows: Tensor | None = None
) -> Neighbors:
    """Return each person's nearest others; absent people have none and are no person's.

    Args:
        position: Positions (B, A, 2), metres; anything for absent people.
        mask: Which people are present (B, A) bool.
        reach: Metres between centres from which on others are ignored.
        most: So many at most; None: all within reach.
        rows: Which of the B * A people are asked for (N,) long; None: all.
    """
    scenes, agents = mask.shape
    most = agents - 1 if most is None else min(agents - 1, most)
    people = mask.numel() if rows is None else len(rows)
    if most < 1 or not people:
        return Neighbors(torch.zeros(0, people, dtype=torch.long, device=mask.device), None)
    if agents > ALL_PAIRS:
        few = _least(_keys_in_cells(position, mask, reach, rows), most)
    else:
        keys = _keys_of_all(position, mask, reach)
        if agents <= NETWORK and mask.numel() >= NETWORK_PEOPLE:
            keys = torch.stack(_sorted(list(keys.flatten(1)))[:most])
            few = keys.view(-1, agents, scenes).transpose(1, 2).reshape(len(keys), -1)
            few = few if rows is None else few.index_select(1, rows)
        else:
            keys = keys.permute(2, 1, 0).reshape(-1, agents - 1)
            few = _least(keys if rows is None else keys.index_select(0, rows), most)
    low, high = (bound.tolist() for bound in few.aminmax(dim=1))
    few = few[: sum(least < _ABSENT for least in low)]
    # the own key comes before those of ignored people, and after the others
    own = _ABSENT + _places(mask, rows)
    index = few.minimum(own).bitwise_and_(_PLACE)
    return Neighbors(index, None if max(high[: len(few)], default=0) < _ABSENT else few < _ABSENT)


def _least(keys: Tensor, most: int) -> Tensor:
    """Return the least keys of each row of (N, C), ascending, so many at most (K, N)."""
    most = min(most, keys.shape[1])
    # selection beats sorting where it leaves most of them out
    few = keys.topk(most, dim=1, largest=False)[0] if keys.shape[1] > 4 * most else keys.sort(dim=1)[0]
    return few[:, :most].T.contiguous()


def _sorted(rows: list[Tensor]) -> list[Tensor]:
    """Sort element by element, in place of the rows: Batcher's odd-even merge sort (1968)."""
    count, span = len(rows), 1
    while span < count:
        step = span
        while step:
            for low in range(step % span, count - step, 2 * step):
                for one in range(low, min(low + step, count - step)):
                    other = one + step
                    if one // (2 * span) == other // (2 * span):
                        first, second = rows[one], rows[other]
                        rows[one], rows[other] = first.minimum(second), first.maximum(second)
            step //= 2
        span *= 2
    return rows


_PLACE = (1 << 31) - 1
"""The bits of a key that tell the place."""

_FAR = 1e30
"""Squared metres from which on others are ignored, for every reach."""

_ABSENT = int(torch.tensor(_FAR).view(torch.int32)) - 1 << 31
"""Where the keys of ignored people begin."""


def _key(distance2: Tensor, place: Tensor) -> Tensor:
    """Return whole numbers in the order of distances (...), and of places (...) among equals."""
    # floats that are not negative are ordered as their bits are
    return distance2.float().view(torch.int32).long().bitwise_left_shift_(31).add_(place)


def _finite(position: Tensor) -> Tensor:
    """Return which positions (..., 2) are numbers (...); several times faster than asking for it."""
    x, y = position.unbind(-1)
    return (x * 0 + y * 0) == 0


def _places(mask: Tensor, rows: Tensor | None) -> Tensor:
    """Return the places of the people asked for (N,)."""
    return torch.arange(mask.numel(), device=mask.device) if rows is None else rows


def _keys_of_all(position: Tensor, mask: Tensor, reach: float) -> Tensor:
    """Return the keys (A - 1, A, B) of each person with those in the next slots, cyclically."""
    present = mask if position.sum().isfinite() else mask & _finite(position)
    if not present.all():  # absent people are far from all people, and from each other
        far = torch.arange(1, 1 + mask.shape[1], device=mask.device)[:, None] * 1e18
        position = torch.where(present[..., None], position, far.to(position))
    number = _places(mask, None).view(mask.shape).T.contiguous()
    place = position.permute(2, 1, 0).contiguous()  # scenes last: long runs of numbers, in small scenes, too
    apart = (_after(place, 1) - place[:, None]).square_()
    distance2 = apart[0].add_(apart[1])
    ignored = torch.ge(distance2, reach * reach, out=torch.empty_like(distance2))
    return _key(distance2.add_(ignored, alpha=_FAR), _after(number, 0))


def _after(value: Tensor, dim: int) -> Tensor:
    """Return the others (..., A - 1, A, ...) of a dimension's A people, by how many slots after they come."""
    agents = value.shape[dim]
    twice = torch.cat((value, value), dim).narrow(dim, 1, 2 * agents - 2)
    return twice.unfold(dim, agents, 1).movedim(-1, dim + 1)


class _Cells(NamedTuple):
    """P present people in order of scene, row and column of their cells, and of slot within a cell.

    Attributes:
        place: Their places in the flattened batch (P,) long.
        cell: Their cells' numbers (P,) long, ascending.
    """

    place: Tensor
    cell: Tensor

    @classmethod
    def of(cls, position: Tensor, present: Tensor, width: Tensor) -> _Cells:
        """Sort people into cells of their scene's width (B, 1, 1), double precision."""
        exact = torch.where(present[..., None], position, torch.inf).double()
        column = ((exact - exact.amin(1, keepdim=True)) / (width * _MARGIN)).clamp(0, (1 << _BITS) - 3)
        x, y = torch.where(present[..., None], column, 0).long().add_(1).unbind(-1)
        scene = torch.arange(len(present), device=present.device)[:, None]
        cell = ((scene << 2 * _BITS) + (y << _BITS) + x).flatten()
        place = present.flatten().nonzero()[:, 0]
        cell, order = cell[place].sort(stable=True)
        return cls(place[order], cell)

    def runs(self, cell: Tensor) -> tuple[Tensor, Tensor]:
        """Return from where to where (M, 3) people lie in the three rows of three cells around cells (M,)."""
        below = cell[:, None] + (torch.arange(-1, 2, device=cell.device) << _BITS)
        begin = torch.searchsorted(self.cell, below - 1)
        return begin, torch.searchsorted(self.cell, below + 1, right=True)


def _expanded(begin: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """Return for runs (M, R) of numbers the M that each belongs to and the number, both (N,)."""
    count = (end - begin).flatten()
    run = torch.arange(len(count), device=count.device).repeat_interleave(count)
    skipped = begin.flatten() - (count.cumsum(0) - count)
    return run // begin.shape[1], torch.arange(len(run), device=run.device) + skipped.index_select(0, run)


def _keys_in_cells(position: Tensor, mask: Tensor, reach: float, rows: Tensor | None) -> Tensor:
    """Return the keys (N, C) of all people near those asked for."""
    asked = _places(mask, rows)
    present = mask & _finite(position)
    width = position.new_full((len(present), 1, 1), max(reach, torch.finfo(position.dtype).tiny))
    cells = _Cells.of(position, present, width.double())
    cell = cells.cell.new_full((present.numel(),), -1 << _BITS).index_put_((cells.place,), cells.cell)
    person, other = _expanded(*cells.runs(cell.index_select(0, asked)))
    own, other = asked.index_select(0, person), cells.place.index_select(0, other)
    x, y = position.flatten(0, 1).T.contiguous()
    dx, dy = (part.index_select(0, other) - part.index_select(0, own) for part in (x, y))
    distance2 = dx * dx + dy * dy
    stored = ((distance2 < min(reach * reach, _FAR)) & (other != own)).nonzero()[:, 0]
    person = person.index_select(0, stored)
    key = _key(distance2.index_select(0, stored), other.index_select(0, stored))
    count = person.bincount(minlength=len(asked))
    rank = torch.arange(len(person), device=person.device) - (count.cumsum(0) - count).index_select(0, person)
    keys = person.new_full((len(asked), max(1, int(count.max()))), _ABSENT + _PLACE)
    keys.view(-1)[person * keys.shape[1] + rank] = key
    return keys
