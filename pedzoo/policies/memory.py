"""What policies remember between decisions: of agents, and of people since they were seen first."""

from typing import Any, NamedTuple, Self, TypeVar, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.adapters import copied
from pedzoo.core.batch import agents_of, ids_of, is_walking
from pedzoo.core.types import OBS_LEN, STEP_SECONDS

MOST = 2**14
"""Most stored agents beside those of the last batch; four times the last batch, if that is more."""

_WALKS = 0.1
"""m/s: slower people stand."""

_OTHER_GOAL = 1.0
"""Metres by which a path gets longer from one decision to the next if it leads to another goal."""

_ABSENT = OBS_LEN * STEP_SECONDS
"""Seconds: agents who were away for as long as a history lasts are seen for the first time."""

Record = TypeVar("Record", bound=tuple[Any, ...])
"""A NamedTuple of tensors (B, A, ...)."""


class AgentMemory:
    """Values of agents that a policy stores between its decisions: of the last batch, and of recent scenes.

    Scenes are known by their key and floor plan, agents by their number. So resets, other environments,
    partial batches and changed slots do not mix them up. Who is not in a scene any more is forgotten.
    """

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._asked: tuple[Tensor, Tensor] | None = None
        # scenes and keys, and then the values: of the last batch (B, A, ...), and of others (M, ...)
        self._last: list[Tensor] = []
        self._others: list[Tensor] = []

    def recall(self, scenes: TensorDictBase, person: Tensor, begin: Record) -> Record:
        """Return what is known of agents ``person`` (B, A) long; the others ``begin`` with something."""
        scene = randomness.join(cast("Tensor", scenes["scene_key"]), scenes["map_id"])
        key = randomness.join(scene, person)
        self._asked = scene.expand_as(key), key
        if not self._last:
            return begin
        if self._last[0].device != key.device:  # the policy goes on with scenes of another one
            self._last, self._others = (
                [part.to(key.device) for part in parts] for parts in (self._last, self._others)
            )
        make: Any = type(begin)
        if torch.equal(self._last[1], key):
            return make(*self._last[2:])
        _, keys, *values = self._all()
        order = keys.argsort()
        place = order[torch.searchsorted(keys[order], key).clamp_max(len(order) - 1)]
        known = keys[place] == key
        return make(
            *(
                torch.where(known.view(*key.shape, *[1] * (new.dim() - 2)), value[place], new)
                for value, new in zip(values, begin, strict=True)
            )
        )

    def keep(self, values: tuple[Any, ...]) -> None:
        """Keep the values of the agents who were recalled last, and those of other scenes for a while."""
        assert self._asked is not None
        scene, key = self._asked
        if self._last and not torch.equal(self._last[1], key):
            stored = self._all()
            others = ~torch.isin(stored[0], scene[:, 0])
            self._others = [part[others][: max(MOST, 4 * key.numel())] for part in stored]
        self._last = [scene, key, *values]

    def _all(self) -> list[Tensor]:
        """Return scenes, keys and values of all agents (M, ...), the latest first."""
        last = [part.flatten(0, 1) for part in self._last]
        return [torch.cat(pair) for pair in zip(last, self._others, strict=True)] if self._others else last


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
    """How agents (B, A) began: then come the fields of `Attempts`."""

    history: Tensor
    """The first 8 known positions (B, A, 8, 2), metres."""
    time: Tensor
    """When the way to the present goal began (B, A), seconds."""
    path: Tensor
    """Length of that way then (B, A), metres."""
    left: Tensor
    """Length of the rest at the last decision (B, A), metres."""
    last: Tensor
    """When that was (B, A), seconds; -inf while not all of the positions are known."""
    goes_on: Tensor
    """Whether the policy moved it on then (B, A) bool; not where it held a place."""
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
        self._memory = AgentMemory()
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
        moves, never = is_walking(scenes), torch.full_like(time, -torch.inf)
        begin = FirstSeen(history, time, path, path, never, moves, *Attempts.none(path))
        before = self._memory.recall(scenes, person, begin)
        # a scene that is walked a second time has the same key, and its clock went back
        since = time - before.last
        known = complete & (since > -1e-3) & (since < _ABSENT)
        if "sets_out" in agents.keys():
            # people who stood without a goal do not walk by that history
            still = ~walks(before.history.diff(dim=2)).any(2)
            known = known & ~(still & cast("Tensor", agents["sets_out"])[..., 0])
        on_way = known & (path < before.left + _OTHER_GOAL) & ~(moves & ~before.goes_on)
        stands = known & ~walks(history[:, :, -1] - history[:, :, -2])
        attempts = Attempts(*before[-3:]).seen(stands)
        self._last = first = FirstSeen(
            torch.where(known[..., None, None], before.history, history),
            torch.where(on_way, before.time, time),
            torch.where(on_way, before.path, path),
            path,
            torch.where(complete, time, never),
            moves,
            *attempts,
        )
        self._memory.keep(first)
        result = copied(scenes)
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
        if self._last is not None:
            attempts = Attempts(*self._last[-3:]).trying(wish, step)
            self._memory.keep((*self._last[:-3], *attempts))
            self._last = None
