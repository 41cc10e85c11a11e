"""Times functions in turns, so that whatever else the machine does slows all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pedzoo.bench.figures import Measured

Side = Callable[[float], float]
"""Works for about so many seconds and returns how much it did per second."""

Clock = Callable[[], float]


def clock(threads: int) -> Clock:
    """Return the clock of a run: with one thread the processor's time, which other programs do not spend."""
    return time.process_time if threads == 1 else time.perf_counter


def in_turns(sides: Mapping[str, Side], turns: int, seconds: float) -> dict[str, list[float]]:
    """Return what each side does per second in each of its turns; all have theirs before any has another."""
    speeds: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(turns):
        for name, side in sides.items():
            speeds[name].append(side(seconds))
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
