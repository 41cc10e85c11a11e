"""Who is in a scene that people enter and leave, and what has to be remembered about them."""

from __future__ import annotations

import numbers
from collections.abc import Hashable, Mapping
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.errors import UserError

PREF_SPEED = 1.3
"""Metres per second that people like whose preferred speed nobody said."""


class Roster(NamedTuple):
    """N people, in the order of their numbers: whoever names them in another order gets the same answers.

    Never written in place: a call that fails leaves everybody as they were.

    Attributes:
        row: Which row each id has.
        number: What their noise is drawn by (N,) long, see `number_of`.
        past: Latest positions (N, L, 2), oldest first; NaN for people who have just come.
        pref_speed: The speed that they like (N,), m/s.
        goal: Their goals as they were asked for (N, 2) float64; NaN where none was.
        goal_id: The planner's numbers of these (N,) long, -1 for none.
        velocity: What was decided for them (N, 2), m/s; NaN where nothing was yet.
    """

    row: dict[Hashable, int]
    number: Tensor
    past: Tensor
    pref_speed: Tensor
    goal: Tensor
    goal_id: Tensor
    velocity: Tensor

    @classmethod
    def empty(cls, length: int) -> Roster:
        """Return the roster of nobody, with room for ``length`` positions of each."""
        return cls(
            row={},
            number=torch.zeros(0, dtype=torch.long),
            past=torch.zeros(0, length, 2),
            pref_speed=torch.zeros(0),
            goal=torch.zeros(0, 2, dtype=torch.float64),
            goal_id=torch.zeros(0, dtype=torch.long),
            velocity=torch.zeros(0, 2),
        )

    @property
    def ids(self) -> list[Hashable]:
        """Everybody's id, row by row."""
        return list(self.row)

    @property
    def is_new(self) -> Tensor:
        """Who has no past (N,) bool."""
        return self.past[:, -1, 0].isnan()

    def rows(self, ids: Mapping[Any, Any]) -> Tensor:
        """Return the rows of people (n,) long."""
        return torch.tensor([self.row[one] for one in ids], dtype=torch.long)

    def names(self, which: Tensor) -> str:
        """Return the ids of some people (N,) bool for a message: the first few."""
        ids = self.ids
        found = [repr(ids[i]) for i in which.nonzero()[:, 0].tolist()]
        return ", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else "")

    def now(self, present: Mapping[Any, Any], pref_speed: float | Mapping[Any, float]) -> Roster:
        """Return the roster of exactly the people of ``present``; newcomers have neither past nor goal.

        Args:
            present: Its keys are the ids of those who are here.
            pref_speed: The speed that newcomers like, m/s: one for all, or by id (1.3 for the others).

        Raises:
            UserError: A preferred speed is not above 0.
        """
        if present.keys() == self.row.keys():
            return self
        number = {one: number_of(one) for one in present}
        ids = sorted(present, key=lambda one: (number[one], repr(one)))
        known = [i for i, one in enumerate(ids) if one in self.row]
        new = [i for i, one in enumerate(ids) if one not in self.row]
        before = torch.tensor([self.row[ids[i]] for i in known], dtype=torch.long)
        order = torch.tensor(known + new, dtype=torch.long).argsort()

        def merged(mine: Tensor, added: Tensor) -> Tensor:
            return torch.cat((mine[before], added))[order]

        def nothing(mine: Tensor) -> Tensor:
            return mine.new_full((len(new), *mine.shape[1:]), float("nan"))

        speeds = torch.tensor([_speed(ids[i], pref_speed) for i in new])
        return Roster(
            row={one: i for i, one in enumerate(ids)},
            number=torch.tensor([number[one] for one in ids], dtype=torch.long),
            past=merged(self.past, nothing(self.past)),
            pref_speed=merged(self.pref_speed, speeds),
            goal=merged(self.goal, nothing(self.goal)),
            goal_id=merged(self.goal_id, torch.full((len(new),), -1)),
            velocity=merged(self.velocity, nothing(self.velocity)),
        )


def number_of(one: Hashable) -> int:
    """Return the number that a person's noise is drawn by, from their id alone, in every process the same.

    An integer is its own number, as people of an environment are numbered. Everything else goes by its
    ``repr``, so ids whose ``repr`` holds an address get other noise in the next run.
    """
    if isinstance(one, numbers.Integral):
        return int(one) % 2**63
    return int.from_bytes(blake2b(repr(one).encode(), digest_size=8).digest()) % 2**63


FARTHEST = 1e4
"""Metres: float32 tells millimetres apart up to here."""


def as_points(given: Mapping[Any, Any], what: str) -> Tensor:
    """Return the values of a dictionary, each two numbers, as (n, 2) float64.

    Args:
        given: Tuples, lists, arrays or tensors.
        what: What messages call them.

    Raises:
        UserError: A value is anything else, or not finite.
    """
    values = [xy.detach().cpu().numpy() if isinstance(xy, Tensor) else xy for xy in given.values()]
    try:
        points = np.array(values, dtype=np.float64).reshape(len(values), 2)
    except (TypeError, ValueError):
        wrong = next((item for item in given.items() if not _is_pair(item[1])), None)
        shown = f"{what} {wrong[1]!r} of {wrong[0]!r}" if wrong else f"{what}s {given!r}"
        raise UserError(f"{shown}: expected two numbers, (x, y)") from None
    if not np.isfinite(points).all():
        one = list(given)[int((~np.isfinite(points).all(1)).argmax())]
        raise UserError(f"{what} {given[one]!r} of {one!r}: expected finite numbers, (x, y)")
    if (np.abs(points) > FARTHEST).any():
        one = list(given)[int((np.abs(points) > FARTHEST).any(1).argmax())]
        raise UserError(
            f"{what} {given[one]!r} of {one!r} is more than {FARTHEST:g} m from the origin, where "
            "centimetres are lost to rounding: subtract an offset from all positions and goals"
        )
    return torch.from_numpy(points)


def _is_pair(xy: Any) -> bool:
    try:
        return np.asarray(xy, dtype=np.float64).shape == (2,)
    except (TypeError, ValueError):
        return False


def _speed(one: Hashable, pref_speed: float | Mapping[Any, float]) -> float:
    speed = float(pref_speed.get(one, PREF_SPEED) if isinstance(pref_speed, Mapping) else pref_speed)
    if not 0 < speed < float("inf"):
        raise UserError(f"pref_speed {speed} of {one!r}: expected metres per second, above 0")
    return speed
