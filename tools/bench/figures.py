"""What a benchmark finds: measured values with their spread, in rows, and whether they meet a bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, NamedTuple

import numpy as np

RIVALS = {
    "times_vmas_lidar": "VMAS with lidar not given (--peer tools/bench/peers/vmas_navigation.py)",
    "times_pyrvo_from_python": "RVO2 from Python not given (--peer tools/bench/peers/pyrvo_orca.py)",
}
"""Ratios that bars are about and that need other programs, and what to say where they are absent."""


class Measured(NamedTuple):
    """One value with its spread over repeats.

    Attributes:
        value: The median.
        low: The first quartile.
        high: The third quartile.
        n: Number of repeats.
    """

    value: float
    low: float
    high: float
    n: int

    @classmethod
    def of(cls, samples: Sequence[float]) -> Measured:
        """Return the median and quartiles of at least one sample."""
        low, high = np.quantile(samples, (0.25, 0.75)).tolist()
        return cls(float(median(samples)), low, high, len(samples))


class Verdict(NamedTuple):
    """A bar and whether it is met.

    Attributes:
        bar: What was asked for, in words.
        ok: Whether it is so; None where this run cannot tell.
        why: What it lacks to tell.
    """

    bar: str
    ok: bool | None
    why: str = ""

    def __str__(self) -> str:
        """Return bar and verdict, for a table."""
        return f"{self.bar} {'not judged' if self.ok is None else 'ok' if self.ok else 'MISSED'}"


@dataclass(frozen=True)
class Row:
    """What was measured about one thing in one case.

    Attributes:
        section: The benchmark that measured it.
        name: The thing.
        case: How large, and where.
        metrics: By flat lower-case names with the unit last; names that begin with ``times`` are ratios.
        bars: What was asked of it.
        note: What a reader has to know to compare it.
    """

    section: str
    name: str
    case: Mapping[str, Any]
    metrics: Mapping[str, Measured]
    bars: Sequence[Verdict] = field(default=())
    note: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        """What makes two rows of different runs the same figure."""
        return self.section, self.name, str(sorted(self.case.items()))

    def at_least(self, metric: str, bar: float) -> Verdict:
        """Return the verdict on a metric that has to be ``bar`` or more; absent ones miss it."""
        result = self.metrics.get(metric)
        return Verdict(f"{metric} >= {bar:,g}", result is not None and result.value >= bar)

    def beside(self, metric: str, bar: float) -> Verdict:
        """Return the verdict on a ratio to another program; without that program there is none."""
        verdict = self.at_least(metric, bar)
        return verdict if metric in self.metrics else Verdict(verdict.bar, None, RIVALS[metric])

    def below(self, metric: str, bar: float) -> Verdict:
        """Return the verdict on a metric that has to stay below ``bar``."""
        result = self.metrics.get(metric)
        return Verdict(f"{metric} < {bar:,g}", result is not None and result.value < bar)

    def as_json(self) -> dict[str, Any]:
        """Return what `from_json` takes."""
        return {
            "section": self.section,
            "name": self.name,
            "case": dict(self.case),
            "n": {metric: result.n for metric, result in self.metrics.items()},
            "metrics": {metric: result.value for metric, result in self.metrics.items()},
            "quartiles": {metric: [result.low, result.high] for metric, result in self.metrics.items()},
            "bars": [verdict._asdict() for verdict in self.bars],
            "note": self.note,
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Row:
        """Return a row as it was written."""
        metrics = {
            metric: Measured(value, low, high, content["n"][metric])
            for metric, value in content["metrics"].items()
            for low, high in [content["quartiles"][metric]]
        }
        bars = tuple(Verdict(**verdict) for verdict in content["bars"])
        return cls(content["section"], content["name"], content["case"], metrics, bars, content["note"])


def is_ratio(metric: str) -> bool:
    """Return whether a metric is a ratio of two values of the same run: all that other machines share."""
    return metric.startswith("times") or metric.endswith("percent")


def more_is_better(metric: str) -> bool:
    """Return whether a metric is a speed or a ratio of speeds; others are time, space or shares."""
    return metric.startswith("times") or metric.endswith("_per_s")
