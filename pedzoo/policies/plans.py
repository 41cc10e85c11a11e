"""Decided steps of a team that are not walked yet, kept between the decisions of a crowd.

Scenes are known by their key and floor plan, people by their number. So resets, other environments in
between, parts of a batch and changed slots mix nothing up.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

MOST = 1024
"""Scenes that are kept beside those of the last batch, or four times as many as that has."""


class Plans(NamedTuple):
    """Velocities that are being walked in S scenes of A slots.

    Attributes:
        key: Of the scenes (S,) long.
        decided: When the whole team decided last (S,), seconds; -inf for never.
        person: Number of the team's person in each slot (S, A) long, -1 for none.
        begun: When each person's velocities were decided (S, A), seconds.
        velocity: For each of the N decisions of the crowd from then on (S, A, N, 2), m/s.
    """

    key: Tensor
    decided: Tensor
    person: Tensor
    begun: Tensor
    velocity: Tensor

    @classmethod
    def none(cls, key: Tensor, time: Tensor, person: Tensor, velocity: Tensor) -> Plans:
        """Return plans of scenes (S,) in which nothing was decided, like times (S,) and the last fields."""
        never = torch.full_like(time, -torch.inf)
        return cls(
            key,
            never,
            torch.full_like(person, -1),
            never.unsqueeze(1).expand(person.shape),
            torch.zeros_like(velocity),
        )

    def rows(self, index: Tensor) -> Plans:
        """Return some of the scenes; ``index`` is long or bool."""
        return Plans(*(value[index] for value in self))

    def padded(self, slots: int) -> Plans:
        """Return the scenes with empty slots up to so many."""
        more = slots - self.person.shape[1]
        return self._replace(
            person=functional.pad(self.person, (0, more), value=-1),
            begun=functional.pad(self.begun, (0, more), value=-torch.inf),
            velocity=functional.pad(self.velocity, (0, 0, 0, 0, 0, more)),
        )

    def seated(self, person: Tensor) -> Plans:
        """Return the plans with people in the slots that they have among persons (S, A') long."""
        moved = (self.person >= 0) & (self.person != person) if self.person.shape == person.shape else None
        if moved is not None and not bool(moved.any()):
            return self
        same = (person.unsqueeze(2) == self.person.unsqueeze(1)) & (person >= 0).unsqueeze(2)
        slot = same.long().argmax(2)
        whole = slot[..., None, None].expand(*slot.shape, *self.velocity.shape[2:])
        return self._replace(
            person=torch.where(same.any(2), person, -1),
            begun=self.begun.gather(1, slot),
            velocity=self.velocity.gather(1, whole),
        )


class Memory:
    """The plans of one team in all scenes that it has met of late."""

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._last: Plans | None = None
        self._others: Plans | None = None

    def recall(self, like: Plans, person: Tensor) -> Plans:
        """Return the stored plans of scenes; ``like`` stands for unknown scenes."""
        if self._last is None:
            return like
        if _same(self._last.key, like.key):
            return self._last.seated(person)
        stored = self._all()
        order = stored.key.argsort()
        place = torch.searchsorted(stored.key[order], like.key).clamp_max(len(order) - 1)
        result = stored.rows(order[place])
        known = result.key == like.key
        result = result._replace(
            key=like.key,
            decided=torch.where(known, result.decided, -torch.inf),
            person=torch.where(known.unsqueeze(1), result.person, -1),
        )
        return result.seated(person)

    def keep(self, plans: Plans) -> None:
        """Keep the plans of a batch, and those of other scenes for a while."""
        if self._last is not None and not _same(self._last.key, plans.key):
            stored = self._all()
            others = stored.rows(~torch.isin(stored.key, plans.key))
            most = max(MOST, 4 * len(plans.key))
            self._others = Plans(*(value[:most] for value in others))
        self._last = plans

    def _all(self) -> Plans:
        """Return the plans of all scenes, the latest first."""
        assert self._last is not None
        if self._others is None or not len(self._others.key):
            return self._last
        slots = max(self._last.person.shape[1], self._others.person.shape[1])
        pairs = zip(self._last.padded(slots), self._others.padded(slots), strict=True)
        return Plans(*(torch.cat(pair) for pair in pairs))


def _same(one: Tensor, other: Tensor) -> bool:
    return one.shape == other.shape and bool((one == other).all())
