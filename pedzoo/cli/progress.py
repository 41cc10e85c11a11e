"""The terminal: text as it is, and a progress bar for loops that say where they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from pedzoo.eval.work_units import ProgressReport


def plain_console(stderr: bool = False, width: int = 120) -> Console:
    """Return a console that prints every text as it is.

    Rich would read brackets as styles and ``:door:`` as a picture: names, paths and settings have both.

    Args:
        stderr: Write there instead of to the standard output.
        width: Characters of a line where there is no terminal.
    """
    console = Console(stderr=stderr, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = width
    return console


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function ``(name, done, total)`` that draws one bar per name while the block runs."""
    tasks: dict[str, TaskID] = {}
    console = plain_console(stderr=True)
    share = TextColumn("{task.percentage:>3.0f} %")
    columns = _text(), BarColumn(), share, TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:

        def update(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name)
            bars.update(tasks[name], completed=done, total=total)

        yield update


@contextmanager
def overall_bar() -> Iterator[Callable[[ProgressReport], None]]:
    """Yield a function that draws one bar for a whole evaluation; without a terminal, a line per part."""
    console = plain_console(stderr=True)
    columns = TextColumn("{task.percentage:>3.0f} %"), BarColumn(30), _text()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("", total=1.0)

        def update(step: ProgressReport) -> None:
            left = "" if step.left is None else f", {duration(step.left)} left"
            parts = f"{step.units}/{step.total}{left}"
            bars.update(task, completed=step.done, description=f"{parts}  {step.label}")
            if not console.is_terminal and step.seconds is not None:
                spent = duration(step.seconds)
                console.print(f"{parts}  {step.label} ({spent})", soft_wrap=True)

        yield update


def _text() -> TextColumn:
    """Return the column of what is going on, which has names in it."""
    return TextColumn("{task.description}", markup=False)


def duration(seconds: float) -> str:
    """Return seconds as people say them."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
