"""Room kept between people and to walls: who goes first, steps that lack room, ways out, and contacts.

Coordinates come first and people last, (2, ..., B, A): on the CPU several times faster than pairs. Nothing
is read back to the host. `pedzoo.policies.clearance_loops` says the same in compiled loops.

Of two people, the one who is ahead where both want to go goes first. People who press towards one place so
have an order, by their distance from it, and the first of them is held up by none of the others: no arch of
people holds itself. Of two who wait and are equally far, as where two groups meet, a number drawn for each
decides.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import limit_speed, limited
from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.maps.walls import LocalWalls

LEAST_ASKED = 0.05  # metres: a shorter step that is asked for has less of a direction
AHEAD = 0.2  # metres ahead of another from which on precedence is full
TIE = 0.05  # the same for two who wait; it is also the lead of the one with the higher rank
EVEN, BARELY = 1e-5, 0.01  # metres: a smaller lead is none, and then the higher rank is such a share of one
LEAD_SECONDS = 0.2  # who comes faster is ahead by so much of the difference: others go on to make way
SPREAD = 0.04  # metres beyond what bodies need that people who wait keep, so that they can give way
LEAST_SHARE = 0.05  # share of a correction that a person with full precedence makes
ROUNDS = 8  # corrections at most: each may undo a part of another
SHARES = 1.0, 0.5, 0.15, 0.0  # step fractions of the backtracking search
NARROW = 0.5  # metres to a wall, before or after the step: in the open people turn a shoulder and pass closer
MARGIN = 0.02  # metres kept beyond a contact, for corners and the error of the last correction
FIRST = 0.125  # d(position at 0.1 s) / d(step): half of it is the old velocity's
BEYOND = 1.125  # part of a step that is to be clear: a body that turns off goes on for half of 0.1 s
HEAD_ON = 1e-3  # metres: two who would pass each other nearer than this have no side of their own
ROUNDING = 1e-5  # metres: a pair that lacks less room asks for no correction
_QUARTER = TRACE_SECONDS / STEP_SECONDS

SHOULDERS = 0.71
"""Metres between two people in or near a narrow place; more where their bodies need more.

A person takes up so much sideways in Weidmann, "Transporttechnik der Fussgaenger", 1993: bodies are slimmer
than people with their arms and steps. With bodies alone people would squeeze past a waiting person in a
door. Their queues would have 2.9 persons per metre and second; real ones have 1.9 (Seyfried et al., "New
insights into pedestrian flow through bottlenecks", 2009).
"""


@torch.no_grad()
def precedence(step: Tensor, away: Tensor, wait: Tensor, rank: Tensor | None, velocity: Tensor) -> Tensor:
    """Return how clearly the first of two goes before the second (B, A, A): 1, or -1 for behind, 0: neither.

    ``step`` is where people want to go (B, A, 2), metres, ``away`` from each to each other's place
    (2, B, A, A). Pairs ``wait`` (B, A, A) where both do. See `ProposedSteps` for the rank and the velocity.
    """
    step = step.movedim(-1, 0)
    toward = step / step.norm(dim=0).clamp_min(LEAST_ASKED)
    ahead = 0.5 * (away * (toward.unsqueeze(3) + toward.unsqueeze(2))).sum(0)
    forward = LEAD_SECONDS * (toward * velocity.movedim(-1, 0)).sum(0)
    ahead = ahead + forward.unsqueeze(2) - forward.unsqueeze(1)
    tie = torch.zeros_like(ahead) if rank is None else (rank.unsqueeze(2) - rank.unsqueeze(1)).sign()
    lead = torch.where(ahead.abs() < EVEN, BARELY * tie, ahead / AHEAD)
    return torch.where(wait, ahead / TIE + tie, lead).clamp(-1, 1)


@torch.no_grad()
def passing(step: Tensor, away: Tensor) -> Tensor:
    """Return how near the step of one leads to the place of the other (B, A, A), metres; see `precedence`.

    Infinite where it leads away.
    """
    step = step.movedim(-1, 0).unsqueeze(3)
    part = (-(away * step).sum(0) / step.square().sum(0).clamp_min(1e-9)).clamp_max(1)
    return torch.where(part > 0, (away + part * step).norm(dim=0), torch.inf)


def places(like: Tensor) -> tuple[Tensor, Tensor]:
    """Return where on a step walls are asked for, each as much of the places after 0.1, 0.3 and 0.4 s (9, 3).

    Corners are cut between two of them by less than `MARGIN`; the last one is beyond the step. Then return
    how much they move with the step (9,).
    """
    eighth = torch.arange(1, 9, device=like.device, dtype=like.dtype)
    between, ends = (eighth - 2) / 4, (eighth - 6) / 2
    parts = torch.stack(((eighth / 2).minimum(1 - between), between.minimum(1 - ends), ends), 1).clamp_min(0)
    parts = torch.cat((parts, BEYOND * parts[-1:]))
    return parts, FIRST * parts[:, 0] + (1 - _QUARTER) * parts[:, 1] + parts[:, 2]


class ProposedSteps(NamedTuple):
    """The proposed steps of B scenes of A people.

    Attributes:
        position: Where they are (B, A, 2), metres.
        step: Where the next step leads (B, A, 2), metres; agents that the policy does not move go on.
        longest: Greatest length of a step (B, A), metres.
        present: Which agents are there (B, A) bool.
        moved: Which agents' steps may be changed (B, A) bool.
        waits: Which agents have hardly moved of late (B, A) bool.
        radius: Of their bodies (B, A), metres.
        robot: Which of them are robots (B, A) bool.
        velocity: With which they begin the step (B, A, 2), m/s: the simulation blends it with the new one.
        rank: Of two people side by side, the one of higher rank goes first (B, A). None: none does.
    """

    position: Tensor
    step: Tensor
    longest: Tensor
    present: Tensor
    moved: Tensor
    waits: Tensor
    radius: Tensor
    robot: Tensor
    velocity: Tensor
    rank: Tensor | None = None

    def integrate(self, step: Tensor) -> Tensor:
        """Return where steps (B, A, 2) lead after 0.1, 0.3 and 0.4 s (3, 2, B, A), metres from here.

        As `pedzoo.core.geometry.blended` does, straight in between.
        """
        step = step.movedim(-1, 0)
        straight = torch.stack((_QUARTER * step, (1 - _QUARTER) * step, step))
        command = _QUARTER * step
        half = 0.5 * (TRACE_SECONDS * self.velocity.movedim(-1, 0) - command)
        size, length = ((values.square().sum(0) + 1e-12).sqrt() for values in (half, command))
        half = half * (length / size).clamp_max(1.0)
        begin = limited(command + half, _QUARTER * self.longest)
        middle = begin + 2 * limited(command - 0.5 * half, _QUARTER * self.longest)
        return torch.where(self.moved, torch.stack((begin, middle, middle + command)), straight)


class PairConstraints(NamedTuple):
    """Every agent and every other agent (B, A, A), in metres.

    Attributes:
        away: From each to each other's place (2, B, A, A): mine less theirs.
        apart: Its length.
        room: Distance that is to be kept on four straight parts (4, B, A, A), below 0 for absent agents: the
            way to the end of the step, the first 0.1 s, the next 0.2 s, and what lies beyond the step.
        mine: Share of the correction that the first agent of a pair makes.
        least: Distance below which they touch: the sum of their radii.
        stands: Which agents wait in the way of one who waits, too, and goes first, or press on that one
            (B, A) bool: they stand but for corrections, by which they make way.
    """

    away: Tensor
    apart: Tensor
    room: Tensor
    mine: Tensor
    least: Tensor
    stands: Tensor

    @classmethod
    def of(cls, steps: ProposedSteps, narrow: Tensor | None, shoulders: float = SHOULDERS) -> PairConstraints:
        """Return the pairs, of whom those that are ``narrow`` (B, A) bool need ``shoulders``, metres."""
        position = steps.position.movedim(-1, 0)
        away = position.unsqueeze(3) - position.unsqueeze(2)
        apart = (away.square().sum(0) + 1e-9).sqrt()
        both = steps.present.unsqueeze(2) & steps.present.unsqueeze(1)
        both &= ~torch.eye(both.shape[1], dtype=torch.bool, device=away.device)
        yields = steps.moved & ~steps.robot
        gives = yields.unsqueeze(2) | (steps.moved.unsqueeze(2) & ~yields.unsqueeze(1))
        share = gives.to(away.dtype)
        wait = steps.waits.unsqueeze(2) & steps.waits.unsqueeze(1)
        order = precedence(steps.step, away, wait, steps.rank, steps.velocity)
        order = torch.where(yields.unsqueeze(2) & yields.unsqueeze(1), order, 0.0)
        mine = share / (share + share.mT).clamp_min(1) - (0.5 - LEAST_SHARE) * order
        least = steps.radius.unsqueeze(2) + steps.radius.unsqueeze(1)
        bodies = wanted = least + MARGIN
        past = passing(steps.step, away)
        # people who press on one ahead would hold up that one's way back
        presses = (past < bodies) & (apart < bodies + SPREAD)
        stands = (both & wait & (order < 0) & ((past.mT < bodies) | presses)).any(2)
        if narrow is not None:
            broad = (narrow.unsqueeze(2) | narrow.unsqueeze(1)) & ~wait
            # the other need not make more room than the one who goes first takes
            room = torch.where(order > 0.5, past, torch.where(order < -0.5, past.mT, shoulders))
            wanted = torch.where(broad, wanted.maximum(room.clamp_max(shoulders)), wanted)
        rest = torch.where(apart < least, bodies, torch.minimum(apart, bodies))  # those who touch part
        rest = torch.where(wait & (order != 0), bodies + SPREAD, rest)
        firm = torch.minimum(apart, bodies)
        room = torch.where(both, torch.stack((torch.minimum(apart, wanted), firm, firm, rest)), -1.0)
        return cls(away, apart, room, torch.where(both, mine, 0.0), least, stands)

    def correction(self, walk: Tensor) -> Tensor:
        """Return the changes (2, B, A) of the steps of a ``walk`` that lead people off others."""
        move = walk.unsqueeze(4) - walk.unsqueeze(3)
        part, at, gap = self._approach(move)
        lack, worst = (self.room - gap).max(0, keepdim=True)
        middle = FIRST + (1 - _QUARTER - FIRST) * part[2]
        weights = part[0], FIRST * part[1], middle, torch.full_like(middle, BEYOND)
        weight = torch.stack(weights).gather(0, worst)[0]
        at = at.gather(1, worst.expand(2, *lack.shape))[:, 0]
        gap, lack = gap.gather(0, worst)[0], lack[0]
        line = self.away / self.apart
        # two who meet exactly head-on keep to the right
        tie = gap < HEAD_ON
        at = torch.where(tie, HEAD_ON * torch.stack((-line[1], line[0])).detach(), at)
        lack, gap = torch.where(tie, lack + gap - HEAD_ON, lack), gap.clamp_min(HEAD_ON)
        active = lack > ROUNDING
        # to the side, at the closest approach, or back, along the line between the two: what is less
        aside = lack / weight.clamp_min(1e-3)
        aside = torch.where(tie, aside.detach(), aside)
        full = (line * move[2]).sum(0)
        begin = (self.room[1] - self.apart - (line * move[0]).sum(0)) / FIRST
        back = (self.room[0] - self.apart - full).maximum(begin)
        back = back.maximum((self.room[3] - self.apart) / BEYOND - full)
        way = torch.where(aside < back, (aside.clamp_max(1e3) / gap) * at, back.clamp_min(0) * line)
        way = torch.where(active, self.mine * way, 0.0)
        # an agent with many corrections need not make each of them alone
        return way.sum(3) / active.sum(2).clamp_min(1).sqrt()

    def touching(self, mine: Tensor, theirs: Tensor) -> Tensor:
        """Return which pairs run into each other (B, A, A) bool, and more than now, on walks (3, 2, B, A)."""
        bound = torch.minimum(self.room, self.least + 0.004) - 1e-4
        return (self._approach(mine.unsqueeze(4) - theirs.unsqueeze(3))[2] < bound)[:3].any(0)

    def _approach(self, move: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return where each of four parts of relative walks (3, 2, B, A, A) comes closest.

        That is the share of it (4, B, A, A), the place there (2, 4, B, A, A) and its distance (4, B, A, A).
        """
        beyond = self.away + BEYOND * move[2]
        begin = torch.stack((self.away, self.away, self.away + move[0], beyond), 1)
        go = torch.stack((move[2], move[0], move[1] - move[0], torch.zeros_like(beyond)), 1)
        part = -(begin * go).sum(0) / go.square().sum(0).clamp_min(1e-9)
        part = part.detach().clamp(0, 1)
        at = begin + part * go
        return part, at, (at.square().sum(0) + 1e-9).sqrt()


class WallConstraints(NamedTuple):
    """Walls on the ways of agents (B, A), and the distances that are to be kept from them (B, A), metres."""

    steps: ProposedSteps
    walls: LocalWalls
    room: Tensor
    parts: Tensor  # of `places`
    weight: Tensor  # (S, 1, 1)

    def correction(self, walk: Tensor) -> Tensor:
        """Return the changes (2, B, A) of the steps of a ``walk`` that lead people off walls."""
        gap, away = self._along(walk)
        # in the midst of a wall the way out may be the far side: places before it know better
        outside = (gap > 0) | (gap <= 0).all(0)
        most, place = ((self.room - gap) / self.weight * outside).max(0, keepdim=True)
        direction = away.gather(1, place.expand(2, *place.shape))[:, 0]
        return torch.where(self.steps.moved, most.clamp_min(0) * direction, 0.0)

    def touching(self, walk: Tensor) -> Tensor:
        """Return which agents would touch a wall, and more than now (B, A) bool."""
        gap, _ = self._along(walk)
        # corners are cut a little between two places
        bound = torch.minimum(self.room, self.steps.radius + MARGIN / 2) - 1e-4
        return (gap[:-1] < bound).any(0) & self.steps.moved

    def _along(self, walk: Tensor) -> tuple[Tensor, Tensor]:
        """Return distances to walls (S, B, A) along a walk, and where they grow (2, S, B, A)."""
        places = (self.parts @ walk.flatten(1)).unflatten(1, walk.shape[1:]).transpose(0, 1)
        places = self.steps.position.movedim(-1, 0).unsqueeze(1) + places
        gap, away = self.walls.look(places.detach(), on_edges=False)
        if places.requires_grad:
            gap = gap + ((places - places.detach()) * away).sum(0)
        return gap, away


def kept_clear_in_torch(
    steps: ProposedSteps, walls: LocalWalls | None, shoulders: float = SHOULDERS
) -> Tensor:
    """`kept_clear` on any device and in any precision."""
    narrow = wall_constraints = None
    if walls is not None:
        walls = walls.per_scene()
        ends = torch.stack((steps.position, steps.position + steps.step), 2).detach().movedim((3, 2), (0, 1))
        gap, away = walls.look(ends, on_edges=False)
        narrow = (gap < NARROW).any(0)
        here = steps.position.movedim(-1, 0)
        room = (gap[0] + ((here - here.detach()) * away[:, 0]).sum(0)).minimum(steps.radius + MARGIN)
        parts, weight = places(room)
        wall_constraints = WallConstraints(steps, walls, room, parts, weight.view(-1, 1, 1))
    step = _capped(steps, steps.step)
    pairs = PairConstraints.of(steps._replace(step=step.detach()), narrow, shoulders)
    step = torch.where(pairs.stands.unsqueeze(-1), 0.0, step)
    for _ in range(ROUNDS):
        step = step + pairs.correction(steps.integrate(step)).movedim(0, -1)
        if wall_constraints is not None:
            step = step + wall_constraints.correction(steps.integrate(step)).movedim(0, -1)
        step = _capped(steps, step)
    return step * _kept_share(steps, step.detach(), pairs, wall_constraints).unsqueeze(-1)


@torch.no_grad()
def _kept_share(
    steps: ProposedSteps, step: Tensor, pairs: PairConstraints, wall_constraints: WallConstraints | None
) -> Tensor:
    """Return which of `SHARES` of their steps (B, A) people walk; who is run into goes on."""
    walks = [steps.integrate(share * step) for share in SHARES]
    kinds = len(walks)
    # contacts of a pair depend on both shares: they are known for all of them before an agent stops
    upper = {(i, j): pairs.touching(walks[i], walks[j]) for i in range(kinds - 1) for j in range(i, kinds)}
    upper[kinds - 1, kinds - 1] = torch.zeros_like(upper[0, 0])
    touch = torch.stack(
        [upper[i, j] if i <= j else upper[j, i].mT for i in range(kinds) for j in range(kinds)]
    )
    wall = torch.zeros(kinds, *steps.moved.shape, dtype=torch.bool, device=step.device)
    if wall_constraints is not None:
        wall = torch.stack([*(wall_constraints.touching(walk) for walk in walks[:-1]), wall[-1]])
    chosen = torch.zeros_like(steps.moved, dtype=torch.long)
    # less at every turn; later ones all stop some agent, and agents that all stand do not touch
    for turn in range(step.shape[1] + kinds - 1):
        mine, theirs = chosen.unsqueeze(2), chosen.unsqueeze(1)
        none = torch.full_like(chosen, kinds - 1)
        both, alone, other = (
            touch.gather(0, (kinds * i + j).expand(touch.shape[1:]).unsqueeze(0))[0]
            for i, j in ((mine, theirs), (mine, none.unsqueeze(1)), (none.unsqueeze(2), theirs))
        )
        # where both have to walk for a touch, who goes first need not stop
        stops = (both & (alone | (~other & (pairs.mine >= 0.5))) & (pairs.mine > 0)).any(2)
        stops = stops | wall.gather(0, chosen.unsqueeze(0))[0]
        chosen = torch.where(stops, min(turn + 1, kinds - 1), chosen)
    return torch.stack([step.new_full((), share) for share in SHARES])[chosen]


def _capped(steps: ProposedSteps, step: Tensor) -> Tensor:
    return torch.where(steps.moved.unsqueeze(-1), limit_speed(step, steps.longest), steps.step)
