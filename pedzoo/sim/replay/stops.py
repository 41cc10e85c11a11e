"""Where recorded people stop on their way, and for how long: goals with a pause for those who replay them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.tracks import Tracks

STANDS = 0.1
"""m/s: below it people stand."""

LEAST = 5
"""Steps of 0.4 s: shorter stays are part of walking."""


class Stops(NamedTuple):
    """Up to K stops of each of P people, in order.

    Attributes:
        place: Where they are (P, K, 2), metres.
        pause: For how long (P, K), seconds; 0 for no stop.
        goal_id: The planner's numbers of the places (P, K) long, -1 for none.
    """

    place: Tensor
    pause: Tensor
    goal_id: Tensor

    @classmethod
    def none(cls, people: int, device: torch.device | str = "cpu") -> Stops:
        """Return those of people who never stop."""
        nothing = torch.zeros(people, 0, device=device)
        return cls(nothing.unsqueeze(2).expand(-1, -1, 2), nothing, nothing.long())

    @classmethod
    def joined(cls, parts: list[Stops]) -> Stops:
        """Return the stops of several recordings, one after the other."""
        most = max(part.pause.shape[1] for part in parts)
        same = [part.widened(most) for part in parts]
        return cls(*(torch.cat(values) for values in zip(*same, strict=True)))

    def widened(self, width: int) -> Stops:
        """Return the same stops in ``width`` columns."""
        more = width - self.pause.shape[1]
        return Stops(
            pad(self.place, (0, 0, 0, more)),
            pad(self.pause, (0, more)),
            pad(self.goal_id, (0, more), value=-1),
        )

    def only(self, which: Tensor) -> Stops:
        """Return the stops for which ``which`` (P, K) bool, those of each person in order from the first."""
        order = (~which).long().argsort(dim=1, stable=True)
        left = which.gather(1, order)
        width = int(left.sum(1).max()) if which.numel() else 0
        order, left = order[:, :width], left[:, :width]
        return Stops(
            self.place.gather(1, order.unsqueeze(2).expand(-1, -1, 2)) * left.unsqueeze(2),
            self.pause.gather(1, order) * left,
            self.goal_id.gather(1, order).where(left, -1),
        )

    def goals(self, exit: Tensor) -> Tensor:
        """Return all goals in turn (P, K + 2) long, -1 after the last, for the numbers of exits (P,)."""
        count = (self.pause > 0).sum(1, keepdim=True)
        return pad(self.goal_id, (0, 2), value=-1).scatter(1, count, exit.unsqueeze(1))


def stops_of(tracks: Tracks, begin: np.ndarray, taken: np.ndarray) -> Stops:
    """Return the stops of people after they are taken over, without numbers of goals.

    A stop is a run of at least 5 steps in which the mean of three positions moves by less than 0.1 m/s.

    Args:
        tracks: Rows in every frame of 0.4 s, person after person.
        begin: First row of each person (P,).
        taken: Row in which they are taken over (P,).
    """
    row, rows = np.arange(len(tracks)), len(tracks)
    person = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, rows)))
    first, last = begin[person], np.append(begin[1:], rows)[person] - 1
    xy = tracks.xy
    coarse = (xy[np.maximum(row - 1, first)] + xy + xy[np.minimum(row + 1, last)]) / 3
    step = np.linalg.norm(np.diff(coarse, axis=0, prepend=coarse[:1]), axis=1) / STEP_SECONDS
    stands = (step < STANDS) & (row > taken[person])
    is_standing_still = stands[1:] & stands[:-1] & (person[1:] == person[:-1])
    opens = np.flatnonzero(stands & ~np.append(False, is_standing_still))
    closes = np.flatnonzero(stands & ~np.append(is_standing_still, False))
    long = closes - opens + 1 >= LEAST
    opens, closes = opens[long], closes[long]
    sums = np.append(np.zeros((1, 2)), xy.cumsum(0), axis=0)
    steps = closes - opens + 1
    of = person[opens]
    number = np.arange(len(of)) - np.searchsorted(of, of)
    place = np.zeros((len(begin), int(number.max(initial=-1)) + 1, 2))
    pause = np.zeros(place.shape[:2])
    place[of, number] = (sums[closes + 1] - sums[opens]) / steps[:, None]
    pause[of, number] = steps * STEP_SECONDS
    return Stops(
        torch.from_numpy(place).float(),
        torch.from_numpy(pause).float(),
        torch.full(pause.shape, -1),
    )
