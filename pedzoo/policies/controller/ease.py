"""How people of a controller start and stop between its calls.

A ``state`` (N,) has the fields of `pedzoo.policies.controller.roster.Roster`, and is written in place.
"""

from functools import partial

import numpy as np
import torch
from scipy.spatial import KDTree

from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import GOAL_RADIUS, STEP_SECONDS, TOP_SPEED_RATIO
from pedzoo.maps.bank import MapBank
from pedzoo.policies.controller.arguments import Array, CallerClock

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


def eased(state: Array, wish: Array, past: Array, clock: CallerClock, bank: MapBank) -> Array:
    """Return the velocities of agents until the next call (N, 2), m/s.

    Policies say how people walk. Here those who near their goal brake, and those who have reached it come to
    rest on it, or beside whoever stands there. Others who stand brake where they are. People who set out
    start as softly. What a policy slows down stays slow, and nothing here leads into a contact.

    Args:
        state: The agents.
        wish: The velocities (N, 2), m/s, that policies have chosen, 0 for people who stand; NaN for those
            who wait for the policy to decide about a new goal: they go on as they do.
        past: Positions (N, L, 2), metres, at the times of the clock.
        clock: When they are called.
        bank: Holds the floor plan, or nothing.
    """
    told, other, dt = state["told"].copy(), state["other"], clock.dt
    undecided = np.isnan(wish[:, 0])
    asked = np.where(undecided[:, None], told, wish)
    position = past[:, -1]
    away, distance, near = _near_goal(state, position, dt)
    stands, eases = state["stands"] & ~other, state["eases"]
    if not (near | eases | (stands & told.any(1))).any():
        state["told"] = asked
        return asked
    walks = ~(stands | other)
    eases, most = eases & walks, HARDEST * dt
    seen = clock.velocity(past).astype(np.float64)
    # where the caller lets people not move, the next command begins from there
    last = np.where((_length(seen) < 0.25 * _length(told) - 0.05)[:, None], seen, told)
    speed, here = _length(last), position.astype(np.float64)
    to_rest = _way_to_rest(speed, dt)
    taken, left = _places_taken(state, here, seen, distance, near & ~other)
    stands |= taken & (left < GOAL_RADIUS)
    walks &= ~stands
    lost = stands & (distance > 2 * GOAL_RADIUS + to_rest)
    limit = np.where(np.isnan(left) | lost, np.where(stands, 0.0, np.inf), _speed_at(left, dt))
    to_goal = away * np.where(stands, limit / np.maximum(distance, 1e-9), 0.0)[:, None]
    aim = _shortened(asked, np.maximum(limit, speed - most))
    aim = np.where(stands[:, None], np.where(limit[:, None] > 0, to_goal, 0.0), aim)
    soft = stands | eases | (walks & (left < to_rest + clock.decision_dt * speed))
    result = np.where(soft[:, None], last + _shortened(aim - last, most), aim)
    at_rest = stands & (lost | (limit <= min(_STILL, most))) & (speed <= most)
    at_rest &= _length(seen) <= 3 * _STILL  # a caller may be late
    result[at_rest | other] = 0.0
    moves = (soft | walks) & result.any(1) & ((result != asked).any(1) | undecided)
    if moves.any():
        radius = state["radius"].astype(np.float64)
        fastest = min(_FASTEST, max(_length(each).max(initial=0.0) for each in (asked, result, seen[other])))
        reach = 2 * (radius.max() + max(STEP_SECONDS, dt) * fastest) + _GAP
        pairs = KDTree(here).query_pairs(reach, output_type="ndarray")
        room_of = partial(_room, here, radius, np.concatenate((pairs, pairs[:, ::-1])).T, bank, dt)
        # first those whom a policy moves, who go on as it says; then those may stop who are to stop anyway
        looks = (walks & ~undecided, asked, STEP_SECONDS), (stands | undecided, 0.0 * asked, dt)
        for which, instead, seconds in looks:
            theirs, near_to = np.where(other[:, None], seen, result), moves & which
            room = room_of(near_to, result, theirs, max(seconds, dt))
            near_to &= room < _GAP
            near_to &= room < room_of(near_to, instead, theirs, max(seconds, dt))
            result[near_to] = instead[near_to]
    # plans are walked as they are again when people have caught up with them
    caught_up = (_length(asked - result) < 1e-6) & (_length(seen) >= 0.99 * _length(asked)) & ~undecided
    caught_up &= _length(asked) >= _AT_SPEED * state["pref_speed"]
    state["told"], state["eases"] = result, eases & ~caught_up
    state["stands"] |= stands
    state["goal_point"][at_rest | lost] = np.nan
    return result


def expected(state: Array, position: Array, velocity: Array, clock: CallerClock) -> tuple[Array, Array]:
    """Return what policies are to expect of agents until their next decision: others keep clear of that.

    Agents are at ``position`` (N, 2), metres, with ``velocity`` (N, 2), m/s. Returned are velocities (N, 2),
    m/s, those of people who stand as they come to rest, and top speeds (N,).
    """
    top_speed, stands, told = TOP_SPEED_RATIO * state["pref_speed"], state["stands"], state["told"]
    away, distance, near = _near_goal(state, position, clock.dt)
    eases, rests = state["eases"] & ~stands & ~state["other"], stands & ~state["other"] & told.any(1)
    if not (near | eases | rests).any():
        return velocity, top_speed
    calls = max(1, min(4, round(clock.decision_dt / clock.dt)))
    step = clock.decision_dt / calls
    speed, gone = _length(told), np.zeros_like(distance)
    faster = np.where(eases | (stands & ~state["other"]), HARDEST * step, np.inf)
    for _ in range(calls):
        left = distance - gone
        limit = np.where(np.isnan(left), 0.0, _speed_at(np.maximum(left, 0.0), clock.dt))
        speed = np.clip(limit, speed - HARDEST * step, speed + faster)
        gone = gone + speed * step
    mean = gone / clock.decision_dt
    ahead = np.where(np.isnan(distance)[:, None], told, away)
    ahead = ahead * (mean / np.maximum(_length(ahead), 1e-9))[:, None]
    velocity = np.where(rests[:, None], ahead, velocity).astype(np.float32)
    return velocity, np.where(eases | near, np.minimum(mean, top_speed), top_speed).astype(np.float32)


def set_out(state: Array, before: Array, position: Array, dt: float) -> None:
    """Let those set out who stood, set out or braked ``before`` they had this goal."""
    told = _length(before["told"])
    apart = _length((before["goal_point"] - position).astype(np.float64))
    slow = (told < _AT_SPEED * before["pref_speed"]) | (apart < _way_to_rest(told, dt) + GOAL_RADIUS)
    walks = ~(state["stands"] | state["other"])
    state["eases"] |= (state["goal"] != before["goal"]).any(1) & walks & (before["stands"] | slow)


def _near_goal(state: Array, position: Array, dt: float) -> tuple[Array, Array, Array]:
    """Return the ways to goals (N, 2), their lengths (N,), metres, and who may have to brake by now (N,)."""
    away = (state["goal_point"] - position).astype(np.float64)
    distance, fastest = _length(away), TOP_SPEED_RATIO * state["pref_speed"].astype(np.float64)
    return away, distance, distance < _way_to_rest(fastest, dt) + 2 * GOAL_RADIUS


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
    state: Array, place: Array, seen: Array, distance: Array, which: Array
) -> tuple[Array, Array]:
    """Return at whose goals (N,) another stands, and how far they may go (N,), metres."""
    rows, radius = which.nonzero()[0], state["radius"].astype(np.float64)
    taken, left = np.zeros(len(which), dtype=bool), distance.copy()
    room = radius[rows, None] + radius + _GAP
    there = (_length(state["goal_point"][rows, None].astype(np.float64) - place) < room) & (
        _length(seen) < 0.1
    )
    there[np.arange(len(rows)), rows] = False
    apart = np.where(there, _length(place[rows, None] - place) - room, np.inf).min(1)
    taken[rows], left[rows] = there.any(1), np.minimum(left[rows], np.maximum(apart, 0.0))
    return taken, left


def _room(
    place: Array,
    radius: Array,
    pairs: Array,
    bank: MapBank,
    dt: float,
    which: Array,
    own: Array,
    others: Array,
    seconds: float,
) -> Array:
    """Return how near ``which`` agents (N,) get to others, if they go on at ``own`` and these at ``others``.

    Others are looked at for some ``seconds``, and walls until the next call: one that is touched is 0 away.
    """
    result = np.full(len(which), np.inf)
    if not which.any():
        return result
    me, them = pairs[:, which[pairs[0]]]
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
