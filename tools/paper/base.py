"""What all reproductions have in common: parts that are kept, a report, and the page that people read."""

from __future__ import annotations

import shlex
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from statistics import fmean, stdev
from typing import Any, ClassVar

from pedzoo.core.spec import parse
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.parallel import finished
from pedzoo.eval.results import INTERVALS, ResultTable, legend, markdown_table, protocol_line
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.work_units import Journal, Progress, ProgressReport
from pedzoo.models.zoo.store import names as zoo_names


class Reproduction(ABC):
    """One table or figure of the paper: the title of its page, and the stem of its files."""

    title: ClassVar[str]
    stem: ClassVar[str]
    others: int = 0
    """How many parts the journal had of other requests, weights or code."""

    @property
    @abstractmethod
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""

    @abstractmethod
    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done; whatever interrupts it, finished parts are kept in the journal."""

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """Return protocol, seeds, notes and rows of all that is done, and what others have printed."""

    @abstractmethod
    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the tables of a report."""

    def legend(self) -> dict[str, str]:
        """Return what the metrics of the tables are."""
        return {}

    def draw(self, folder: Path) -> list[Path]:
        """Draw what there is to be seen into a folder, and return the files."""
        return []


class Jobs(Reproduction):
    """Rows of jobs, each kept in a journal under the digest of all that it depends on."""

    def __init__(
        self,
        jobs: Mapping[str, Any],
        work: Callable[[Any], list[dict[str, Any]]],
        journal: Path | None,
        group: Callable[[Any], Hashable] | None = None,
    ) -> None:
        """Take the jobs by digest, each with a ``label``, and take from the journal what is done.

        ``work`` returns the rows of a job, or why they cannot be made (``missing``).
        """
        self.jobs, self._journal = dict(jobs), Journal(journal)
        self._work, self._group, done = work, group, self._journal.done
        self._done = {key: done[key] for key in self.jobs if key in done}
        self.others = len(done) - len(self._done)

    @property
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""
        return len(self._done), len(self.jobs)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of all jobs that are done, in the order of jobs."""
        return [row for key in self.jobs for row in self._done.get(key, ())]

    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done."""
        missing = [key for key in self.jobs if key not in self._done]
        start, total = time.perf_counter(), len(self.jobs)
        jobs = [self.jobs[key] for key in missing]
        with closing(finished(jobs, self._work, workers, group=self._group)) as results:
            for count, (place, rows) in enumerate(results, 1):
                self._done[missing[place]] = rows
                if "missing" not in rows[0]:  # what is missing may be there next time
                    self._journal.add(missing[place], rows)
                if progress:
                    left = (time.perf_counter() - start) / count * (len(missing) - count)
                    done, label = len(self._done), jobs[place].label
                    progress(ProgressReport(label, done / total, done, total, rows[0]["seconds"], left))


class Walked(Reproduction):
    """What is walked by some policies and their baselines: an evaluation on suites of cases."""

    suites: ClassVar[tuple[str, ...]]
    models: ClassVar[tuple[str, ...]]
    """Weights that walk unless others are asked for; those that are absent are noted."""

    baselines: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        models: Sequence[str] = (),
        options: EvaluationOptions | None = None,
        seeds: Sequence[int] = (0,),
        journal: Path | None = None,
    ) -> None:
        """Say what is to be done, by ``models`` instead of the usual ones; errors as of `pedzoo.evaluate`."""
        present = set(zoo_names())
        self.missing = [] if models else [name for name in self.models if parse(name).name not in present]
        self.policies = list(models) or [name for name in self.models if name not in self.missing]
        names = [*self.policies, *self.baselines]
        self.evaluation = Evaluation(names, self.suites, options, seeds, resume=journal)
        self.others = self.evaluation.others

    @property
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""
        return self.evaluation.done, len(self.evaluation.units)

    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done."""
        self.evaluation.run(workers, progress=progress)

    def report(self) -> dict[str, Any]:
        """Return the report of the evaluation with notes, and what others have printed."""
        result = self.evaluation.report()
        shown = protocol_line(result, self.evaluation.shown) if result["rows"] else "nothing is done yet"
        rows = [self.kept(row) for row in result["rows"]]
        notes = [f"{shown}. {INTERVALS}", *self.notes(), *result["notes"]]
        if self.missing:
            notes.append(f"not here, no such weights: {', '.join(self.missing)}")
        return {**result, "rows": rows, "notes": notes, "missing": self.missing, "paper": self.printed()}

    def kept(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a report keeps of a row; `pedzoo evaluate --suite` also has what each person did."""
        return {key: row[key] for key in row if key != "per_agent"}

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
        rows = (row for row in report["rows"] if case.items() <= row["case"].items())
        return {row["name"]: row for row in rows}


def markdown(
    made: Reproduction, report: Mapping[str, Any], command: Sequence[str], pictures: Sequence[Path]
) -> str:
    """Return the page: the command that made it, the protocol, pictures, all tables, and what to know."""
    versions = report["versions"]
    lines = [
        f"# {made.title}\n",
        f"Made by `{shlex.join(command)}` with pedzoo {versions['pedzoo']}, torch {versions['torch']}, commit"
        f" {versions.get('commit', 'unknown')}; seeds {' '.join(map(str, report['seeds']))}.\n",
        *(f"* {note}" for note in report["notes"]),
        "",
        *(f"![{picture.stem}]({picture.name})\n" for picture in pictures),
    ]
    for page in made.pages(report):
        head, *rows = [[cell.replace("\n", "<br>") for cell in row] for row in (page.head, *page.rows)]
        lines += [f"## {page.title}\n", markdown_table(head, rows)]
    if legend := made.legend():
        lines += ["## What the numbers are\n", *(f"* `{key}`: {text}." for key, text in legend.items())]
    return "\n".join(lines).rstrip() + "\n"


def interval_text(ends: Sequence[float] | None, digits: int = 2) -> str:
    """Return an interval in brackets, nothing where there is none."""
    return f"[{', '.join(f'{end:.{digits}f}' for end in ends)}]" if ends else ""


def spread_text(values: Sequence[float], digits: int) -> str:
    """Return the mean of some values, and their standard deviation behind ± where there are several."""
    text = f"{fmean(values):.{digits}f}"
    return f"{text} ± {stdev(values):.{digits}f}" if len(values) > 1 else text
