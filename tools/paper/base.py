"""What all reproductions have in common: parts that are kept, a report, and the page that people read."""

from __future__ import annotations

import shlex
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

from pedzoo.eval.parallel import finished
from pedzoo.eval.results import ResultTable, markdown_table
from pedzoo.eval.work_units import Journal, Progress, ProgressReport


class Reproduction(ABC):
    """One table or figure of the paper.

    Attributes:
        title: Of its page.
        stem: Of its files.
    """

    title: ClassVar[str]
    stem: ClassVar[str]

    @property
    @abstractmethod
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""

    @property
    @abstractmethod
    def others(self) -> int:
        """How many parts the journal had of other requests, weights or code."""

    @abstractmethod
    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done; whatever interrupts it, finished parts are kept in the journal.

        Args:
            workers: Processes; the numbers are the same for any number of them.
            progress: Called whenever there is something to tell.
        """

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
        jobs: Sequence[Any],
        digests: Sequence[str],
        work: Callable[[Any], list[dict[str, Any]]],
        journal: Path | None,
        group: Callable[[Any], Hashable] | None = None,
    ) -> None:
        """Take the jobs, and take from the journal what is done.

        Args:
            jobs: Picklable, each with a ``label``.
            digests: One of each job.
            work: Does a job and returns its rows, or why they cannot be made (``missing``).
            journal: A file that keeps finished jobs.
            group: See `pedzoo.eval.parallel.finished`.
        """
        self.jobs, self._digests, self._journal = list(jobs), list(digests), Journal(journal)
        self._work, self._group, done = work, group, self._journal.done
        self._done = {number: done[key] for number, key in enumerate(self._digests) if key in done}

    @property
    def parts(self) -> tuple[int, int]:
        """See `Reproduction.parts`."""
        return len(self._done), len(self.jobs)

    @property
    def others(self) -> int:
        """See `Reproduction.others`."""
        return len(self._journal.done.keys() - set(self._digests))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of all jobs that are done, in the order of jobs."""
        return [row for number in sorted(self._done) for row in self._done[number]]

    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """See `Reproduction.run`."""
        missing = [number for number in range(len(self.jobs)) if number not in self._done]
        start, total = time.perf_counter(), len(self.jobs)
        jobs = [self.jobs[number] for number in missing]
        with closing(finished(jobs, self._work, workers, group=self._group)) as results:
            for count, (place, rows) in enumerate(results, 1):
                number = missing[place]
                self._done[number] = rows
                if "missing" not in rows[0]:  # what is missing may be there next time
                    self._journal.add(self._digests[number], rows)
                if progress:
                    left = (time.perf_counter() - start) / count * (len(missing) - count)
                    done, label = len(self._done), self.jobs[number].label
                    progress(ProgressReport(label, done / total, done, total, rows[0]["seconds"], left))


def markdown(
    made: Reproduction, report: Mapping[str, Any], command: Sequence[str], pictures: Sequence[Path]
) -> str:
    """Return the page: the command that made it, the protocol, pictures, all tables, and what to know.

    Args:
        made: What was reproduced.
        report: Its report with ``versions``.
        command: As it was typed.
        pictures: Files beside the page.
    """
    versions = report["versions"]
    seeds = " ".join(map(str, report["seeds"]))
    lines = [
        f"# {made.title}\n",
        f"Made by `{shlex.join(command)}` with pedzoo {versions['pedzoo']}, torch {versions['torch']}, commit"
        f" {versions.get('commit', 'unknown')}; seeds {seeds}.\n",
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
