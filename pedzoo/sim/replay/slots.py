"""Slots for people who come and go, and points where a recording can be cut."""

from __future__ import annotations

from heapq import heappop, heappush

import torch
from torch import Tensor


def slots(begin: Tensor, end: Tensor) -> Tensor:
    """Return slots (P,) long for people present from ``begin`` to before ``end`` (P,) long.

    As few as possible: the next person gets the free slot with the smallest number. People who are never
    present (``end`` not after ``begin``) get -1.
    """
    result = torch.full_like(begin, -1)
    free: list[int] = []
    leaving: list[tuple[int, int]] = []
    used = 0
    for person in begin.argsort(stable=True).tolist():
        comes, goes = int(begin[person]), int(end[person])
        if goes <= comes:
            continue
        while leaving and leaving[0][0] <= comes:
            heappush(free, heappop(leaving)[1])
        if not free:
            heappush(free, used)
            used += 1
        slot = heappop(free)
        heappush(leaving, (goes, slot))
        result[person] = slot
    return result


def table(slot: Tensor, begin: Tensor, end: Tensor, frames: int, most: int) -> Tensor:
    """Return the person in ``most`` slots in ``frames`` frames (most, frames) long, -1 for none."""
    occupant = torch.full((most, frames), -1)
    stays = zip(slot.tolist(), begin.tolist(), end.tolist(), strict=True)
    for person, (place, comes, goes) in enumerate(stays):
        if place >= 0:
            occupant[place, comes:goes] = person
    return occupant


def pieces(begin: Tensor, end: Tensor) -> list[Tensor]:
    """Return groups of people (each (n,) long) such that people of two groups are never there together.

    In order of time; within a group there are people from its first ``begin`` to its last ``end`` (P,).
    """
    groups: list[list[int]] = []
    until = None
    for person in begin.argsort(stable=True).tolist():
        if until is None or int(begin[person]) >= until:
            groups.append([])
            until = int(end[person])
        groups[-1].append(person)
        until = max(until, int(end[person]))
    return [torch.tensor(group) for group in groups]
