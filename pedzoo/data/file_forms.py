"""Files of walks in every form: their rows as frame, agent, x, y, and what they say of time and unit."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import LARGEST_TABLE, MOST_POSITIONS, check_limit
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.text_format import CUT, Source, TextFormat, is_sqlite

TICK = 1e-6  # seconds: times of files are counted in these

_UNITS = 1.0, 1e-3, 1e-6, 1e-9
_USUAL = 0.004, 0.8
"""Seconds between two rows of a person, at least and most, by which the unit of times is found out."""

_LONGEST_VALUE = 1_000_000


class Contents(NamedTuple):
    """What is in a file."""

    table: np.ndarray  # rows (N, 4) of frame, agent, x, y; positions in metres where the unit is known
    place: Callable[[int], str]  # says where in the file a row is
    source: Source  # what the file says of itself


def contents_of(path: Path) -> Contents:
    """Return what is in a file of text, or of JuPedSim's SQLite.

    Raises:
        UserError: It has another form, a value is missing or is no number.
        UnicodeError: It is no text.
    """
    if is_sqlite(path):
        return _database(path)
    form = TextFormat.of(path)
    table = form.numbers(path)
    row = np.arange(len(table))
    if form.steps and len(table):
        table, row = _footsteps(table, path)
    seconds, timed = 1 / form.rate if form.rate else None, False
    if form.time is not None and len(table):
        unit = form.time or _unit(table, -1 if table.shape[1] == 5 else 0)
        if table.shape[1] == 5:
            seconds = seconds or _seconds_per_frame(table, unit)
            table = table[:, :4].copy()
        else:
            time = table[:, 0]
            begin = np.min(time[np.isfinite(time)], initial=np.inf)
            timed = not (time == np.round(time)).all()
            if timed:
                table[:, 0], seconds = np.round((time - begin) * ((unit or 1.0) / TICK)), TICK
            else:
                table[:, 0], seconds = time - begin if np.abs(time).max() > 2**53 else time, unit
    if form.metres not in (0.0, 1.0):
        table[:, 2:] *= form.metres
    source = Source(form.form, seconds, timed, form.metres)
    return Contents(table, lambda one: f"line {form.line_of(path, int(row[one]))}", source)


def _unit(table: np.ndarray, column: int) -> float | None:
    """Return the unit of times in seconds with which two rows of a person are as far apart as usual."""
    order = np.lexsort((table[:, column], table[:, 1]))
    gap = np.diff(table[order, column])
    gap = gap[(np.diff(table[order, 1]) == 0) & (gap > 0)]
    usual = np.median(gap) if len(gap) else 0.0
    return next((unit for unit in _UNITS if _USUAL[0] <= usual * unit <= _USUAL[1]), None)


def _seconds_per_frame(table: np.ndarray, unit: float | None) -> float | None:
    """Return what times (column 4) say of frames (column 0); None where they do not agree."""
    first, last = table[table[:, 0].argmin()], table[table[:, 0].argmax()]
    if unit is None or not last[0] > first[0]:
        return None
    each = (last[4] - first[4]) / (last[0] - first[0])
    off = np.abs(table[:, 4] - first[4] - (table[:, 0] - first[0]) * each).max()
    return float(each * unit) if 0 < each and off < max(each, 0.05 / unit) else None


def _footsteps(table: np.ndarray, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return places of people at the ends of footsteps (N, 7), and between in long ones, with their rows."""
    last = table[:, 4] - table[:, 0]
    if not (np.isfinite(last).all() and (last >= 0).all()):
        row = int(np.flatnonzero(~(last >= 0) | np.isinf(last))[0])
        raise UserError(f"recording {str(path)!r}, footstep {row + 1}: ends before it begins, or never")
    parts = np.maximum(np.ceil(last / STEP_SECONDS - 1e-6), 1)
    check_limit(parts.sum(), MOST_POSITIONS, f"recording {str(path)!r}", "rows", "cut it in time")
    count = parts.astype(np.int64) + 1
    row = np.repeat(np.arange(len(table)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / parts[row]
    begin, end = table[row][:, [0, 2, 3]], table[row][:, [4, 5, 6]]
    time, x, y = (begin + share[:, None] * (end - begin)).T
    points = np.column_stack((time, table[row, 1], x, y))
    # the end of a step is the begin of the next one
    first = np.unique(np.column_stack((np.round(time / TICK), points[:, 1])), axis=0, return_index=True)[1]
    return points[first], row[first]


def _database(path: Path) -> Contents:
    """Return the contents of a SQLite file of JuPedSim: trajectory_data, and fps in metadata."""
    what = f"recording {str(path)!r}"
    check_limit(path.stat().st_size, LARGEST_TABLE, what, "bytes", CUT)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_VALUE)
            # tables alone: a view may compute for ever
            tables = {
                name for (name,) in connection.execute("select name from sqlite_master where type='table'")
            }
            if "trajectory_data" not in tables:
                raise UserError(
                    f"{what} has no table trajectory_data, as JuPedSim writes it, but {sorted(tables)}"
                )
            rows = connection.execute("select frame, id, pos_x, pos_y from trajectory_data")
            table = np.fromiter(rows, dtype=np.dtype((float, 4)))
            query = "select value from metadata where key = 'fps'"
            fps = connection.execute(query).fetchone() if "metadata" in tables else None
        rate = float(fps[0]) if fps else 0.0
    except UserError:
        raise
    except sqlite3.Error as error:
        raise UserError(f"{what} is no SQLite file of JuPedSim: {error}") from error
    except (TypeError, ValueError) as error:
        raise UserError(f"{what}: a value of trajectory_data or fps is no number: {error}") from error
    source = Source("SQLite of JuPedSim", 1 / rate if rate > 0 else None)
    return Contents(table, lambda row: f"row {row + 1}", source)
