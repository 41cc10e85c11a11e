"""The nearest neighbours of people, and people on the very spot of another."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.batch import agents_of, ids_of
from pedzoo.core.geometry import direction_of, rotate

ALL_PAIRS = 128
"""People per scene up to which all pairs are compared; in larger scenes trees find them."""

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
    agents = mask.shape[1]
    most = agents - 1 if most is None else min(agents - 1, most)
    place = torch.arange(mask.numel(), device=mask.device) if rows is None else rows
    if most < 1 or not len(place):
        return place.new_zeros(0, len(place)), None
    search = _of_all_pairs if agents <= ALL_PAIRS else _of_trees
    squared, other = search(torch.where(mask.unsqueeze(-1), position, torch.nan), reach, place)
    squared, other = squared[:, :most], other[:, :most]
    near = squared < torch.inf
    least, count = (int(bound) for bound in near.sum(1).aminmax())
    index = torch.where(near, other, place.unsqueeze(1))[:, :count].T.contiguous()
    return index, None if least == count else near[:, :count].T.contiguous()


def _of_all_pairs(position: Tensor, reach: float, place: Tensor) -> tuple[Tensor, Tensor]:
    """Return squared distances (N, A), ascending and infinite from ``reach`` on, and whose they are."""
    scenes, agents = position.shape[:2]
    x, y = position.unbind(-1)
    squared = (x.unsqueeze(1) - x.unsqueeze(2)).square_()
    squared += (y.unsqueeze(1) - y.unsqueeze(2)).square_()
    squared.diagonal(dim1=1, dim2=2).fill_(torch.inf)
    squared = torch.where(squared < reach * reach, squared, torch.inf).float().flatten(0, 1)
    if len(place) < scenes * agents:
        squared = squared.index_select(0, place)
    squared, slot = squared.sort(dim=1, stable=True)
    return squared, slot + (place - place % agents).unsqueeze(1)


def _of_trees(position: Tensor, reach: float, place: Tensor) -> tuple[Tensor, Tensor]:
    """Return the same (N, C) of as many others as anybody has."""
    scenes, agents = position.shape[:2]
    points: NDArray[np.float32 | np.float64] = position.detach().cpu().numpy()
    found = []
    for scene, places in enumerate(points.astype(np.float64)):
        here = np.isfinite(places).all(-1).nonzero()[0]
        found.append(scene * agents + here[pairs_within(KDTree(places[here]), reach)])
    own, other = np.concatenate(found, axis=1)
    apart = points.reshape(-1, 2)[other] - points.reshape(-1, 2)[own]
    squared = apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1]
    order = np.lexsort((other, squared.astype(np.float32), own))
    order = order[squared[order] < reach * reach]
    own, other, squared = own[order], other[order], squared[order]
    count = np.bincount(own, minlength=scenes * agents)
    rank = np.arange(len(own)) - (count.cumsum() - count)[own]
    table = np.full((scenes * agents, max(1, count.max())), np.inf, dtype=np.float32)
    whose = np.zeros(table.shape, dtype=np.int64)
    table[own, rank], whose[own, rank] = squared, other
    few, them = (torch.from_numpy(part).to(place.device)[place] for part in (table, whose))
    return few, them


def pairs_within(points: KDTree, reach: float) -> NDArray[np.int64]:
    """Return the pairs (2, P) of points that are nearer than about ``reach``, in both directions."""
    pairs = points.query_pairs(reach * (1 + 1e-6), output_type="ndarray")
    return np.concatenate((pairs, pairs[:, ::-1])).T


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
