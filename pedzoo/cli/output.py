"""What commands write and print: files whole or not at all, tables as wide as the terminal, progress."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pedzoo.core.errors import UserError
from pedzoo.core.paths import CODECS, PAGES, PLOTS, REPORTS, check_ending, write_atomically

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table

    from pedzoo.eval.results import ResultTable, SuiteColumns
    from pedzoo.eval.work_units import ProgressReport

_ENDINGS = {"json": REPORTS, "html": PAGES, "plot": PLOTS, "sheet": PLOTS, "video": tuple(CODECS)}

_NARROW = 120
"""Characters: on a terminal with fewer, intervals are below their numbers."""


def check_outputs(endings: Mapping[str, Sequence[str]] = _ENDINGS, /, **files: str | None) -> None:
    """Refuse files that cannot be written, before any work is done for them.

    ``-`` stands for the terminal and passes. So does what is there and no file, as a pipe, but not for
    pictures.

    Args:
        endings: Those that the file of an option may have.
        files: Options and what was given; folders that are missing are made when the file is written.

    Raises:
        UserError: One is a folder, has the ending of something else, or lies where nothing can be written.
    """
    for option, file in files.items():
        if not file or file == "-":
            continue
        path, said = Path(file), f"--{option} {file}"
        if path.is_dir():
            raise UserError(f"{said}: is a folder, expected a file")
        above = next(folder for folder in path.absolute().parents if folder.exists())
        if not above.is_dir():
            raise UserError(f"{said}: {str(above)!r} is a file, expected a folder")
        if not os.access(path if path.exists() else above, os.W_OK):
            raise UserError(f"{said}: nothing can be written there: permission denied")
        wanted = endings.get(option, ())
        if wanted and not (wanted in (PAGES, REPORTS) and path.exists() and not path.is_file()):
            check_ending(said, file, wanted)


def write_json(file: str | Path, content: dict[str, Any]) -> None:
    """Write ``content`` as `write_text` does."""
    write_text(file, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_text(file: str | Path, text: str) -> None:
    """Write ``text`` to ``file`` (``-`` for the terminal), whole or not at all; its folder is made.

    Raises:
        UserError: It cannot be written.
    """
    if str(file) == "-":
        sys.stdout.write(text)
        return
    path = Path(file)
    if path.exists() and not path.is_file():  # a pipe such as /dev/fd/63 cannot be replaced
        path.write_text(text)
    else:
        write_atomically(path.resolve(), text.encode())


def write_and_print(report: dict[str, Any], file: str | None, show: Callable[[], None]) -> None:
    """Write a report, then print it: an error in printing does not lose the report.

    Args:
        report: What `write_json` takes.
        file: Where to; ``-`` for the terminal, after what is printed; None for nowhere.
        show: Prints it.
    """
    if file and file != "-":
        write_json(file, report)
    show()
    if file == "-":
        write_json(file, report)


def plain_console(stderr: bool = False, width: int = 120) -> Console:
    """Return a console that prints every text as it is, ``width`` characters wide without a terminal.

    Rich would read brackets as styles and ``:door:`` as a picture: names, paths and settings have both.
    """
    from rich.console import Console

    console = Console(stderr=stderr, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = width
    return console


def print_report(report: dict[str, Any], only: Sequence[str] | None = None) -> None:
    """Print the rows of a report, with the metrics ``only``, in tables as wide as the terminal."""
    from pedzoo.eval.results import ResultTable

    known = dict.fromkeys(name for row in report["rows"] for name in row["metrics"])
    metrics, body = [name for name in only or known if name in known], []
    for row in report["rows"]:
        note = ", ".join(map(str, row["case"].values()))
        values = [f"{row['metrics'][name]:.3f}" if name in row["metrics"] else "-" for name in metrics]
        body.append([f"{row['name']} ({note})" if note else row["name"], str(row["n"]), *values])
    plain_console().print(", ".join(f"{key} {value}" for key, value in report["protocol"].items()))
    print_tables([ResultTable("", ["name", "n", *metrics], body, 2)])


def print_pages(report: dict[str, Any], shown: Mapping[str, SuiteColumns]) -> None:
    """Print the tables of an evaluation under its protocol, as `print_tables` does."""
    from pedzoo.eval.results import pages, protocol_line

    for line in [protocol_line(report, shown), *(f"note: {note}" for note in report["notes"])]:
        plain_console().print(line)
    print_tables(pages(report, shown))


def print_tables(pages: Iterable[ResultTable]) -> None:
    """Print tables: transposed where that needs fewer parts of the terminal's width than columns do.

    Where the terminal is narrow an interval is written below its number.
    """
    console = plain_console()
    for page in pages:
        if page.title:
            console.print(f"\n{page.title}", style="bold")
        head, *rows = map(list, zip(page.head, *page.rows, strict=True))
        turned = page._replace(head=head, rows=rows, names=1)  # columns as rows
        layouts = [
            _tables(one, console.width, least) for one, least in ((page, 9), (turned, 64), (turned, 24))
        ]
        for table in min(layouts, key=len):
            console.print(table)


def _tables(page: ResultTable, width: int, least: int) -> list[Table]:
    """Return a page in as many parts as ``width`` characters need, names in each of them.

    Heads are broken at spaces, and at underscores where they are wider than ``least`` and their cells.
    """
    from rich.table import Table

    rows = [[cell.replace(" [", "\n[") for cell in row] if width < _NARROW else row for row in page.rows]
    cells = [max(_width(row[i]) for row in rows) for i in range(len(page.head))]
    heads = [
        "\n".join(_broken(part, max(cell, least)) for part in head.split(" "))
        for head, cell in zip(page.head, cells, strict=True)
    ]
    widths = [max(_width(head), cell) + 3 for head, cell in zip(heads, cells, strict=True)]
    names, parts = list(range(page.names)), [list[int]()]
    room = width - sum(widths[i] for i in names) - 1
    for i in range(page.names, len(page.head)):
        if parts[-1] and sum(widths[j] for j in (*parts[-1], i)) > room:
            parts.append([])
        parts[-1].append(i)
    result = []
    for part in parts:
        table = Table(show_lines=any("\n" in cell for row in rows for cell in row))
        for i in (*names, *part):
            table.add_column(heads[i], justify="left" if i == 0 else "right", no_wrap=i > 0, overflow="fold")
        for row in rows:
            table.add_row(*(row[i] for i in (*names, *part)))
        result.append(table)
    return result


def _width(text: str) -> int:
    return max(map(len, text.split("\n")))


def _broken(name: str, width: int) -> str:
    """Break a metric's name at underscores into lines of about ``width`` characters."""
    lines = [""]
    for part in name.split("_"):
        if lines[-1] and len(part) > 1 and len(lines[-1]) + len(part) >= width:
            lines.append("")
        lines[-1] += f"{part}_"
    return "\n".join(lines)[:-1]


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function ``(name, done, total)`` that draws one bar per name while the block runs."""
    tasks: dict[str, TaskID] = {}
    with _bars(text_last=False) as bars:

        def update(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name)
            bars.update(tasks[name], completed=done, total=total)

        yield update


@contextmanager
def overall_bar() -> Iterator[Callable[[ProgressReport], None]]:
    """Yield a function that draws one bar for a whole evaluation; without a terminal, a line per part."""
    with _bars(text_last=True) as bars:
        task = bars.add_task("", total=1.0)

        def update(step: ProgressReport) -> None:
            left = "" if step.left is None else f", {duration(step.left)} left"
            parts = f"{step.units}/{step.total}{left}"
            bars.update(task, completed=step.done, description=f"{parts}  {step.label}")
            if not bars.console.is_terminal and step.seconds is not None:
                bars.console.print(f"{parts}  {step.label} ({duration(step.seconds)})", soft_wrap=True)

        yield update


def _bars(text_last: bool) -> Progress:
    """Return bars on a terminal, with a text, which may have names in it, and the share that is done."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = plain_console(stderr=True)
    text = TextColumn("{task.description}", markup=False)
    share = TextColumn("{task.percentage:>3.0f} %")
    columns = (share, BarColumn(30), text) if text_last else (text, BarColumn(), share, TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def duration(seconds: float) -> str:
    """Return seconds as people say them."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
