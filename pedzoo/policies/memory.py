"""What policies remember between decisions: of scenes, and of people since they were seen first."""

from typing import Any, Generic, NamedTuple, Self, TypeVar, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional

from pedzoo.core import randomness
from pedzoo.core.adapters import copied
from pedzoo.core.batch import agents_of, ids_of, is_walking
from pedzoo.core.types import OBS_LEN, STEP_SECONDS

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


_WALKS = 0.1
"""m/s: slower people stand."""


class Attempts(NamedTuple):
    """What B scenes of A people tried.

    Attributes:
        tried: Whether they have wished to walk since they walked last (B, A) bool.
        asked: Whether the policy asked them to walk at the last decision (B, A) bool.
        pressing: For how many decisions, one after the other, they were asked to walk and stood (B, A).
    """

    tried: Tensor
    asked: Tensor
    pressing: Tensor

    @classmethod
    def none(cls, people: Tensor) -> Self:
        """Return those of people who tried nothing yet: zeros like ``people`` (B, A), of a float type."""
        never = people.new_zeros(people.shape)
        return cls(never > 0, never > 0, never)

    def seen(self, stands: Tensor) -> Self:
        """Return the attempts of people of whom these stand (B, A) bool; others begin anew."""
        in_vain = stands & self.asked
        pressing = (self.pressing + 1).where(in_vain, 0.0)
        return type(self)(stands & self.tried, torch.zeros_like(in_vain), pressing)

    def trying(self, wish: Tensor, step: Tensor) -> Self:
        """Return attempts with the steps (B, A, 2), metres, that people wish for, and are asked for."""
        return self._replace(tried=self.tried | walks(wish.detach()), asked=walks(step.detach()))


def walks(step: Tensor) -> Tensor:
    """Return whether people walk (...,) bool, by their steps (..., 2), metres."""
    return step.square().sum(-1) >= (_WALKS * STEP_SECONDS) ** 2


_OTHER_GOAL = 1.0
"""Metres by which a path gets longer from one decision to the next if it leads to another goal."""

_ABSENT = OBS_LEN * STEP_SECONDS
"""Seconds: agents who were away for as long as a history lasts are seen for the first time."""


class FirstSeen(NamedTuple):
    """How agents began in S scenes of A slots; see `pedzoo.policies.memory`.

    Attributes:
        key: Of the scenes (S,) long.
        person: Number of the agent in each slot (S, A) long, -1 where not all of its positions are known yet.
        history: Its first 8 known positions (S, A, 8, 2), metres.
        time: When its way to the present goal began (S, A), seconds.
        path: Length of that way then (S, A), metres.
        left: Length of the rest at the last decision (S, A), metres.
        last: When that was (S, A), seconds.
        goes_on: Whether the policy moved it on then (S, A) bool; not where it held a place.
        tried: See `pedzoo.policies.memory.Attempts`, (S, A) bool, ...
        asked: ... (S, A) bool, ...
        pressing: ... and (S, A).
    """

    key: Tensor
    person: Tensor
    history: Tensor
    time: Tensor
    path: Tensor
    left: Tensor
    last: Tensor
    goes_on: Tensor
    tried: Tensor
    asked: Tensor
    pressing: Tensor

    @property
    def attempts(self) -> Attempts:
        """What they tried."""
        return Attempts(self.tried, self.asked, self.pressing)


class FirstSeenMemory:
    """Adds to scene batches what they do not show.

    * ``agents/first_history`` (B, A, 8, 2): the first 8 known positions, metres.
    * ``agents/elapsed`` (B, A, 1): seconds since then, or since the present goal was given.
    * ``agents/progress`` (B, A, 1): metres by which the path to the goal has become shorter since then.
    * ``agents/called`` (B, A, 1) bool: whether another goal was given since the last decision, or the
      policy moves an agent on now that it did not move on then.
    * ``agents/hindered`` (B, A, 1) bool: whether it stands since it wished to walk in vain.
    * ``agents/pressing`` (B, A, 1): for how many decisions, one after the other, the policy asked it to walk
      and it stood.

    Batches that have them already stay as they are.
    """

    def __init__(self) -> None:
        """Remember nothing yet."""
        self._memory = SceneMemory[FirstSeen]()
        self._last: FirstSeen | None = None

    def added(self, scenes: TensorDictBase) -> TensorDictBase:
        """Return the scenes with the keys."""
        agents = agents_of(scenes)
        if "first_history" in agents.keys():
            return scenes
        mask, left = cast("Tensor", agents["mask"]), cast("Tensor", agents["remaining_path"])[..., 0]
        complete = cast("Tensor", agents["valid"]).all(-1) & mask
        person = ids_of(scenes).where(complete, -1)
        key = randomness.join(cast("Tensor", scenes["scene_key"]), scenes["map_id"])[:, 0]
        time = cast("Tensor", scenes["time"]).expand(person.shape)
        history, path = cast("Tensor", agents["history"]).detach(), left.detach()
        moves = is_walking(scenes)
        now = FirstSeen(key, person, history, time, path, path, time, moves, *Attempts.none(path))
        before = self._memory.recall(now._replace(person=torch.full_like(person, -1)), person)
        # a scene that is walked a second time has the same key, and its clock went back
        since = time - before.last
        known = (before.person == person) & complete & (since > -1e-3) & (since < _ABSENT)
        if "sets_out" in agents.keys():
            # people who stood without a goal do not walk by that history
            still = ~walks(before.history.diff(dim=2)).any(2)
            known = known & ~(still & cast("Tensor", agents["sets_out"])[..., 0])
        sets_out = moves & ~before.goes_on
        on_way = known & (path < before.left + _OTHER_GOAL) & ~sets_out
        stands = known & ~walks(history[:, :, -1] - history[:, :, -2])
        attempts = before.attempts.seen(stands)
        first = FirstSeen(
            key,
            person,
            torch.where(known[..., None, None], before.history, history),
            torch.where(on_way, before.time, time),
            torch.where(on_way, before.path, path),
            path,
            time,
            moves,
            *attempts,
        )
        self._memory.keep(first)
        self._last = first
        result = copied(scenes)
        seen = agents_of(result)
        seen["first_history"] = first.history
        seen["elapsed"] = (time - first.time).unsqueeze(-1)
        seen["progress"] = (first.path - left).unsqueeze(-1)
        seen["called"] = (known & ~on_way).unsqueeze(-1)
        seen["hindered"] = attempts.tried.unsqueeze(-1)
        seen["pressing"] = attempts.pressing.unsqueeze(-1)
        return result

    def asked(self, wish: Tensor, step: Tensor) -> None:
        """Remember the steps (B, A, 2), metres, that people wish for, and those that they are asked for."""
        if self._last is not None:
            self._memory.keep(self._last._replace(**self._last.attempts.trying(wish, step)._asdict()))
            self._last = None
