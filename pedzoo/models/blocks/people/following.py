"""How people keep behind others, so that a safety layer has hardly anything left to do.

Those behind get no nearer to those in front than a gap in time allows: a collision-free speed model (Tordeux,
Chraibi and Seyfried, Traffic and Granular Flow 2015), here of the speeds that the others will have.
"""

import torch
from torch import Tensor

from pedzoo.core.geometry import smooth_norm
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.models.blocks.people.nearest import Neighbours, of_slots
from pedzoo.models.blocks.people.step_features import Situation

GAP_SECONDS = 0.2
"""Seconds within which people could close the gap to one in front, if that one walked on."""

WIDTH, WIDTH_AT_WALLS = 0.55, 0.66
"""Metres between the centres of two people at which a gap is none: in the open, and in narrow places."""

IN_FRONT = 0.02
"""Metres by which another is ahead of a person from which on that person keeps behind."""

WALKS = 0.15
"""m/s: people who wish to stand, or to walk slower, are passed and not followed."""

MEETING, OPPOSED = 0.75, -0.7
"""Metres kept between two who meet in a doorway, and the cosine of the ways of two who meet at most."""

COMES, LUCK = 0.4, 0.3
"""m/s at which somebody comes for whom others wait, and how much chance says of who goes first."""

ROUNDS = 3
"""How often people look at how fast those in front will be: so many set out at once, one behind the other."""

STILL, NEXT_TO = 0.1, 1.0
"""m/s below which people stand, and metres: of those who stand so near, the first waits for none."""

PRESSES, PRESSED = 2, 0.6
"""Decisions after which people who cannot get on press, and metres within which others do so with them."""

BACKS_OFF, BACK = 5, 0.6
"""Decisions after which one of two who press against each other backs off, and how fast, m/s."""


def held_back(
    wish: Tensor, now: Situation, others: Neighbours, narrow: Tensor, confined: Tensor, chance: Tensor
) -> Tensor:
    """Return velocities (B, A, 2), m/s: those that people wish for, slowed down behind others.

    No arch of people holds itself: of all who stand before a door, one has the shortest way left and waits
    for none of those who stand. If this one cannot get on, those around press, too, and a safety layer
    leads them past each other. Of two who press against each other the one with the longer way backs off.
    Of two who meet in a doorway or a passage, the one farther from it waits as long as the other comes.

    Args:
        wish: The velocities that people wish for (B, A, 2), m/s.
        now: The situation.
        others: The nearest others of each person.
        narrow: How narrow it is around people (B, A), 0 to 1.
        confined: How narrow it is on both sides of them (B, A), 0 to 1.
        chance: Numbers that last (B, A): of two in places as confined, the one with the larger goes first.
    """
    moves = now.moves.unsqueeze(-1)
    last = (now.history[:, :, -1] - now.history[:, :, -2]) / STEP_SECONDS
    pairs = _Pairs(now, others, narrow, torch.where(moves, wish, last), last, confined, chance)
    # others start at the speed that they have, and are known better in every round
    speed = smooth_norm(wish)
    slowest = torch.minimum(smooth_norm(last), speed) / speed.clamp_min(1e-3)
    going = torch.where(moves, wish * slowest.unsqueeze(-1), last)
    for _ in range(ROUNDS):
        going = torch.where(moves, pairs.slowed(wish, going), last)
    stuck = now.pressing >= PRESSES
    presses = stuck | pairs.near(stuck, PRESSED)
    result = torch.where(moves & ~presses.unsqueeze(-1), going, wish)
    return torch.where(pairs.backs_off(now).unsqueeze(-1), -BACK * now.ahead, result)


class _Pairs:
    """Each person and the k nearest others.

    Attributes:
        place: From the person to the other (B, A, k, 2), metres.
        width: Distance from which on a gap is none (B, A, k), metres.
        behind: How far a person keeps behind the other, or gives way to them (B, A, k), 0 to 1.
    """

    def __init__(
        self,
        now: Situation,
        others: Neighbours,
        narrow: Tensor,
        wants: Tensor,
        last: Tensor,
        confined: Tensor,
        chance: Tensor,
    ) -> None:
        here, ahead = now.history[:, :, -1], now.ahead
        self._absent, self._other = others.absent, others.other
        self.place = self._of_other(here) - here.unsqueeze(2)
        self._squared = self.place.square().sum(-1)
        narrow = torch.maximum(narrow.unsqueeze(2), self._of_other(narrow))
        bodies = now.radius.unsqueeze(2) + self._of_other(now.radius) - 2 * BODY_RADIUS
        self.width = WIDTH + (WIDTH_AT_WALLS - WIDTH) * narrow + bodies
        with torch.no_grad():
            way = self._of_other(ahead)
            front = 0.5 * (self.place * (ahead.unsqueeze(2) + way)).sum(-1) / IN_FRONT
            self._alike = (ahead.unsqueeze(2) * way).sum(-1)
            self._walks = self._of_other(smooth_norm(wants) > WALKS) & ~self._absent
            behind = torch.where((self._alike > 0) & self._walks, front.clamp(0, 1), 0.0)
            stands = (smooth_norm(last) < STILL) & now.mask
            close = self._of_other(stands) & self._closer_than(NEXT_TO)
            shorter = close & (self._of_other(now.remaining) < now.remaining.unsqueeze(2))
            first = stands & (now.hindered > 0) & ~shorter.any(2)
            waits = self._waits(confined, chance, last)
            self.behind = behind.masked_fill(first.unsqueeze(2) & close, 0.0).masked_fill(waits, 1.0)
            self.width = torch.where(waits, MEETING + bodies, self.width)

    def _waits(self, confined: Tensor, chance: Tensor, last: Tensor) -> Tensor:
        """Return whom people wait for where it is confined (B, A, k): those who come and go first.

        ``last`` (B, A, 2), m/s, are the velocities that all have: one who stands is not waited for.
        """
        apart = smooth_norm(self.place).clamp_min(0.1)
        comes = -(self._of_other(last) * self.place).sum(-1) / apart > COMES
        rank = confined + LUCK * chance
        first = self._of_other(rank) > rank.unsqueeze(2)
        between_walls = (self._of_other(confined) > 0) | (confined > 0).unsqueeze(2)
        return (self._alike < OPPOSED) & self._walks & comes & first & between_walls

    def _of_other(self, values: Tensor) -> Tensor:
        """Return values (B, A, ...) of the others (B, A, k, ...)."""
        return of_slots(values, self._other)

    def _closer_than(self, distance: float) -> Tensor:
        """Return which others are nearer than a distance, metres, (B, A, k) bool."""
        return (self._squared < distance**2) & ~self._absent

    def near(self, people: Tensor, distance: float) -> Tensor:
        """Return whether one of ``people`` (B, A) bool is nearer than a distance, metres, to each (B, A)."""
        return (self._of_other(people) & self._closer_than(distance)).any(2)

    def backs_off(self, now: Situation) -> Tensor:
        """Return which people back off (B, A) bool: another presses against them, and has less way left."""
        presses = (now.pressing >= BACKS_OFF) & now.moves
        against = self._alike < -0.5
        goes_first = self._of_other(now.remaining) < now.remaining.unsqueeze(2)
        close = self._closer_than(PRESSED)
        return presses & (self._of_other(presses) & against & goes_first & close).any(2)

    def slowed(self, wish: Tensor, going: Tensor) -> Tensor:
        """Return velocities (B, A, 2) behind others who go at velocities ``going`` (B, A, 2), m/s."""
        speed = smooth_norm(wish)
        way = (wish / speed.clamp_min(1e-3).unsqueeze(-1)).unsqueeze(2)
        along = (self.place * way).sum(-1)
        aside = self.place[..., 0] * way[..., 1] - self.place[..., 1] * way[..., 0]
        in_way = (along > 0) & (aside.abs() < self.width)
        until = torch.where(in_way, self.width.square() - aside.square(), 1.0).sqrt()
        gap = (along - until).clamp_min(0)
        allowed = (gap / GAP_SECONDS + (self._of_other(going) * way).sum(-1)).clamp_min(0)
        lack = self.behind * (speed.unsqueeze(2) - allowed).clamp_min(0)
        lack = torch.where(in_way, lack, 0.0).amax(2)
        return wish * (1 - lack / speed.clamp_min(1e-3)).clamp(0, 1).unsqueeze(-1)
