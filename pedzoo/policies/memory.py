"""What policies remember between decisions: of scenes, and of people since they were seen first."""

from collections.abc import Callable
from typing import Any, NamedTuple, Self, TypeVar, cast

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

_WALKS = 0.1
"""m/s: slower people stand."""

_OTHER_GOAL = 1.0
"""Metres by which a path gets longer from one decision to the next if it leads to another goal."""

_ABSENT = OBS_LEN * STEP_SECONDS
"""Seconds: agents who were away for as long as a history lasts are seen for the first time."""

Record = TypeVar("Record", bound=tuple[Any, ...])
"""A NamedTuple of tensors: ``key`` (S,) long names the scenes, ``person`` (S, A) long the agent in each slot,
-1 for none. All other fields are of scenes (S,) or of agents (S, A, ...)."""


def keys_of(scenes: TensorDictBase) -> Tensor:
    """Return the keys (S,) long by which a `SceneMemory` knows scenes."""
    return randomness.join(cast("Tensor", scenes["scene_key"]), scenes["map_id"])[:, 0]


class SceneMemory:
    """Values of agents that a policy stores between its decisions: of the last batch, and of recent scenes.

    Scenes are known by their key and floor plan, agents by their number. So resets, other environments,
    partial batches and changed slots do not mix them up.
    """

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._last: Any = None
        self._others: Any = None

    def recall(self, like: Record, person: Tensor) -> Record:
        """Return what is known of scenes, for the agents ``person`` (S, A) long, -1 where one is unknown.

        ``like`` has the scenes' keys, and the values that scenes begin with.
        """
        begin: Any = like
        self._move(begin.key.device)
        if self._last is None:
            return like
        if torch.equal(self._last.key, begin.key):
            return _align_slots(self._last, person)
        stored = self._all()
        order = stored.key.argsort()
        place = torch.searchsorted(stored.key[order], begin.key).clamp_max(len(order) - 1)
        found = _each(stored, lambda value: value[order[place]])
        known = found.key == begin.key
        values = [
            torch.where(known, value, new) if value.dim() == 1 else value
            for value, new in zip(found, begin, strict=True)
        ]
        seated = torch.where(known.unsqueeze(1), found.person, -1)
        return _align_slots(type(begin)(*values)._replace(person=seated), person)

    def keep(self, record: Record) -> None:
        """Keep the record of a batch, and those of other scenes for a while."""
        now: Any = record
        self._move(now.key.device)
        if self._last is not None and not torch.equal(self._last.key, now.key):
            stored = self._all()
            others = ~torch.isin(stored.key, now.key)
            self._others = _each(stored, lambda value: value[others][: max(MOST, 4 * len(now.key))])
        self._last = now

    def _move(self, device: torch.device) -> None:
        """Take all records to a device, where the policy goes on with scenes of another one."""
        if self._last is not None and self._last.key.device != device:
            self._last, self._others = (
                record and _each(record, lambda value: value.to(device))
                for record in (self._last, self._others)
            )

    def _all(self) -> Any:
        """Return the records of all scenes, the latest first, with empty slots where others have more."""
        if self._others is None or not len(self._others.key):
            return self._last
        slots = max(self._last.person.shape[1], self._others.person.shape[1])
        pairs = zip(_padded(self._last, slots), _padded(self._others, slots), strict=True)
        return type(self._last)(*map(torch.cat, pairs))


def _each(record: Any, change: Callable[[Tensor], Tensor], of_agents: bool = False) -> Any:
    """Return the record with changed values: all of them, or only those ``of_agents``."""
    return type(record)(*(value if of_agents and value.dim() == 1 else change(value) for value in record))


def _padded(record: Any, slots: int) -> Any:
    """Return the scenes with empty slots up to so many."""
    more = slots - record.person.shape[1]
    result = _each(record, lambda value: functional.pad(value, (*(0, 0) * (value.dim() - 2), 0, more)), True)
    return result._replace(person=functional.pad(record.person, (0, more), value=-1))


def _align_slots(record: Any, person: Tensor) -> Any:
    """Return the scenes with slots reordered to match ``person`` (S, A') long."""
    mine = record.person
    if mine.shape == person.shape and not bool(((mine >= 0) & (mine != person)).any()):
        return record
    same = (person.unsqueeze(2) == mine.unsqueeze(1)) & (person >= 0).unsqueeze(2)
    slot = same.long().argmax(2)

    def moved(value: Tensor) -> Tensor:
        index = slot.view(*slot.shape, *[1] * (value.dim() - 2))
        return value.gather(1, index.expand(*slot.shape, *value.shape[2:]))

    return _each(record, moved, True)._replace(person=torch.where(same.any(2), person, -1))


class Attempts(NamedTuple):
    """What B scenes of A people tried: whether they walked when they wished to, or were asked to."""

    tried: Tensor
    """Whether they have wished to walk since they walked last (B, A) bool."""
    asked: Tensor
    """Whether the policy asked them to walk at the last decision (B, A) bool."""
    pressing: Tensor
    """For how many decisions, one after the other, they were asked to walk and stood (B, A)."""

    @classmethod
    def none(cls, people: Tensor) -> Self:
        """Return those of people who tried nothing yet: zeros like ``people`` (B, A), of a float type."""
        never = people.new_zeros(people.shape)
        return cls(never > 0, never > 0, never)

    def seen(self, stands: Tensor) -> Self:
        """Reset people who move; count failed attempts of those who stand (B, A) bool."""
        in_vain = stands & self.asked
        pressing = (self.pressing + 1).where(in_vain, 0.0)
        return type(self)(stands & self.tried, torch.zeros_like(in_vain), pressing)

    def trying(self, wish: Tensor, step: Tensor) -> Self:
        """Return attempts with the steps (B, A, 2), metres, that people wish for, and are asked for."""
        return self._replace(tried=self.tried | walks(wish.detach()), asked=walks(step.detach()))


def walks(step: Tensor) -> Tensor:
    """Return whether people walk (...,) bool, by their steps (..., 2), metres."""
    return step.square().sum(-1) >= (_WALKS * STEP_SECONDS) ** 2


class FirstSeen(NamedTuple):
    """How agents began in S scenes of A slots; see `SceneMemory`.

    Attributes:
        key: Of the scenes (S,) long.
        person: Number of the agent in each slot (S, A) long, -1 where not all of its positions are known yet.
        history: Its first 8 known positions (S, A, 8, 2), metres.
        time: When its way to the present goal began (S, A), seconds.
        path: Length of that way then (S, A), metres.
        left: Length of the rest at the last decision (S, A), metres.
        last: When that was (S, A), seconds.
        goes_on: Whether the policy moved it on then (S, A) bool; not where it held a place.
        tried, asked, pressing: See `Attempts`, (S, A).
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


class FirstSeenMemory:
    """Adds to scene batches what they do not show.

    * ``agents/first_history`` (B, A, 8, 2): the first 8 known positions, metres.
    * ``agents/elapsed`` (B, A, 1): seconds since then, or since the present goal was given.
    * ``agents/progress`` (B, A, 1): metres by which the path to the goal has become shorter since then.
    * ``agents/called`` (B, A, 1) bool: whether another goal was given since the last decision, or the
      policy moves an agent on now that it did not move on then.
    * ``agents/hindered`` (B, A, 1) bool: whether it stands since it wished to walk in vain.
    * ``agents/pressing`` (B, A, 1): see `Attempts`.

    Batches that have them already stay as they are.
    """

    def __init__(self) -> None:
        """Remember nothing yet."""
        self._memory = SceneMemory()
        self._last: FirstSeen | None = None

    def add(self, scenes: TensorDictBase) -> TensorDictBase:
        """Return the scenes with the keys."""
        agents = agents_of(scenes)
        if "first_history" in agents.keys():
            return scenes
        mask, left = cast("Tensor", agents["mask"]), cast("Tensor", agents["remaining_path"])[..., 0]
        complete = cast("Tensor", agents["valid"]).all(-1) & mask
        person = ids_of(scenes).where(complete, -1)
        time = cast("Tensor", scenes["time"]).expand(person.shape)
        history, path = cast("Tensor", agents["history"]).detach(), left.detach()
        moves, tried = is_walking(scenes), Attempts.none(path)
        now = FirstSeen(keys_of(scenes), person, history, time, path, path, time, moves, *tried)
        before = self._memory.recall(now._replace(person=torch.full_like(person, -1)), person)
        # a scene that is walked a second time has the same key, and its clock went back
        since = time - before.last
        known = (before.person == person) & complete & (since > -1e-3) & (since < _ABSENT)
        if "sets_out" in agents.keys():
            # people who stood without a goal do not walk by that history
            still = ~walks(before.history.diff(dim=2)).any(2)
            known = known & ~(still & cast("Tensor", agents["sets_out"])[..., 0])
        on_way = known & (path < before.left + _OTHER_GOAL) & ~(moves & ~before.goes_on)
        stands = known & ~walks(history[:, :, -1] - history[:, :, -2])
        attempts = Attempts(before.tried, before.asked, before.pressing).seen(stands)
        first = now._replace(
            history=torch.where(known[..., None, None], before.history, history),
            time=torch.where(on_way, before.time, time),
            path=torch.where(on_way, before.path, path),
            **attempts._asdict(),
        )
        self._memory.keep(first)
        self._last, result = first, copied(scenes)
        seen = agents_of(result)
        seen["first_history"] = first.history
        values = time - first.time, first.path - left, known & ~on_way, attempts.tried, attempts.pressing
        for name, value in zip(
            ("elapsed", "progress", "called", "hindered", "pressing"), values, strict=True
        ):
            seen[name] = value.unsqueeze(-1)
        return result

    def remember(self, wish: Tensor, step: Tensor) -> None:
        """Remember the steps (B, A, 2), metres, that people wish for, and those that they are asked for."""
        if (last := self._last) is not None:
            attempts = Attempts(last.tried, last.asked, last.pressing).trying(wish, step)
            self._memory.keep(last._replace(**attempts._asdict()))
            self._last = None
