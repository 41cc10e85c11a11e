"""Reproductions that are a closed-loop evaluation of some policies on suites of cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.results import INTERVALS, legend, protocol_line
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.work_units import Progress
from pedzoo.models.zoo.store import names as zoo_names
from tools.paper.base import Reproduction


class Walked(Reproduction):
    """What is walked by some policies and their baselines.

    Attributes:
        suites: Names of the suites.
        models: Weights that walk unless others are asked for; those that are absent are noted.
        baselines: Policies beside them.
    """

    suites: ClassVar[tuple[str, ...]]
    models: ClassVar[tuple[str, ...]]
    baselines: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        models: Sequence[str] = (),
        options: EvaluationOptions | None = None,
        seeds: Sequence[int] = (0,),
        journal: Path | None = None,
    ) -> None:
        """Say what is to be done.

        Args:
            models: Instead of the usual ones; an unknown one is refused.
            options: Episodes, physics, floor plans, and whether it is to be quick.
            seeds: Of the scenes.
            journal: A file that keeps finished parts.

        Raises:
            UserError: As of `pedzoo.eval.evaluate.evaluate`.
        """
        present = set(zoo_names())
        self.missing = [] if models else [name for name in self.models if name not in present]
        self.policies = list(models) or [name for name in self.models if name in present]
        names = [*self.policies, *self.baselines]
        self.evaluation = Evaluation(names, self.suites, options, seeds, resume=journal)

    @property
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""
        return self.evaluation.done, len(self.evaluation.units)

    @property
    def others(self) -> int:
        """How many parts the journal had of other requests, weights or code."""
        return self.evaluation.others

    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done."""
        self.evaluation.run(workers, progress=progress)

    def report(self) -> dict[str, Any]:
        """Return the report of the evaluation with notes, and what others have printed."""
        result = self.evaluation.report()
        shown = protocol_line(result, self.evaluation.shown) if result["rows"] else "nothing is done yet"
        # megabytes of what each person did are left out: `pedzoo evaluate --suite` has them
        rows = [{key: row[key] for key in row if key != "per_agent"} for row in result["rows"]]
        notes = [f"{shown}. {INTERVALS}", *self.notes(), *result["notes"]]
        if self.missing:
            notes.append(f"not here, no such weights: {', '.join(self.missing)}")
        return {**result, "rows": rows, "notes": notes, "missing": self.missing, "paper": self.printed()}

    def legend(self) -> dict[str, str]:
        """Return what the metrics of the suites' tables are."""
        columns = [key for shown in self.evaluation.shown.values() for key in shown.columns]
        known = legend()
        return {key: known[key] for key in columns if key in known}

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        return []

    def printed(self) -> dict[str, Any]:
        """Return what the paper has printed, as plain values; nothing where it is not about that."""
        return {}

    def case_rows(self, report: Mapping[str, Any], **case: str) -> dict[str, dict[str, Any]]:
        """Return the rows of one case by policy."""
        return {
            row["name"]: row
            for row in report["rows"]
            if all(row["case"].get(key) == value for key, value in case.items())
        }
