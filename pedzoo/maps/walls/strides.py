"""What walls leave free on the way of agents, stride after stride. No gradient flows through it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.machine import compiles
from pedzoo.maps.walls.constants import NO_WALL
from pedzoo.maps.walls.local_walls import LocalWalls

_CHANNELS = 8
"""Numbers that compiled loops write for every stride: see `ahead`."""


class StrideLimits(NamedTuple):
    """Limits of a stride of agents (B, A). Places p with n p >= c are free, with n = 0 where no wall is near.

    Attributes:
        length: How long it may be (B, A), metres: near a wall a straight line must not cut a corner. None
            where it is known that no agent wants more.
        bound: c of the nearest wall (B, A), metres.
        normal: Its n (2, B, A), away from the wall.
        blocked_bound: c of the wall that the last stride ran into (B, A), metres; None where it is known that
            no agent did.
        blocked_normal: Its n (2, B, A).
    """

    length: Tensor | None
    bound: Tensor
    normal: Tensor
    blocked_bound: Tensor | None
    blocked_normal: Tensor


@dataclass(frozen=True)
class Keeping:
    """What agents keep from walls.

    Attributes:
        reach: Metres (B, A). An agent that begins nearer to a wall may only move out.
        within: Metres (B, A) up to where walls matter in a stride.
        rounding: Metres by which an agent may be nearer than allowed where a stride ends.
        creep: Metres of a stride of an agent that is inside a wall.
    """

    reach: Tensor
    within: Tensor
    rounding: float
    creep: float


def walls_ahead(walls: LocalWalls, place: Tensor, keeping: Keeping, wanted: Tensor, each: int) -> WallsAhead:
    """Return the walls around agents that begin at a place.

    Args:
        walls: As agents see them.
        place: Where they begin (2, B, A), metres.
        keeping: What they keep from walls.
        wanted: How long strides would be without walls (S, B, A), metres.
        each: How many strides in turn are that long.
    """
    kind = CompiledWallsAhead if compiles(place, keeping.reach) else WallsAhead
    return kind(walls, place, keeping, wanted, each)


class WallsAhead:
    """The walls around agents that go from one place to the next.

    Attributes:
        limits: Of the next stride.
    """

    limits: StrideLimits

    def __init__(self, walls: LocalWalls, place: Tensor, keeping: Keeping, wanted: Tensor, each: int) -> None:
        """Look at the place where agents begin: see `walls_ahead`."""
        self._walls, self._keeping = walls, keeping
        self._wall = walls.half_planes(place, keeping.within)
        self._allowed = self._wall[0].minimum(keeping.reach)
        self._wall[1].add_(self._allowed)
        self._no_wall = self._wall.new_zeros(4, 1, 1)
        self._no_wall[1] = -NO_WALL
        self._limit(self._no_wall.expand_as(self._wall))

    def arrive(self, place: Tensor) -> Tensor | None:
        """Limit the next stride of agents whose stride ended at a place (2, B, A).

        Returns:
            1 for agents that may be there, 0 for those that are too near to a wall and go back (B, A). None
            where it is known that all may.
        """
        keeping, allowed = self._keeping, self._allowed
        wall = self._walls.half_planes(place, keeping.within)
        gap = wall[0]
        stuck = gap < allowed - keeping.rounding
        self._allowed = gap.clamp(allowed, keeping.reach)
        wall[1].add_(self._allowed)
        blocked = torch.where(stuck, wall, self._no_wall)
        self._wall = torch.where(stuck, self._wall, wall)
        self._limit(blocked)
        return (~stuck).to(place.dtype)

    def _limit(self, blocked: Tensor) -> None:
        length = self._allowed.clamp_min(self._keeping.creep)
        self.limits = StrideLimits(length, self._wall[1], self._wall[2:], blocked[1], blocked[2:])


class CompiledWallsAhead(WallsAhead):
    """The same by one compiled loop for each stride, in single precision on the CPU."""

    def __init__(self, walls: LocalWalls, place: Tensor, keeping: Keeping, wanted: Tensor, each: int) -> None:
        """See `WallsAhead`."""
        from pedzoo.maps.walls.compiled_walls import ahead

        size, strides = keeping.reach.shape, len(wanted) * each
        # a column for each stride: what autograd has saved of one stays as it is
        columns = place.new_empty(_CHANNELS, strides + 1, *size)
        length, bound, blocked, gets_there = columns[:4].unbind()
        normal, blocked_normal = columns[4:6].unbind(1), columns[6:].unbind(1)
        parts = length.unbind(), bound.unbind(), normal, blocked.unbind(), blocked_normal
        self._limits = [StrideLimits(*part) for part in zip(*parts, strict=True)]
        self._gets_there, self._done = gets_there.unbind(), -1
        kept = (keeping.within, keeping.reach, torch.empty(size), wanted)
        arrays = (*(part.detach().numpy() for part in kept), each, keeping.rounding, keeping.creep)
        self._look, self._arrays = ahead, (*arrays, *walls.arrays, columns.numpy())
        self.arrive(place)

    def arrive(self, place: Tensor) -> Tensor | None:
        """See `WallsAhead.arrive`."""
        self._done += 1
        stuck, short = self._look(self._done, place.detach().numpy(), *self._arrays)
        limits = self._limits[self._done]
        if not short:
            limits = limits._replace(length=None)
        self.limits = limits if stuck else limits._replace(blocked_bound=None)
        return self._gets_there[self._done] if stuck else None
