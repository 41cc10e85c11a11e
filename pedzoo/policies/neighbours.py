"""The nearest neighbours of people, and people on the very spot of another."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.batch import agents_of, ids_of
from pedzoo.core.geometry import direction_of, rotate

ALL_PAIRS = 128
"""People per scene up to which all pairs are compared to see whether any share a spot."""

SPOT, ROOM = 0.02, 0.02
"""Metres: agents who are nearer to each other share a spot, and the room that they get between bodies."""


@torch.no_grad()
def nearest(
    position: Tensor, mask: Tensor, reach: float, most: int | None, rows: Tensor | None = None
) -> tuple[Tensor, Tensor | None]:
    """Return up to K others near each of N people; absent people have none and are no person's.

    They are the nearest first (in single precision), equally near ones in order. Returned are their places
    b * A + a in the flattened batch (K, N) long, the person's own where there is none, and which of the K
    there are (K, N) bool, None for all.

    Positions (B, A, 2) are in metres, anything for those absent by the ``mask`` (B, A). Others count whose
    centres are nearer than ``reach``, at most so many. ``rows`` (N,) long are the B * A people asked for.
    """
    from pedzoo.maps.walls_numba import nearest_others

    agents = mask.shape[1]
    most = agents - 1 if most is None else min(agents - 1, most)
    place = torch.arange(mask.numel(), device=mask.device) if rows is None else rows
    if most < 1 or not len(place):
        return place.new_zeros(0, len(place)), None
    host = [part.detach().cpu().contiguous().numpy() for part in (position, mask, place)]
    limit = float(torch.tensor(reach * reach, dtype=position.dtype))
    order, nothing = np.empty((2, *mask.shape), np.int64), np.empty((len(place), 0), np.int64)
    count = nearest_others(*host, reach, limit, order, nothing.astype(np.float32), nothing)
    most = min(most, int(count.max()))
    squared, other = np.full((len(place), most), np.inf, np.float32), host[2][:, None].repeat(most, 1)
    nearest_others(*host, reach, limit, order, squared, other)
    index, near = (torch.from_numpy(part.T.copy()).to(place.device) for part in (other, squared < np.inf))
    return index, None if int(count.min()) >= most else near


@torch.no_grad()
def separation_push(batch: TensorDictBase) -> Tensor:
    """Return what is added to next steps (B, A, 2), metres: 0 for people with a spot of their own.

    No policy sees a direction in which one of two on the very same spot could go aside. Those who share one
    leave it in as many directions, by the order of their numbers, counted from the way of each. One step
    leads them apart.
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
    facing = direction_of(agents["heading"][..., 0]) if way is None else way
    return rotate(away.view_as(here), facing).to(here)
