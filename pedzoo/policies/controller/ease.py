"""How people of a controller move between its calls: the caller's clock, and how they start and stop.

Times that cannot be raise a `UserError`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import GOAL_RADIUS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.policies.controller.arguments import number
from pedzoo.policies.controller.roster import Roster
from pedzoo.policies.neighbours import pairs_within

_OBSERVED = (OBS_LEN - 1) * STEP_SECONDS
"""Seconds that a history reaches back."""

_ROUNDING = 1e-9
"""Seconds."""

SHORTEST, LONGEST = 1e-3, STEP_SECONDS
"""Seconds between two calls: positions of all calls of 2.8 s are kept, and histories have one every 0.4 s."""

_LATEST = 1e11
"""Seconds: no clock that counts from 1970, or from a later moment, is there yet."""

_PAUSE, _CALLS = 30.0, 500.0
"""Seconds, and times ``dt``: longer gaps are no late calls but another unit, if they are as long again."""


class CallerClock(NamedTuple):
    """Calls every ``dt`` seconds, or at times that the caller says. Never written in place.

    Attributes:
        dt: Nominal seconds between two calls.
        decision_dt: Seconds between two decisions.
        times: When the kept positions were (L,) float64, seconds since the first call.
        calls: How many there were.
        start: The caller's time at the first call; None where calls are counted instead.
        due: When the next decision is, seconds since the first call.
        decided: When the last one was.
    """

    dt: float
    decision_dt: float
    times: NDArray[Any]
    calls: int = 0
    start: float | None = None
    due: float = 0.0
    decided: float = 0.0

    @classmethod
    def of(cls, dt: float, decision_dt: float) -> CallerClock:
        """Return a clock before its first call, with positions on the way to it."""
        seconds = number(dt, "dt", "seconds, a number")
        if not SHORTEST - _ROUNDING <= seconds <= LONGEST + 1e-6:
            unit = f"; {dt:g} milliseconds are {dt / 1000:g}" if 1 <= seconds <= 1000 * LONGEST else ""
            raise UserError(
                f"dt {dt}: expected seconds between two calls, of at least {SHORTEST:g} s and at most "
                f"{LONGEST:g} s{unit}"
            )
        kept = math.ceil(_OBSERVED / seconds - _ROUNDING) + 1
        return cls(seconds, decision_dt, seconds * np.arange(-kept, 0))

    @property
    def now(self) -> float:
        """Seconds since the first call."""
        return float(self.times[-1])

    @property
    def decides(self) -> bool:
        """Whether this call is one at which all people decide."""
        return self.decided == self.now

    def called(self, time: float | None) -> tuple[CallerClock, int]:
        """Return the clock at the next call, at ``time`` or counted; and how many old positions to drop."""
        if self.calls and (time is None) != (self.start is None):
            raise UserError(
                f"time {time}: expected at every call or at none; reset() starts anew with another clock"
            )
        now, start = self.calls * self.dt, None
        if time is not None:
            seconds = number(time, "time", "seconds, a finite number")
            if not math.isfinite(seconds):
                raise UserError(f"time {time}: expected seconds, a finite number")
            if abs(seconds) > _LATEST:
                raise UserError(f"time {time}: expected seconds: are these {_unit_of(abs(seconds) / 1e9)}?")
            start = seconds if self.start is None else self.start
            now = seconds - start
            if self.calls:
                self._check_gap(time, now)
        times = np.append(self.times, now)
        dropped = int(times[1:].searchsorted(now - _OBSERVED + _ROUNDING, "right"))
        clock = self._replace(times=times[dropped:], calls=self.calls + 1, start=start)
        if now < self.due - self.dt / 2 - _ROUNDING:
            return clock, dropped
        # a late call starts the count anew, a jittering one keeps it
        due = (now if now - self.due > self.dt / 2 else self.due) + self.decision_dt
        return clock._replace(decided=now, due=due), dropped

    def _check_gap(self, time: float, now: float) -> None:
        if now <= self.now:
            raise UserError(
                f"time {time}: expected later than at the call before, {(self.start or 0.0) + self.now:g}; "
                "reset() starts anew"
            )
        gap, before = now - self.now, float(self.times[-1] - self.times[-2])
        if gap > _CALLS * self.dt and (gap > _PAUSE or before > _CALLS * self.dt):
            raise UserError(
                f"time {time}: {gap:g} s after the call before, with dt {self.dt:g}: expected seconds: are "
                f"these {_unit_of(gap / self.dt)}? After a pause reset() starts anew"
            )

    def history(self, past: Tensor) -> Tensor:
        """Return positions (N, 8, 2) every 0.4 s, oldest first, from those that are kept (N, L, 2)."""
        return self._before(past, STEP_SECONDS * np.arange(OBS_LEN - 1, -1, -1))

    def velocity(self, past: Tensor) -> Tensor:
        """Return the velocities (N, 2) of the last ``dt`` seconds, at least of 0.1 s, m/s.

        In less time millimetres of a simulator's noise are much.
        """
        seconds = max(self.dt, TRACE_SECONDS)
        return (past[:, -1] - self._before(past, np.array([seconds]))[:, 0]) / seconds

    def parts(self, ticks: int) -> Tensor:
        """Return the share (S,) of every trace step of a decision in the next ``dt`` seconds."""
        if ticks == 1:
            return torch.ones(1)
        begin, tick = self.now - self.decided, self.decision_dt / ticks
        edges = torch.arange(ticks + 1, dtype=torch.float64) * tick
        edges[-1] = math.inf
        low, high = edges[:-1].clamp_min(begin), edges[1:].clamp_max(begin + self.dt)
        return ((high - low).clamp_min(0) / self.dt).float()

    def _before(self, past: Tensor, ago: NDArray[Any]) -> Tensor:
        """Return positions (N, K, 2) so many seconds ago (K,), on straight lines between the kept ones."""
        when = self.times[-1] - ago
        after = self.times.searchsorted(when - _ROUNDING).clip(1, len(self.times) - 1)
        begin, end = self.times[after - 1], self.times[after]
        share = torch.from_numpy((when - begin) / (end - begin)).to(past.dtype).unsqueeze(1)
        return past[:, after - 1].lerp(past[:, after], share)


def _unit_of(ratio: float) -> str:
    """Return which unit times are in that are so many times too large."""
    return "milliseconds" if ratio < 3e4 else "microseconds" if ratio < 3e7 else "nanoseconds"


BRAKES, HARDEST = 2.0, 2.4
"""m/s^2: how people come to rest at a goal, and the most by which they start and stop."""

_SOFT = 0.3
"""Seconds: the last part of a way takes this long for each e-fold, in fewer than two calls nothing does."""

_GAP = 0.03
"""Metres kept from other bodies on the way to rest."""

_FASTEST = 10.0
"""m/s: what others do who are faster is not foreseen from farther away."""

_STILL, _AT_SPEED = 0.06, 0.8
"""m/s below which people at their goal stand, and share of their speed from which on they have set out."""

Array = NDArray[np.float64]


def eased(
    agents: Roster, wish: Tensor, position: Tensor, clock: CallerClock, bank: MapBank
) -> tuple[Array, Roster]:
    """Return the velocities of agents until the next call (N, 2), m/s, and the roster that knows them.

    Policies say how people walk. Here those who near their goal brake, and those who have reached it come to
    rest on it, or beside whoever stands there. Others who stand brake where they are. People who set out
    start as softly. What a policy slows down stays slow, and nothing here leads into a contact.

    ``wish`` are the velocities (N, 2), m/s, that policies have chosen, 0 for people who stand, ``position``
    (N, 2), metres, that of all agents. The bank holds the floor plan, or nothing.
    """
    told, asked = agents.told.numpy(), wish.numpy().astype(np.float64)
    # those who wait for the policy to decide about a new goal go on as they do
    undecided = np.isnan(asked[:, 0])
    asked = np.where(undecided[:, None], told, asked)
    away, distance, near = _near_goal(agents, position, clock.dt)
    liked, others, stands = agents.pref_speed.numpy(), agents.other.numpy(), agents.stands.numpy()
    stands, walks, eases = stands & ~others, ~(stands | others), agents.eases.numpy()
    if not (near | eases | (stands & told.any(1))).any():
        return asked, agents._replace(told=torch.from_numpy(asked))
    eases = eases & walks
    most = HARDEST * clock.dt
    seen: Array = clock.velocity(agents.past).double().numpy()
    # where the caller lets people not move, the next command begins from there
    blocked = _length(seen) < 0.25 * _length(told) - 0.05
    last = np.where(blocked[:, None], seen, told)
    taken, left = _places_taken(agents, position, seen, distance, near & (walks | stands))
    stands |= taken & (left < GOAL_RADIUS)
    walks &= ~stands
    lost = stands & (distance > 2 * GOAL_RADIUS + _way_to_rest(_length(last), clock.dt))
    limit = np.where(np.isnan(left) | lost, np.where(stands, 0.0, np.inf), _speed_at(left, clock.dt))
    cap = np.maximum(limit, _length(last) - most)
    to_goal = away * (limit / np.maximum(distance, 1e-9))[:, None]
    aim = np.where(stands[:, None], np.where(limit[:, None] > 0, to_goal, 0.0), _shortened(asked, cap))
    soon = _way_to_rest(_length(last), clock.dt) + clock.decision_dt * _length(last)
    soft = stands | eases | (walks & (left < soon))
    result = np.where(soft[:, None], last + _shortened(aim - last, most), aim)
    at_rest = stands & (lost | (limit <= min(_STILL, most))) & (_length(last) <= most)
    at_rest &= _length(seen) <= 3 * _STILL  # a caller may be late
    result[at_rest | others] = 0.0
    moves = (soft | walks) & result.any(1) & ((result != asked).any(1) | undecided)
    if moves.any():
        places = KDTree(position.double().numpy())
        # first those whom a policy moves, who go on as it says; then those may stop who are to stop anyway
        stops = stands | undecided
        looks = (walks & ~undecided, asked, STEP_SECONDS), (stops, 0.0 * asked, clock.dt)
        for which, instead, seconds in looks:
            theirs, ahead = np.where(others[:, None], seen, result), max(seconds, clock.dt)
            near_to = moves & which
            room = _room(agents, places, near_to, result, theirs, ahead, clock.dt, bank)
            near_to &= room < _GAP
            more = _room(agents, places, near_to, instead, theirs, ahead, clock.dt, bank)
            result = np.where((near_to & (room < more))[:, None], instead, result)
    # plans are walked as they are again when people have caught up with them
    caught_up = (_length(asked - result) < 1e-6) & (_length(seen) >= 0.99 * _length(asked))
    caught_up &= (_length(asked) >= _AT_SPEED * liked) & ~undecided
    goal_point = torch.where(torch.from_numpy(at_rest | lost).unsqueeze(1), torch.nan, agents.goal_point)
    return result, agents._replace(
        told=torch.from_numpy(result),
        eases=torch.from_numpy(eases & ~caught_up),
        stands=agents.stands | torch.from_numpy(stands),
        goal_point=goal_point,
    )


def expected(agents: Roster, position: Tensor, velocity: Tensor, clock: CallerClock) -> tuple[Tensor, Tensor]:
    """Return what policies are to expect of agents until their next decision: others keep clear of that.

    Agents are at ``position`` (N, 2), metres, with ``velocity`` (N, 2), m/s. Returned are velocities (N, 2),
    m/s, those of people who stand as they come to rest, and top speeds (N,).
    """
    top_speed, stands = TOP_SPEED_RATIO * agents.pref_speed, (agents.stands & ~agents.other).numpy()
    away, distance, near = _near_goal(agents, position, clock.dt)
    told: Array = agents.told.numpy()
    eases, rests = (agents.eases & agents.walks).numpy(), stands & told.any(1)
    if not (near | eases | rests).any():
        return velocity, top_speed
    calls = max(1, min(4, round(clock.decision_dt / clock.dt)))
    step = clock.decision_dt / calls
    speed, left, gone = _length(told), distance.copy(), np.zeros_like(distance)
    for _ in range(calls):
        limit = np.where(np.isnan(left), 0.0, _speed_at(np.maximum(left, 0.0), clock.dt))
        faster = np.where(eases | stands, speed + HARDEST * step, np.inf)
        speed = np.minimum(np.maximum(limit, speed - HARDEST * step), faster)
        left, gone = left - speed * step, gone + speed * step
    mean = gone / clock.decision_dt
    ahead = np.where(np.isnan(distance)[:, None], told, away)
    ahead = ahead * (mean / np.maximum(_length(ahead), 1e-9))[:, None]
    velocity = torch.where(torch.from_numpy(rests).unsqueeze(1), torch.from_numpy(ahead).float(), velocity)
    return velocity, top_speed.minimum(torch.from_numpy(np.where(eases | near, mean, np.inf)).float())


def _near_goal(agents: Roster, position: Tensor, dt: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the ways to goals (N, 2), their lengths (N,), metres, and who may have to brake by now (N,)."""
    away: Array = (agents.goal_point - position).double().numpy()
    distance = np.hypot(*away.T)
    fastest = TOP_SPEED_RATIO * agents.pref_speed.double().numpy()
    return away, distance, distance < _way_to_rest(fastest, dt) + 2 * GOAL_RADIUS


def setting_out(agents: Roster, before: Roster, position: Tensor, dt: float) -> Roster:
    """Return the roster in which those set out who stood, set out or braked ``before`` they had this goal."""
    told = _length(before.told.numpy())
    apart = _length((before.goal_point - position).double().numpy())
    slow = (told < _AT_SPEED * before.pref_speed.numpy()) | (apart < _way_to_rest(told, dt) + GOAL_RADIUS)
    other_goal = (agents.goal != before.goal).any(1) & agents.walks
    eases = agents.eases | (other_goal & (before.stands | torch.from_numpy(slow)))
    return agents._replace(eases=eases)


def _speed_at(distance: Array, dt: float) -> Array:
    """Return the speeds from which people come to rest in so many metres (N,), m/s."""
    soft = max(_SOFT, 2 * dt)
    constant = np.sqrt(2 * BRAKES * np.maximum(distance - BRAKES * soft**2 / 2, 0.0))
    return np.where(distance < BRAKES * soft**2, distance / soft, constant)


def _way_to_rest(speed: Array, dt: float) -> Array:
    """Return in how many metres people of a speed (N,) come to rest: the inverse of `_speed_at`."""
    soft = max(_SOFT, 2 * dt)
    return np.where(speed < BRAKES * soft, speed * soft, speed**2 / (2 * BRAKES) + BRAKES * soft**2 / 2)


def _places_taken(
    agents: Roster, position: Tensor, seen: Array, distance: Array, which: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Array]:
    """Return at whose goals (N,) another stands, and how far they may go (N,), metres."""
    rows = which.nonzero()[0]
    taken, left = np.zeros(len(which), dtype=bool), distance.copy()
    place, radius = position.double().numpy(), agents.radius.double().numpy()
    goal = agents.goal_point.double().numpy()[rows]
    room = radius[rows, None] + radius + _GAP
    there = (_length(goal[:, None] - place) < room) & (_length(seen) < 0.1)
    there[np.arange(len(rows)), rows] = False
    apart = np.where(there, _length(place[rows, None] - place) - room, np.inf).min(1)
    taken[rows] = there.any(1)
    left[rows] = np.minimum(left[rows], np.maximum(apart, 0.0))
    return taken, left


def _room(
    agents: Roster,
    places: KDTree,
    which: NDArray[np.bool_],
    own: Array,
    others: Array,
    seconds: float,
    dt: float,
    bank: MapBank,
) -> Array:
    """Return how near ``which`` agents (N,) get to others, if they go on at ``own`` and these at ``others``.

    Velocities (N, 2) are in m/s, the result (N,) in metres: infinite for agents that come near no other, or
    not within reach. Others are looked at for some ``seconds``, and walls until the next call, ``dt``; a wall
    that is touched is 0 away.
    """
    result = np.full(len(which), np.inf)
    if not which.any():
        return result
    place, radius = places.data, agents.radius.double().numpy()
    fastest = min(_FASTEST, float(np.maximum(_length(own), _length(others)).max()))
    me, them = pairs_within(places, 2 * (radius.max() + seconds * fastest) + _GAP)
    me, them = me[which[me]], them[which[me]]
    away, move = place[me] - place[them], own[me] - others[them]
    when = -(away * move).sum(-1) / np.maximum((move**2).sum(-1), 1e-9)
    nearest = _length(away + np.clip(when, 0.0, seconds)[:, None] * move)
    np.minimum.at(result, me[when > 0], (nearest - radius[me] - radius[them])[when > 0])
    mine = (which & own.any(1)).nonzero()[0]
    if bank.grids and len(mine):
        ways = torch.from_numpy(np.stack((place[mine], place[mine] + dt * own[mine]))).float().unsqueeze(0)
        walls, _ = bank.closest_wall(ways, torch.tensor([bank.grids[0].map_id]), identity_pose(1))
        now, then = walls[0].numpy()
        result[mine[(then < radius[mine]) & (then < now)]] = 0.0
    return result


def _length(vectors: Array) -> Array:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _shortened(vectors: Array, length: Array | float) -> Array:
    """Return vectors (N, 2) that are no longer than ``length`` (N,)."""
    return vectors * np.minimum(1.0, length / np.maximum(_length(vectors), 1e-12))[:, None]
