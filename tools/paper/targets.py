"""What controllers that hold up in the loop have to show: numbers of a row that are enough, or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

Sense = Literal["at least", "above", "at most", "below"]


class Target(NamedTuple):
    """A bound of one metric: a number, or what others have in the same table.

    Attributes:
        key: Name of the metric.
        sense: Which side of the bound is enough.
        bound: The number; what others' is multiplied by where there are ``others``.
        others: Policies whose mean is the bound. Where one of them has no such number there is no bound.
        of: Whether the bound is the mean of the others, or the least of them.
    """

    key: str
    sense: Sense
    bound: float = 1.0
    others: tuple[str, ...] = ()
    of: Literal["mean", "least"] = "mean"

    @property
    def text(self) -> str:
        """The target in words."""
        if not self.others:
            return f"{self.key} {self.sense} {self.bound:g}"
        what = {"mean": "the mean of ", "least": "the least of "}[self.of] if len(self.others) > 1 else ""
        times = f"{self.bound:g} x " if self.bound != 1 else ""
        return f"{self.key} {self.sense} {times}{what}{', '.join(self.others)}"

    def limit(self, rows: Mapping[str, Mapping[str, Any]]) -> float | None:
        """Return the bound as a number, None where it is not known.

        Args:
            rows: Of one table by policy.
        """
        if not self.others:
            return self.bound
        values = [rows[name]["metrics"].get(self.key) if name in rows else None for name in self.others]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return self.bound * (min(known) if self.of == "least" else sum(known) / len(known))

    def met(self, name: str, rows: Mapping[str, Mapping[str, Any]]) -> bool | None:
        """Return whether a policy meets it; None where its bound or its number is not known.

        A policy without a number (no arrivals, no meetings) misses the target: see `verdict`.
        """
        limit, value = self.limit(rows), rows[name]["metrics"].get(self.key)
        if limit is None or value is None:
            return None
        enough = {
            "at least": value >= limit,
            "above": value > limit,
            "at most": value <= limit,
            "below": value < limit,
        }
        return enough[self.sense]


def verdict(targets: Sequence[Target], name: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Return ``met``, or what is missing: the metrics whose targets a row does not meet, with their bounds.

    Args:
        targets: Of the rows' table.
        name: Whose row.
        rows: Of that table by policy.
    """
    missing, unknown = [], []
    for target in targets:
        limit, value = target.limit(rows), rows[name]["metrics"].get(target.key)
        if limit is None:
            unknown.append(target.key)
        elif not target.met(name, rows):
            result = "-" if value is None else f"{value:.3f}"
            missing.append(f"{target.key} {result}, not {target.sense} {limit:.3f}")
    if missing:
        return "\n".join(missing)
    return f"nothing to compare {', '.join(unknown)} with" if unknown else "met"
