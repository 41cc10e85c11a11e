"""The clock of a simulator that calls: when the policy decides, and where agents were every 0.4 s."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.policies.controller.arguments import number

_OBSERVED = (OBS_LEN - 1) * STEP_SECONDS
"""Seconds that a history reaches back."""

_ROUNDING = 1e-9
"""Seconds."""

SHORTEST = 1e-3
"""Least seconds between two calls: positions of all calls of 2.8 s are kept."""


class CallerClock(NamedTuple):
    """Calls every ``dt`` seconds, or at times that the caller says. Never written in place.

    Attributes:
        dt: Nominal seconds between two calls.
        decision_dt: Seconds between two decisions.
        calls: How many there were.
        start: The caller's time at the first call; None where calls are counted instead.
        times: When the kept positions were (L,) float64, seconds since ``start``.
        due: When the next decision is, seconds since ``start``.
        decided: When the last one was.
    """

    dt: float
    decision_dt: float
    calls: int = 0
    start: float | None = None
    times: Tensor = torch.zeros(0, dtype=torch.float64)
    due: float = 0.0
    decided: float = 0.0

    @property
    def length(self) -> int:
        """How many positions are kept of calls that are counted, and before the first call."""
        return round(_OBSERVED / self.dt) + 1

    @property
    def now(self) -> float:
        """Seconds since the first call."""
        return (self.calls - 1) * self.dt if self.start is None else float(self.times[-1])

    @property
    def decides(self) -> bool:
        """Whether this call is one at which all people decide."""
        return self.decided == self.now

    def called(self, time: float | None) -> tuple[CallerClock, int]:
        """Return the clock at the next call, at ``time`` or counted, and how many oldest positions to drop.

        Raises:
            UserError: The time is not finite, does not go forward, or is given at some calls only.
        """
        if self.calls and (time is None) != (self.start is None):
            raise UserError(
                f"time {time}: expected at every call or at none; reset() starts anew with another clock"
            )
        clock = self._replace(calls=self.calls + 1)
        if time is None:
            every = round(self.decision_dt / self.dt)
            return (clock._replace(decided=clock.now) if self.calls % every == 0 else clock), 1
        if not math.isfinite(number(time, "time", "seconds, a finite number")):
            raise UserError(f"time {time}: expected seconds, a finite number")
        if self.start is None:
            ago = torch.arange(self.length - 1, -1, -1, dtype=torch.float64) * self.dt
            return clock._replace(start=float(time), times=-ago, due=self.decision_dt), 1
        now = float(time) - self.start
        if now <= self.now:
            raise UserError(
                f"time {time}: expected later than at the call before, {self.start + self.now:g}; "
                "reset() starts anew"
            )
        times = torch.cat((self.times, self.times.new_tensor([now])))
        dropped = int((times[1:] <= now - _OBSERVED).sum())
        clock = clock._replace(times=times[dropped:])
        if now < self.due - self.dt / 2 - _ROUNDING:
            return clock, dropped
        # a late call starts the count anew, a jittering one keeps it
        late = now - self.due > self.dt / 2
        due = (now if late else self.due) + self.decision_dt
        return clock._replace(decided=now, due=due), dropped

    def ago(self, length: int) -> Tensor:
        """Return how long ago the kept positions were (L,), seconds."""
        if self.start is None:
            return torch.arange(length - 1, -1, -1, dtype=torch.float32) * self.dt
        return (self.times[-1] - self.times).float()

    def history(self, past: Tensor) -> Tensor:
        """Return positions (N, 8, 2) every 0.4 s, oldest first, from those that are kept (N, L, 2)."""
        if self.start is None:
            return past[:, :: round(STEP_SECONDS / self.dt)]
        return self._at(past, STEP_SECONDS * torch.arange(OBS_LEN - 1, -1, -1, dtype=torch.float64))

    def velocity(self, past: Tensor) -> Tensor:
        """Return the velocities (N, 2) of the last ``dt`` seconds, m/s."""
        if self.start is None:
            return (past[:, -1] - past[:, -2]) / self.dt
        return (past[:, -1] - self._at(past, past.new_tensor([self.dt]))[:, 0]) / self.dt

    def parts(self, ticks: int) -> Tensor:
        """Return the share (S,) of every trace step of a decision in the next ``dt`` seconds."""
        if ticks == 1:
            return torch.ones(1)
        begin, tick = self.now - self.decided, self.decision_dt / ticks
        edges = torch.arange(ticks + 1, dtype=torch.float64) * tick
        edges[-1] = math.inf
        low, high = edges[:-1].clamp_min(begin), edges[1:].clamp_max(begin + self.dt)
        return ((high - low).clamp_min(0) / self.dt).float()

    def _at(self, past: Tensor, ago: Tensor) -> Tensor:
        """Return positions (N, K, 2) so many seconds ago (K,), on straight lines between the kept ones."""
        when = self.times[-1] - ago
        after = torch.searchsorted(self.times, when).clamp(1, len(self.times) - 1)
        begin, end = self.times[after - 1], self.times[after]
        share = ((when - begin) / (end - begin)).to(past.dtype).unsqueeze(1)
        return past[:, after - 1] + share * (past[:, after] - past[:, after - 1])


def times(whole: float, dt: float, what: str) -> int:
    """Return how many steps of ``dt`` are ``whole`` seconds.

    Raises:
        UserError: Not a whole number.
    """
    dt = number(dt, "dt", "seconds, a number")
    result = round(whole / dt) if SHORTEST <= dt < math.inf else 0
    if result < 1 or abs(result * dt - whole) > 1e-6:
        raise UserError(
            f"dt {dt}: {what} every {whole:g} s, expected a whole part of that, such as {whole / 4:g}, of at "
            f"least {SHORTEST:g} s"
        )
    return result
