"""People on the very spot of another: no model sees a direction in which one of them could go aside."""

import math
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.batch import agents_of, ids_of
from pedzoo.core.geometry import direction_of, rotate
from pedzoo.policies.nearest_agents import ALL_PAIRS, nearest

SPOT, ROOM = 0.02, 0.02
"""Metres: agents who are nearer to each other share a spot, and the room that they get between bodies."""


@torch.no_grad()
def led_apart(batch: TensorDictBase) -> Tensor:
    """Return what is added to next steps (B, A, 2), metres: 0 for people with a spot of their own.

    Those who share one leave it in as many directions, by the order of their numbers, counted from the way
    of each. One step leads them apart.
    """
    agents = agents_of(batch)
    here, mask = cast("Tensor", agents["history"])[:, :, -1], cast("Tensor", agents["mask"])
    if mask.device.type == "cpu" and mask.shape[1] <= ALL_PAIRS:
        there = torch.where(mask.unsqueeze(-1), here, torch.nan)
        apart = torch.cdist(there, there, compute_mode="donot_use_mm_for_euclid_dist")
        if int((apart < 1.01 * SPOT).sum()) <= int(mask.sum()):  # each is close to nobody but themselves
            return torch.zeros_like(here)
    other, near = nearest(here, mask, SPOT, None)
    near = torch.ones_like(other, dtype=torch.bool) if near is None else near
    number, radius, moves = (
        cast("Tensor", values).flatten() for values in (ids_of(batch), agents["radius"], agents["controlled"])
    )
    count = 1 + near.sum(0)
    angle = 2 * math.pi * ((near & (number[other] < number)).sum(0) + 0.5) / count
    widest = torch.where(near, radius[other], 0.0).sum(0) / (count - 1).clamp_min(1)
    away = 0.5 * (radius + widest + ROOM) / (math.pi / count).sin()
    away = torch.where((near & ~moves[other]).any(0), 2 * away, away)  # others who stay make no room
    away = torch.where(moves & (count > 1), away, 0.0).unsqueeze(-1) * direction_of(angle)
    way = normalize(cast("Tensor", agents["desired_velocity"]), dim=-1) if "goal" in agents.keys() else None
    return rotate(away.view_as(here), direction_of(agents["heading"][..., 0]) if way is None else way).to(
        here
    )
