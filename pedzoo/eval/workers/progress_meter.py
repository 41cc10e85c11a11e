"""How far an evaluation is, and how long the rest takes."""

import time
from collections.abc import Callable
from typing import NamedTuple

from pedzoo.eval.suite import WorkUnit


class ProgressReport(NamedTuple):
    """How far an evaluation is.

    Attributes:
        label: What has just been done, or is going on.
        done: Share of the whole, by the work that it is expected to be.
        units: Finished ones.
        total: All of them.
        seconds: That the unit took; None while it is going on.
        left: Seconds that the rest is expected to take; None while that is unknown.
    """

    label: str
    done: float
    units: int
    total: int
    seconds: float | None
    left: float | None


Progress = Callable[[ProgressReport], None]


class ProgressMeter:
    """Reports how far an evaluation is, and estimates how long the rest takes."""

    def __init__(self, units: list[WorkUnit], done: set[int], progress: Progress | None) -> None:
        """Start with all ``units``, of which those numbered ``done`` are finished."""
        self._units, self._done, self._progress = units, set(done), progress
        self._weights = [unit.case.episodes * len(unit.seeds) * unit.case.effort for unit in units]
        self._before = sum(self._weights[number] for number in done)
        self._start = time.perf_counter()

    def within(self, unit: WorkUnit, share: float) -> None:
        """Tell that a share of a unit is done."""
        number = self._units.index(unit)
        self._tell(number, share * self._weights[number], None)

    def ended(self, number: int, seconds: float) -> None:
        """Tell that a unit is done, which took so long."""
        self._done.add(number)
        self._tell(number, 0.0, seconds)

    def _tell(self, number: int, more: float, seconds: float | None) -> None:
        if self._progress is None:
            return
        done = more + sum(self._weights[one] for one in self._done)
        total, mine = sum(self._weights), done - self._before
        passed = time.perf_counter() - self._start
        left = passed / mine * (total - done) if mine > 0 else None
        label, units = self._units[number].label, len(self._units)
        self._progress(ProgressReport(label, done / total, len(self._done), units, seconds, left))
