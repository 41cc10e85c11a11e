"""People who stand and are given a goal: models see them come to their place on a straight walk.

An interface makes people stand: a static start, a host that places them, a scenario in which they wait. No
model has learned to set out when it is asked to: most take a history on the spot for a standing person's.
"""

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.adapters import copied
from pedzoo.core.batch import agents_of, is_walking
from pedzoo.core.types import OBS_LEN, STEP_SECONDS

AT_FIRST = 1.0
"""Seconds within which people set out."""

_ROUNDING = 1e-3
"""Of a step."""


@torch.no_grad()
def setting_out(batch: TensorDictBase) -> TensorDictBase:
    """Return scenes in which people who stood when they were given their goal have walked until then.

    Places before that moment are on a straight line, at the desired velocity; later ones stay. So new people
    of a controller begin, too. ``agents/sets_out`` (B, A, 1) bool says who did it in the last second. Scenes
    without such people stay, as do those without ``agents/goal_since``.
    """
    agents = agents_of(batch)
    if "goal_since" not in agents.keys():
        return batch
    age = cast("Tensor", batch["time"]) - cast("Tensor", agents["goal_since"])[..., 0]
    new = age < (OBS_LEN - 1) * STEP_SECONDS - _ROUNDING
    if new.device.type == "cpu" and not bool(new.any()):
        return batch
    history = cast("Tensor", agents["history"])
    place = torch.arange(OBS_LEN, device=new.device)
    begin = (OBS_LEN - 1 - (age / STEP_SECONDS + _ROUNDING).clamp(0, OBS_LEN - 2).long()).unsqueeze(2)
    start, before = (history.gather(2, n[..., None].expand(-1, -1, -1, 2)) for n in (begin, begin - 1))
    way = cast("Tensor", agents["desired_velocity"]).unsqueeze(2) * STEP_SECONDS
    slow = (start - before).square().sum(-1) < (way / 2).square().sum(-1)
    stood = new & is_walking(batch) & slow[..., 0]
    if new.device.type == "cpu" and not bool(stood.any()):
        return batch
    line = start - way * (begin - place).unsqueeze(-1)
    result = copied(batch)
    seen = agents_of(result)
    seen["history"] = torch.where((stood.unsqueeze(2) & (place < begin)).unsqueeze(-1), line, history)
    seen["sets_out"] = (stood & (age < AT_FIRST)).unsqueeze(-1)
    return result
