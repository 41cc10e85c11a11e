"""What callers of a controller give, as arrays and as a clock. What cannot be raises a `UserError`."""

from __future__ import annotations

import math
import numbers
from collections.abc import Hashable, Mapping, Set
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TRACE_SECONDS

Array = NDArray[Any]

PREF_SPEED, OTHER_RADIUS = 1.3, 0.3
"""Where none is given: the speed that people like, m/s, and the radius of others, metres: of a robot."""

WIDEST, FASTEST, SWIFTEST, JUMP = 10.0, 10.0, 100.0, 1e3
"""Most of radii (m), preferred speeds and given velocities (m/s), and moves between two calls (m)."""

FARTHEST = 1e4
"""Metres from the scene's origin: float32 tells millimetres apart up to here."""

ZERO = np.zeros(2)

_OBSERVED, _ROUNDING = (OBS_LEN - 1) * STEP_SECONDS, 1e-9
"""Seconds that a history reaches back, and by which times may be wrong."""

SHORTEST, LONGEST = 1e-3, STEP_SECONDS
"""Seconds between two calls: positions of all calls of 2.8 s are kept, and histories have one every 0.4 s."""

_LATEST, _PAUSE, _CALLS = 1e11, 30.0, 500.0
"""Seconds that no clock shows yet; seconds and times ``dt`` from which on two gaps are of another unit."""


@dataclass(frozen=True)
class DiscKey:
    """The disc ``index`` of another agent, ``of`` its id, as the key of a row."""

    of: Hashable
    index: int

    def __repr__(self) -> str:
        return f"{self.of!r}[{self.index}]"


def number_of(one: Hashable) -> int:
    """Return the number by which an agent's noise is drawn, from their id alone, the same in every process.

    An integer is its own number, as people of an environment are numbered. Every other id goes by its
    ``repr``; ids whose ``repr`` holds an address get other noise in the next run.
    """
    if isinstance(one, numbers.Integral):
        return int(one) % 2**63
    return int.from_bytes(blake2b(repr(one).encode(), digest_size=8).digest()) % 2**63


def _number(value: Any, what: str, expected: str, whose: str = "") -> float:
    try:
        if not isinstance(value, str):
            return float(value)
    except (TypeError, ValueError):
        pass
    raise UserError(f"{what} {value!r}{whose}: expected {expected}")


def _above_zero(value: Any, what: str, unit: str, one: Hashable, most: float, doubt: str) -> float:
    """Return a value as a number above 0 and at most ``most``; messages about more raise a ``doubt``."""
    expected = f"{unit}, above 0 and at most {most:g}"
    result = _number(value, what, expected, f" of {one!r}")
    if not 0 < result <= most:
        asks = f": {doubt}" if most < result < math.inf else ""
        raise UserError(f"{what} {value} of {one!r}: expected {expected}{asks}")
    return result


def metres_of(one: Hashable, radius: Any) -> float:
    """Return the radius of an agent's body, metres."""
    far = isinstance(radius, numbers.Real) and float(radius) > 100 * WIDEST
    doubt = f"are these {'milli' if far else 'centi'}metres? A larger body is several discs"
    return _above_zero(radius, "radius", "metres", one, WIDEST, doubt)


def speed_of(one: Hashable, pref_speed: float | Mapping[Any, float]) -> float:
    """Return the speed that an agent likes, m/s: `PREF_SPEED` for others."""
    if isinstance(one, DiscKey):
        return PREF_SPEED
    given = pref_speed.get(one, PREF_SPEED) if isinstance(pref_speed, Mapping) else pref_speed
    doubt = "is this in kilometres per hour?"
    return _above_zero(given, "pref_speed", "metres per second", one, FASTEST, doubt)


def by_id(given: Any, what: str) -> Mapping[Any, Any]:
    """Return an argument that has a value for every id, an empty one for None; messages call it ``what``."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise UserError(f"{what} {given!r:.100}: expected a mapping by id, {what}={{'anna': ...}}")
    return given


def of_present(present: Mapping[Any, Any], given: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return the entries of people who are present."""
    return {one: value for one, value in given.items() if one in present}


def check_ids(
    people: Mapping[Any, Any], others: Mapping[Any, Any], radius: Mapping[Any, Any], before: Set[Any]
) -> None:
    """Check that nobody is in both, and that radii are of these, or of ids from ``before`` who have left."""
    for one in radius:
        if not (one in people or one in others or one in before):
            text = all(isinstance(each, str) for each in (one, *people, *others))
            name = str if text else repr
            raise unknown("id in radius", name(one), map(name, (*people, *others)))
    if both := [one for one in people if one in others]:
        raise UserError(f"{both[0]!r} is in people and in others: expected every id in one of them")


def as_discs(others: Mapping[Any, Any]) -> dict[DiscKey, Any]:
    """Return the discs of other agents, each with its position (2,): given as (2,), or (k, 2) for several."""
    discs: dict[DiscKey, Any] = {}
    for one, value in others.items():
        try:
            points: Array = np.atleast_2d(np.array(_plain(value), dtype=np.float64))
        except (TypeError, ValueError):
            points = np.zeros((0, 2))
        if points.ndim != 2 or points.shape[-1] != 2 or not len(points):
            raise UserError(
                f"others: position {value!r} of {one!r}: expected two numbers, (x, y), or a list of such "
                "pairs for several discs"
            )
        discs |= {DiscKey(one, index): point for index, point in enumerate(points)}
    return discs


def as_points(given: Mapping[Any, Any], what: str) -> Array:
    """Return the values of a dictionary, each two numbers, as (n, 2) float64; messages call them ``what``."""
    try:
        points: Array = np.array([_plain(xy) for xy in given.values()], dtype=np.float64)
        points = points.reshape(len(given), 2)
    except (TypeError, ValueError):
        shown = f"{what}s {given!r}"
        for one, value in given.items():
            try:
                alone = np.shape(np.asarray(_plain(value), dtype=np.float64))
            except (TypeError, ValueError):
                alone = None
            if alone != (2,):
                shown = f"{what} {value!r} of {one!r}"
                break
        raise UserError(f"{shown}: expected two numbers, (x, y)") from None
    if not (finite := np.isfinite(points)).all():
        one = list(given)[int(finite.all(1).argmin())]
        raise UserError(f"{what} {given[one]!r} of {one!r}: expected finite numbers, (x, y)")
    return points


def origin_of(points: Array) -> Array:
    """Return the origin (2,) of a scene amid most points (n, 2): it is walked alike wherever it lies."""
    return np.sort(points, axis=0)[(len(points) - 1) // 2]


def as_places(given: Mapping[Any, Any], what: str, origin: Array, points: Array | None = None) -> Array:
    """Return values less an origin (2,), in whole micrometres; ``points`` are theirs by `as_points`.

    So those of a scene that was moved are the very same. Less the origin, the last digits tell how far away
    a scene is, and where forces balance they decide.
    """
    places = (as_points(given, what) if points is None else points) - origin
    if (size := np.abs(places)).max(initial=0.0) > FARTHEST:
        one = list(given)[int((size > FARTHEST).any(1).argmax())]
        raise UserError(
            f"{what} {given[one]!r} of {one!r} is more than {FARTHEST:g} m from the scene's origin, the "
            "floor plan's or the first agent's place: are all in one frame, and in metres?"
        )
    return places.round(6)


def as_velocities(given: Mapping[Any, Any]) -> Array:
    """Return given velocities (n, 2), m/s."""
    result = as_points(given, "velocity")
    if (fast := np.hypot(*result.T) > SWIFTEST).any():
        one = list(given)[int(fast.argmax())]
        raise UserError(
            f"velocity {given[one]!r} of {one!r}: expected metres per second, at most {SWIFTEST:g}: is this "
            "in another unit?"
        )
    return result


def _plain(value: Any) -> Any:
    return value.detach().cpu().numpy() if isinstance(value, Tensor) else value


class CallerClock(NamedTuple):
    """Calls every ``dt`` seconds, or at times that the caller says. Never written in place.

    Attributes:
        dt: Nominal seconds between two calls.
        decision_dt: Seconds between two decisions.
        times: When the kept positions were (L,) float64, seconds since the first call.
        now: When the last call was, seconds since the first one.
        calls: How many there were.
        start: The caller's time at the first call; None where calls are counted instead.
        due: When the next decision is, seconds since the first call.
        decided: When the last one was.
    """

    dt: float
    decision_dt: float
    times: Array
    now: float = 0.0
    calls: int = 0
    start: float | None = None
    due: float = 0.0
    decided: float = 0.0

    @classmethod
    def of(cls, dt: float, decision_dt: float) -> CallerClock:
        """Return a clock before its first call, with positions on the way to it."""
        seconds = _number(dt, "dt", "seconds, a number")
        if not SHORTEST - _ROUNDING <= seconds <= LONGEST + 1e-6:
            unit = f"; {dt:g} milliseconds are {dt / 1000:g}" if 1 <= seconds <= 1000 * LONGEST else ""
            raise UserError(
                f"dt {dt}: expected seconds between two calls, of at least {SHORTEST:g} s and at most "
                f"{LONGEST:g} s{unit}"
            )
        kept = math.ceil(_OBSERVED / seconds - _ROUNDING) + 1
        return cls(seconds, decision_dt, seconds * np.arange(-kept, 0))

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
            seconds = _number(time, "time", "seconds, a finite number")
            if not math.isfinite(seconds):
                raise UserError(f"time {time}: expected seconds, a finite number")
            if abs(seconds) > _LATEST:
                raise UserError(f"time {time}: expected seconds: are these {_unit_of(abs(seconds) / 1e9)}?")
            start = seconds if self.start is None else self.start
            now = seconds - start
            if self.calls and now <= self.now:
                raise UserError(
                    f"time {time}: expected later than at the call before, {start + self.now:g}; "
                    "reset() starts anew"
                )
            gap, before, many = now - self.now, float(self.times[-1] - self.times[-2]), _CALLS * self.dt
            if self.calls and gap > many and (gap > _PAUSE or before > many):
                raise UserError(
                    f"time {time}: {gap:g} s after the call before, with dt {self.dt:g}: expected seconds: "
                    f"are these {_unit_of(gap / self.dt)}? After a pause reset() starts anew"
                )
        dropped = int(self.times[1:].searchsorted(now - _OBSERVED + _ROUNDING, "right"))
        times = np.empty(len(self.times) - dropped + 1)
        times[:-1], times[-1] = self.times[dropped:], now
        decided, due = self.decided, self.due
        if now >= due - self.dt / 2 - _ROUNDING:
            # a late call starts the count anew, a jittering one keeps it
            decided, due = now, (now if now - due > self.dt / 2 else due) + self.decision_dt
        return CallerClock(
            self.dt, self.decision_dt, times, now, self.calls + 1, start, due, decided
        ), dropped

    def history(self, past: Array) -> Array:
        """Return positions (N, 8, 2) every 0.4 s, oldest first, from those that are kept (N, L, 2)."""
        return self._before(past, STEP_SECONDS * np.arange(OBS_LEN - 1, -1, -1))

    def velocity(self, past: Array) -> Array:
        """Return the velocities (N, 2) of the last ``dt`` seconds, at least of 0.1 s, m/s.

        In less time millimetres of a simulator's noise are much.
        """
        seconds = max(self.dt, TRACE_SECONDS)
        return (past[:, -1] - self._before(past, np.array([seconds]))[:, 0]) / seconds

    def parts(self, ticks: int) -> Array:
        """Return the share (S,) of every trace step of a decision in the next ``dt`` seconds."""
        if ticks == 1:
            return np.ones(1, np.float32)
        begin, edges = self.now - self.decided, np.arange(ticks + 1) * (self.decision_dt / ticks)
        edges[-1] = math.inf
        edges = edges.clip(begin, begin + self.dt)
        return ((edges[1:] - edges[:-1]) / self.dt).astype(np.float32)

    def _before(self, past: Array, ago: Array) -> Array:
        """Return positions (N, K, 2) so many seconds ago (K,), on straight lines between the kept ones."""
        when = self.times[-1] - ago
        after = self.times.searchsorted(when - _ROUNDING).clip(1, len(self.times) - 1)
        begin, end = self.times[after - 1], self.times[after]
        rest = 1 - ((when - begin) / (end - begin)).astype(past.dtype)[:, None]
        return past[:, after] - rest * (past[:, after] - past[:, after - 1])


def _unit_of(ratio: float) -> str:
    """Return which unit times are in that are so many times too large."""
    return "milliseconds" if ratio < 3e4 else "microseconds" if ratio < 3e7 else "nanoseconds"
