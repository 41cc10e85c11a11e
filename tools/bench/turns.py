"""Times functions in turns, so that other load slows all of them alike, and names the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torch

from pedzoo.core.errors import UserError
from tools.bench.figures import Measured

Side = Callable[[float], float]
"""Works for about so many seconds and returns how much it did per second."""

Clock = Callable[[], float]


def clock(threads: int) -> Clock:
    """Return the clock of a run: with one thread the processor's time, which other programs do not spend."""
    return time.process_time if threads == 1 else time.perf_counter


def in_turns(
    sides: Mapping[str, Side],
    turns: int,
    seconds: float,
    tell: Callable[[str], None] | None = None,
    failed: dict[str, str] | None = None,
) -> dict[str, list[float]]:
    """Return what each side does per second in each of its turns; all have theirs before any has another.

    Args:
        sides: By name.
        turns: How often each is timed.
        seconds: At least, in each turn.
        tell: Gets the number of the turn and the side's name; then every second turn goes backwards.
        failed: Gets the error of a side that fails, which has no further turn; None to raise it.

    Raises:
        UserError: A side failed.
    """
    speeds: dict[str, list[float]] = {name: [] for name in sides}
    for turn in range(turns):
        for name in list(sides)[::-1] if tell and turn % 2 else sides:
            if failed and name in failed:
                continue
            if tell:
                tell(f"turn {turn + 1} of {turns}, {name}")
            try:
                speeds[name].append(sides[name](seconds))
            except UserError as error:
                if failed is None:
                    raise
                failed[name] = str(error)
    return speeds


def repeated(call: Callable[[], Any], work: float, now: Clock, least: int = 1) -> Side:
    """Return the side that repeats a call.

    Args:
        call: What is timed.
        work: What one call does, such as its number of agent-steps.
        now: The clock.
        least: So many calls are made in one turn, however long they take.
    """

    def side(seconds: float) -> float:
        begun, calls = now(), 0
        while True:
            call()
            calls += 1
            if (taken := now() - begun) >= seconds and calls >= least and taken > 0:
                return work * calls / taken

    return side


def seconds_of(call: Callable[[], Any], now: Clock) -> float:
    """Return how long one call takes."""
    begun = now()
    call()
    return now() - begun


def race(
    ours: Callable[[], Any], theirs: Callable[[], Any], times: int, now: Clock
) -> tuple[list[float], list[float]]:
    """Return the seconds of both in turns, after one call of each that is not counted."""
    theirs()
    ours()
    taken = [(seconds_of(theirs, now), seconds_of(ours, now)) for _ in range(times)]
    return [own for _, own in taken], [other for other, _ in taken]


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> Measured:
    """Return how many times as much ours is, turn by turn where both had as many turns.

    What slows a turn down slows both sides, so that their ratio is steadier than either.
    """
    if len(ours) == len(theirs):
        return Measured.of([own / other for own, other in zip(ours, theirs, strict=True)])
    return Measured.of([Measured.of(ours).value / Measured.of(theirs).value])


def versus(ours: Sequence[float], theirs: Sequence[float], rival: str) -> dict[str, Measured]:
    """Return the metrics of a comparison: milliseconds of both, and how many times as fast ours is."""
    return {
        f"{rival}_ms": Measured.of([1e3 * second for second in theirs]),
        "pedzoo_ms": Measured.of([1e3 * second for second in ours]),
        f"times_{rival}": ratio(theirs, ours),
    }


def machine() -> dict[str, Any]:
    """Return the processor, the system and how many processors there are."""
    return {"cpu": _cpu(), "cores": os.cpu_count() or 1, "system": platform.platform()}


def load() -> float | None:
    """Return how many programs wanted to run in the last minute; None where the system does not tell."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def yardstick(now: Clock, times: int = 20) -> float:
    """Return the milliseconds (median) of a fixed job like those that steps are made of.

    Between two runs on one machine it tells how much faster the machine was, whatever the code does: other
    programs take away its caches and its clock rate, which processor time does not show.
    """
    values = torch.linspace(0.0, 1.0, 20_000).view(-1, 2)

    def job() -> None:
        result = values
        for _ in range(50):
            result = (result * 1.01).clamp_max(1.0) + result.norm(dim=-1, keepdim=True).sqrt()

    job()
    return 1e3 * median(seconds_of(job, now) for _ in range(times))


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
