"""Values of agents that a policy stores between its decisions, for all recent scenes.

Scenes are known by their key and floor plan, agents by their number. So resets, other environments, partial
batches and changed slots do not mix them up.
"""

from typing import Any, Generic, TypeVar, cast

import torch
from torch import Tensor
from torch.nn import functional

MOST = 1024
"""Most stored scenes beside those of the last batch; four times the last batch, if that is more."""

Record = TypeVar("Record", bound=tuple[Any, ...])
"""A NamedTuple of tensors: ``key`` (S,) long names the scenes, ``person`` (S, A) long the agent in each slot,
-1 for none. All other fields are of scenes (S,) or of agents (S, A, ...)."""


class SceneMemory(Generic[Record]):
    """The records of the last batch, and of other scenes for a while."""

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._last: Record | None = None
        self._others: Record | None = None

    def recall(self, like: Record, person: Tensor) -> Record:
        """Return what is known of scenes, for the agents ``person`` (S, A) long, -1 where one is unknown.

        ``like`` has the scenes' keys, and the values that scenes begin with.
        """
        if self._last is None:
            return like
        self._move(_key(like).device)
        if _same(_key(self._last), _key(like)):
            return _seated(self._last, person)
        stored = self._all()
        order = _key(stored).argsort()
        place = torch.searchsorted(_key(stored)[order], _key(like)).clamp_max(len(order) - 1)
        result = _rows(stored, order[place])
        known = _key(result) == _key(like)
        values = [
            torch.where(known, value, new) if value.dim() == 1 else value
            for value, new in zip(result, like, strict=True)
        ]
        result = _made(like, values)._replace(person=torch.where(known.unsqueeze(1), _person(result), -1))
        return _seated(result, person)

    def keep(self, record: Record) -> None:
        """Keep the record of a batch, and those of other scenes for a while."""
        self._move(_key(record).device)
        if self._last is not None and not _same(_key(self._last), _key(record)):
            stored = self._all()
            others = _rows(stored, ~torch.isin(_key(stored), _key(record)))
            self._others = _rows(others, slice(max(MOST, 4 * len(_key(record)))))
        self._last = record

    def _move(self, device: torch.device) -> None:
        """Take all records to a device, where the policy goes on with scenes of another one."""
        if self._last is not None and _key(self._last).device != device:
            self._last = _made(self._last, [value.to(device) for value in self._last])
            if self._others is not None:
                self._others = _made(self._others, [value.to(device) for value in self._others])

    def _all(self) -> Record:
        """Return the records of all scenes, the latest first."""
        assert self._last is not None
        if self._others is None or not len(_key(self._others)):
            return self._last
        slots = max(_person(self._last).shape[1], _person(self._others).shape[1])
        pairs = zip(_padded(self._last, slots), _padded(self._others, slots), strict=True)
        return _made(self._last, [torch.cat(pair) for pair in pairs])


def _key(record: Any) -> Tensor:
    return cast("Tensor", record.key)


def _person(record: Any) -> Tensor:
    return cast("Tensor", record.person)


def _made(like: Any, values: list[Tensor]) -> Any:
    return type(like)(*values)


def _rows(record: Any, index: Any) -> Any:
    """Return some of the scenes."""
    return _made(record, [value[index] for value in record])


def _padded(record: Any, slots: int) -> Any:
    """Return the scenes with empty slots up to so many."""
    more = slots - _person(record).shape[1]
    values = [
        value if value.dim() == 1 else functional.pad(value, (*(0, 0) * (value.dim() - 2), 0, more))
        for value in record._replace(person=_person(record) + 1)
    ]
    result = _made(record, values)
    return result._replace(person=_person(result) - 1)


def _seated(record: Any, person: Tensor) -> Any:
    """Return the scenes with agents in the slots that they have among ``person`` (S, A') long."""
    mine = _person(record)
    if mine.shape == person.shape and not bool(((mine >= 0) & (mine != person)).any()):
        return record
    same = (person.unsqueeze(2) == mine.unsqueeze(1)) & (person >= 0).unsqueeze(2)
    slot = same.long().argmax(2)
    values = [
        value
        if value.dim() == 1
        else value.gather(
            1, slot.view(*slot.shape, *[1] * (value.dim() - 2)).expand(*slot.shape, *value.shape[2:])
        )
        for value in record
    ]
    return _made(record, values)._replace(person=torch.where(same.any(2), person, -1))


def _same(one: Tensor, other: Tensor) -> bool:
    return one.shape == other.shape and bool((one == other).all())
