"""What a policy remembers of people from the moment in which it saw them first."""

from typing import NamedTuple, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.adapters import copied
from pedzoo.core.batch import agents_of, ids_of, is_walking
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.policies.learned.attempts import Attempts, walks
from pedzoo.policies.scene_memory import SceneMemory

_OTHER_GOAL = 1.0
"""Metres by which a path gets longer from one decision to the next if it leads to another goal."""

_ABSENT = OBS_LEN * STEP_SECONDS
"""Seconds: agents who were away for as long as a history lasts are seen for the first time."""


class FirstSeen(NamedTuple):
    """How agents began in S scenes of A slots; see `pedzoo.policies.scene_memory`.

    Attributes:
        key: Of the scenes (S,) long.
        person: Number of the agent in each slot (S, A) long, -1 where not all of its positions are known yet.
        history: Its first 8 known positions (S, A, 8, 2), metres.
        time: When its way to the present goal began (S, A), seconds.
        path: Length of that way then (S, A), metres.
        left: Length of the rest at the last decision (S, A), metres.
        last: When that was (S, A), seconds.
        goes_on: Whether the policy moved it on then (S, A) bool; not where it held a place.
        tried: See `pedzoo.policies.learned.attempts.Attempts`, (S, A) bool, ...
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
