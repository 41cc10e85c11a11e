"""What all reproductions have in common: parts that are kept, a report, and the page that people read."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from pedzoo.eval.results import Page, markdown_table
from pedzoo.eval.workers.progress_meter import Progress


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
    def pages(self, report: Mapping[str, Any]) -> list[Page]:
        """Return the tables of a report."""

    def legend(self) -> dict[str, str]:
        """Return what the metrics of the tables are."""
        return {}

    def draw(self, folder: Path) -> list[Path]:
        """Draw what there is to be seen into a folder, and return the files."""
        return []


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
        rows = [[cell.replace("\n", "<br>") for cell in row] for row in page.rows]
        lines += [f"## {page.title}\n", markdown_table(page.head, rows)]
    if legend := made.legend():
        lines += ["## What the numbers are\n", *(f"* `{key}`: {text}." for key, text in legend.items())]
    return "\n".join(lines).rstrip() + "\n"


def interval_text(ends: Sequence[float] | None, digits: int = 2) -> str:
    """Return an interval in brackets, nothing where there is none."""
    return f"[{', '.join(f'{end:.{digits}f}' for end in ends)}]" if ends else ""
