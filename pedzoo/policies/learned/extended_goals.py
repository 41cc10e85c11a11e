"""Goals moved out to where people are 3.2 s later, also where the way bends before."""

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional

from pedzoo.core.adapters import copied
from pedzoo.core.batch import agents_of
from pedzoo.core.types import AHEAD_SECONDS


def extend_goals(batch: TensorDictBase) -> TensorDictBase:
    """Return scenes in which no short-term goal is nearer than where the desired velocity leads in 3.2 s.

    Goals ``window_end`` of recordings are where people are 3.2 s later. A model that learned from them slows
    down for a near goal. A planner's goal is near where the path turns a corner: people go round it at their
    own speed. Nearer goals are moved out along the line to them. Scenes without goals stay.
    """
    agents = agents_of(batch)
    if "goal" not in agents.keys():
        return batch
    position = cast("Tensor", agents["history"])[:, :, -1]
    goal, desired = (cast("Tensor", agents[key]) for key in ("goal", "desired_velocity"))
    away = goal - position
    # an agent on its goal goes on as desired
    ahead = functional.normalize(away + 0.1 * functional.normalize(desired, dim=-1), dim=-1)
    lacking = AHEAD_SECONDS * desired.norm(dim=-1, keepdim=True) - away.norm(dim=-1, keepdim=True)
    scenes = copied(batch)
    scenes["agents", "goal"] = goal + torch.where(lacking > 0, lacking * ahead, 0.0)
    return scenes
