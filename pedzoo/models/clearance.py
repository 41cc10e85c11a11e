"""Room kept between people, and to walls: who lacks it in the next step, where they are led, who touches."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.geometry import nearest_part
from pedzoo.maps.local_walls import LocalWalls
from pedzoo.types import BODY_RADIUS

MARGIN = 0.02
"""Metres that are kept beyond a contact: what the last correction leaves undone, and corners."""

SHOULDERS = 0.71
"""Metres between two who are in a narrow place or come to one, more where their bodies need more: what
somebody takes up sideways in Weidmann, "Transporttechnik der Fussgaenger", 1993. Bodies are slimmer than
people with their arms and steps. They would squeeze past each other in a door where one person waits, and
queues of them pass faster than real ones (2.9 persons per metre and second, where Seyfried et al., "New
insights into pedestrian flow through bottlenecks", 2009, found 1.9)."""

_PLACES = 8
"""Places on a step where walls are asked for. Corners are cut between two of them by less than `MARGIN`."""


class Steps(NamedTuple):
    """What B scenes of A people are about to do.

    Attributes:
        position: Where they are (B, A, 2), metres.
        step: Where the next step leads (B, A, 2), metres; of whom the policy does not move: what they do.
        longest: Length of a step that nobody exceeds (B, A), metres.
        present: Who is there (B, A) bool.
        moved: Whose steps may be changed (B, A) bool.
        waits: Who has hardly moved of late (B, A) bool.
        radius: Of their bodies (B, A), metres.
        robot: Which of them are robots (B, A) bool.
    """

    position: Tensor
    step: Tensor
    longest: Tensor
    present: Tensor
    moved: Tensor
    waits: Tensor
    radius: Tensor
    robot: Tensor


class Pairs(NamedTuple):
    """Everybody and everybody else.

    Attributes:
        away: From each to each other's place (B, A, A, 2): mine less theirs, metres.
        apart: Its length (B, A, A), metres.
        room: Distance that is to be kept (B, A, A), metres; below 0 where nobody is.
        mine: Share of the corrections that is mine (B, A, A).
        least: Distance below which they touch (B, A, A), metres: the sum of their radii.
    """

    away: Tensor
    apart: Tensor
    room: Tensor
    mine: Tensor
    least: Tensor

    @classmethod
    def of(cls, steps: Steps, narrow: Tensor | None) -> Pairs | None:
        """Return them, None where there are none; ``narrow`` is who is in a narrow place (B, A) bool."""
        people = steps.present.shape[1]
        if people < 2:
            return None
        away = steps.position.unsqueeze(2) - steps.position.unsqueeze(1)
        apart = (away.square().sum(-1) + 1e-9).sqrt()
        both = steps.present.unsqueeze(2) & steps.present.unsqueeze(1)
        both &= ~torch.eye(people, dtype=torch.bool, device=away.device)
        yields = steps.moved & ~steps.robot
        gives = yields.unsqueeze(2) | (steps.moved.unsqueeze(2) & ~yields.unsqueeze(1))
        share = gives.to(away.dtype)
        mine = share / (share + share.mT).clamp_min(1)
        least = steps.radius.unsqueeze(2) + steps.radius.unsqueeze(1)
        wanted = _plus(least, MARGIN, 2 * BODY_RADIUS)
        if narrow is not None:
            broad = narrow.unsqueeze(2) | narrow.unsqueeze(1)
            broad &= ~(steps.waits.unsqueeze(2) & steps.waits.unsqueeze(1))
            wanted = torch.where(broad, wanted.clamp_min(SHOULDERS), wanted)
        room = torch.where(both, torch.minimum(apart, wanted), -1.0)
        return cls(away, apart, room, torch.where(both, mine, 0.0), least)

    def corrected(self, step: Tensor) -> Tensor:
        """Return everybody's steps (B, A, 2), led off others; those given where nothing is to be done."""
        move = step.unsqueeze(2) - step.unsqueeze(1)
        place, closest, gap = self._approach(move)
        lack = (self.room - gap).clamp_min(0)
        active = lack > 0
        if not bool(active.any()):
            return step
        # to the side, at the closest approach, or back, along the line between the two: what is less;
        # who meets exactly head-on has no side
        aside = torch.where(gap > 1e-3, lack / place.clamp_min(1e-3), torch.inf)
        line = self.away / self.apart.unsqueeze(-1)
        back = (self.room - self.apart - (line * move).sum(-1)).clamp_min(0)
        way = torch.where(
            (aside < back).unsqueeze(-1),
            (aside.clamp_max(1e3) / gap).unsqueeze(-1) * closest,
            back.unsqueeze(-1) * line,
        )
        way = torch.where(active.unsqueeze(-1), self.mine.unsqueeze(-1) * way, 0.0)
        # somebody whom many ask to give way need not do it for the sake of each alone
        return step + way.sum(2) / active.sum(2).clamp_min(1).sqrt().unsqueeze(-1)

    def touching(self, step: Tensor) -> Tensor:
        """Return who would run into somebody, and more than now (B, A) bool; both where it takes both."""
        bound = torch.minimum(self.room, _plus(self.least, 0.001, 2 * BODY_RADIUS)) - 1e-4
        touch = self._approach(step.unsqueeze(2) - step.unsqueeze(1))[2] < bound
        alone = touch & (self._approach(step.unsqueeze(2).expand_as(self.away))[2] < bound)
        return (touch & (alone | ~alone.mT) & (self.mine > 0)).any(2)

    def _approach(self, move: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the part of relative moves (B, A, A, 2), the place and the distance of closest approach."""
        place = nearest_part(self.away, move)
        closest = self.away + place.unsqueeze(-1) * move
        return place, closest, (closest.square().sum(-1) + 1e-9).sqrt()


class Near(NamedTuple):
    """Whoever can come to a wall within the step.

    Attributes:
        who: Which of the B * A people (N,) long.
        walls: As they see them.
        position: Where they are (N, 1, 2), metres.
        room: Distance that is to be kept (N, 1), metres.
        least: That below which a wall is touched (N, 1), metres: the radius.
        parts: Parts of a step at which walls are asked for (S,).
    """

    who: Tensor
    walls: LocalWalls
    position: Tensor
    room: Tensor
    least: Tensor
    parts: Tensor

    @classmethod
    def of(cls, steps: Steps, walls: LocalWalls, gap: Tensor) -> Near | None:
        """Return whoever a step can bring to a wall, None for nobody; ``gap`` is how far it is (B * A, 1)."""
        radius = steps.radius.flatten()
        reach = steps.longest.flatten() + radius + MARGIN
        who = ((gap[:, 0] < reach) & steps.moved.flatten()).nonzero()[:, 0]
        if not len(who):
            return None
        position = steps.position.flatten(0, 1)[who].unsqueeze(1)
        parts = torch.arange(1, _PLACES + 1, device=position.device, dtype=position.dtype) / _PLACES
        least = radius[who].unsqueeze(1)
        room = torch.minimum(gap[who], _plus(least, MARGIN, BODY_RADIUS))
        return cls(who, walls.rows(who), position, room, least, parts)

    def corrected(self, step: Tensor) -> Tensor:
        """Return everybody's steps (B, A, 2), theirs led off the walls; those given likewise."""
        flat = step.flatten(0, 1)
        mine = flat[self.who]
        gap, away = self._along(mine)
        # in the midst of a wall the way out may be the far side: places before it know better
        told = (gap > 0) | (gap <= 0).all(1, keepdim=True)
        most, place = ((self.room - gap) / self.parts * told).max(1, keepdim=True)
        if not bool((most > 0).any()):
            return step
        direction = away.gather(1, place.unsqueeze(-1).expand(-1, 1, 2))[:, 0]
        return flat.index_copy(0, self.who, mine + most.clamp_min(0) * direction).view_as(step)

    def touching(self, step: Tensor) -> Tensor:
        """Return who would touch a wall, and more than now (B, A) bool."""
        gap, _ = self._along(step.flatten(0, 1)[self.who])
        # corners are cut a little between two places
        bound = torch.minimum(self.room, _plus(self.least, MARGIN / 2, BODY_RADIUS)) - 1e-4
        found = torch.zeros(step.shape[0] * step.shape[1], dtype=torch.bool, device=step.device)
        found[self.who] = (gap < bound).any(1)
        return found.view(step.shape[:2])

    def _along(self, step: Tensor) -> tuple[Tensor, Tensor]:
        return self.walls.closest(self.position + self.parts.view(-1, 1) * step.unsqueeze(1))


def _plus(radius: Tensor, margin: float, usual: float) -> Tensor:
    """Return radii (...) plus a margin, metres; the ``usual`` one gives exactly the sum of both constants."""
    return (radius - usual) + (usual + margin)
