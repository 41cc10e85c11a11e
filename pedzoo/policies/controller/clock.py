"""The clock of a simulator that calls: when the policy decides, and where agents were every 0.4 s.

Times that cannot be raise a `UserError`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TRACE_SECONDS
from pedzoo.policies.controller.arguments import number

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
