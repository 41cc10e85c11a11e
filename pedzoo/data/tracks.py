"""Recorded people as one table (frame, agent, x, y) of any file, and whether they move as people can.

Wrong seconds and wrong units show in their speed.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS
from pedzoo.core.untrusted import LARGEST_TABLE, LONGEST_RECORDING, MOST_POSITIONS, check_limit
from pedzoo.data.text_format import COLUMNS, CUT, PLAIN, Source, TextFormat, is_sqlite

FASTEST = 4.0  # m/s: people of whom half of all steps are faster are no pedestrians
FARTHEST = 0.8  # seconds between two rows of a person, at most: no more can be made between them
STANDS = 0.2  # m/s: who is slower stands

_WALKS = 1.3
_SLOW, _FAST = 0.3, 2.5
"""m/s: crowds whose fast steps, or usual ones, are below or above these have other seconds, most likely."""

WALKED = 2.0  # metres: people who get so far do not stand
_NARROW = 0.1  # metres: two people need more room
_RATES = (60, 50, 30, 25, 15, 12.5, 10, 5, 2.5, 1.25)  # rows per second that most recordings have

TICK = 1e-6  # seconds: times of files are counted in these

_CLOCKS = 1.0, 1e-3, 1e-6, 1e-9
_BETWEEN = 0.004, 0.8
"""Seconds between two rows of a person, at least and most, by which the unit of times is found out."""

_LONGEST_VALUE = 1_000_000

_UNITS = {"centimetres": ("cm", 0.01), "millimetres": ("mm", 0.001), "feet": ("ft", 0.3048)}


@dataclass(frozen=True)
class Tracks:
    """One recording, sorted by agent, then by frame."""

    name: str  # for messages: the recording's file stem
    frame: np.ndarray  # frame numbers (N,) int64
    agent: np.ndarray  # agent numbers (N,) int64
    xy: np.ndarray  # positions (N, 2) float64, metres in the world frame
    # what the file said of itself, with the seconds between its frame numbers; see `Source`
    source: Source = PLAIN

    @classmethod
    def from_table(
        cls, name: str, table: np.ndarray, place: Callable[[int], str] = lambda row: f"row {row + 1}"
    ) -> Tracks:
        """Return the tracks of rows (N, 4) of frame, agent, x, y in any order.

        Messages have the recording's ``name``, and ``place`` says where in its source a row is.

        Raises:
            UserError: No rows; a NaN or infinite value; a frame or agent that is not a whole number; an agent
                twice in a frame.
        """
        if len(table) == 0:
            raise UserError(f"recording {name!r} is empty: expected rows of {', '.join(COLUMNS)}")

        def refuse(bad: np.ndarray, why: str, order: np.ndarray | None = None) -> None:
            if bad.any():
                row = int(bad.argmax() if order is None else order[bad.argmax()])
                values = " ".join(f"{value:g}" for value in table[row])
                raise UserError(f"recording {name!r}, {place(row)} ({values}): {why}")

        hint = "a value is not finite; leave out the rows of people who are not seen"
        refuse(~np.all(np.isfinite(table), axis=1), hint)
        whole = np.round(table[:, :2])
        hint = "frame and agent must be whole numbers (of times in seconds: round(time / dt))"
        refuse(np.any((whole != table[:, :2]) | (np.abs(whole) > 2**53), axis=1), hint)
        order = np.lexsort((whole[:, 0], whole[:, 1]))
        frame, agent = whole[order].astype(np.int64).T
        twice = np.append(False, (np.diff(agent) == 0) & (np.diff(frame) == 0))
        first = int(twice.argmax())
        refuse(twice, f"agent {agent[first]} is twice in frame {frame[first]}; expected once", order)
        return cls(name, frame, agent, table[order, 2:])

    @classmethod
    def read(cls, path: str | Path) -> Tracks:
        """Return the tracks of a file, text or SQLite of JuPedSim. Raises UserError: it is none."""
        path = Path(path)
        if not path.is_file():
            raise UserError(f"no recording at {str(path)!r}: expected a file of rows {', '.join(COLUMNS)}")
        try:
            table, place, source = contents_of(path)
        except UnicodeError as error:
            why = getattr(error, "reason", error)
            raise UserError(f"recording {str(path)!r} is not a text file in UTF-8 ({why})") from error
        return replace(cls.from_table(str(path), table, place), name=path.stem, source=source)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.frame)

    @property
    def people(self) -> int:
        """The number of agents."""
        return len(np.unique(self.agent))

    def through(self, homography: np.ndarray) -> Tracks:
        """Return the tracks in metres by a homography (3, 3). Raises UserError: it maps one to infinity."""
        mapped = np.column_stack((self.xy, np.ones(len(self)))) @ homography.T
        if not mapped[:, 2].all():
            x, y = self.xy[np.flatnonzero(mapped[:, 2] == 0)[0]]
            raise UserError(f"the homography maps ({x:g}, {y:g}) of recording {self.name!r} to infinity")
        return replace(self, xy=mapped[:, :2] / mapped[:, 2:])

    def rounded(self, decimals: int) -> Tracks:
        """Return the tracks with positions rounded, as Social GAN does (4) when it loads a file."""
        return replace(self, xy=np.around(self.xy, decimals))

    def resampled(self, seconds_per_frame: float, step: float = STEP_SECONDS, option: str = "dt") -> Tracks:
        """Return the tracks at every ``step`` seconds; frame k is k x step after the recording's first row.

        Positions are interpolated linearly between two rows of an agent. Where an agent was not seen for
        more than two of their usual intervals (and more than one step), the track ends and continues under a
        new agent number. Rows one step apart already stay bit-equal.

        Raises:
            UserError: It lasts longer than any recording, has more rows than are read, or nobody in it moves
                as people do, see `check_walks`.
        """
        time = (self.frame - self.frame.min()) * seconds_per_frame
        what = f"recording {self.name!r} at {seconds_per_frame:g} s per frame number"
        remedy = "give the seconds between consecutive frame numbers (1e-9 for nanoseconds)"
        check_limit(time.max(), LONGEST_RECORDING, what, "seconds", remedy)
        gap, same = np.diff(time), np.diff(self.agent) == 0
        on_grid = np.round(time / step)
        if np.allclose(on_grid * step, time, rtol=0, atol=1e-6) and (np.diff(on_grid)[same] == 1).all():
            check_walks(self, seconds_per_frame, option)
            return replace(self, frame=on_grid.astype(np.int64), source=PLAIN)
        usual = np.median(gap[same]) if same.any() else step
        breaks = ~same | (gap > max(2 * usual, step) + 1e-6)
        piece = np.concatenate(([0], np.cumsum(breaks)))
        starts = np.flatnonzero(np.concatenate(([True], breaks)))
        ends = np.concatenate((starts[1:], [len(self)])) - 1
        first = np.ceil(time[starts] / step - 1e-6).astype(np.int64)
        count = np.maximum(np.floor(time[ends] / step + 1e-6).astype(np.int64) - first + 1, 0)
        remedy += ", or cut it in time"
        check_limit(count.sum(), MOST_POSITIONS, what, f"rows {step:g} s apart", remedy)
        check_walks(self, seconds_per_frame, option)
        of_piece = np.repeat(np.arange(len(starts)), count)
        frame = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[of_piece]
        wanted = np.clip(frame * step, time[starts][of_piece], time[ends][of_piece])
        # one interpolation for all people: an offset for each piece makes time increase over the whole table
        span = time.max() + step
        xy = np.column_stack(
            [np.interp(wanted + of_piece * span, time + piece * span, self.xy[:, axis]) for axis in (0, 1)]
        )
        # the agent's own number for their first piece, a fresh one for later pieces
        numbers, later = self.agent[starts].copy(), np.append(False, np.diff(self.agent[starts]) == 0)
        numbers[later] = numbers.max() + 1 + np.arange(later.sum())
        agent = numbers[of_piece]
        order = np.lexsort((frame, agent))
        return Tracks(self.name, frame[order], agent[order], xy[order])


def rows_apart(tracks: Tracks) -> float:
    """Return the usual frame numbers between two rows of a person; NaN where nobody has two."""
    gap = np.diff(tracks.frame)[np.diff(tracks.agent) == 0]
    return float(np.median(gap)) if len(gap) else np.nan


def check_walks(tracks: Tracks, seconds: float, option: str = "dt") -> None:
    """Refuse tracks of which nobody walks as people do, with ``seconds`` between two frame numbers.

    Raises:
        UserError: Rows are more than 0.8 s apart, the median speed of steps above 0.2 m/s is above 4 m/s, or
            everybody is within 0.1 m. The message has what is likely right, and the ``option`` for it.
    """
    what, apart, moved = f"recording {tracks.name!r}", rows_apart(tracks), _speeds(tracks, seconds)
    usual, likely = _usual(moved), _likely(moved, apart, seconds)
    if apart * seconds > FARTHEST + 1e-6:
        remedy = f"{option} {likely:.3g} is likely" if likely else "record more rows"
        raise UserError(
            f"{what}: rows of a person are {apart:g} frame numbers apart, {apart * seconds:.3g} s with "
            f"{option} {seconds:.3g}, expected at most {FARTHEST:g} s: {remedy}"
        )
    if usual > FASTEST:
        remedies = [f"{option} {likely:.3g}"] if likely else []
        remedies += [
            f"{unit} (name the columns x_{name} and y_{name}, a factor of {factor:g})"
            for unit, (name, factor) in _UNITS.items()
            if 0.5 < usual * factor < 2.5
        ][:1]
        order = np.lexsort((tracks.agent, tracks.frame))
        steps = [
            np.linalg.norm(np.diff(xy, axis=0), axis=1)[np.diff(same) == 0]
            for xy, same in ((tracks.xy[order], tracks.frame[order]), (tracks.xy, tracks.agent))
        ]
        if all(map(len, steps)) and np.median(steps[0]) < 0.5 * np.median(steps[1]):
            remedies += ["a first line that names the columns: they look like agent, frame, x, y"]
        remedies += ["a homography from pixels to metres"]
        raise UserError(
            f"{what}: people move at {usual:.3g} m/s (median of those who move) with {option} {seconds:.3g}, "
            f"expected at most {FASTEST:g}: likely right are {', or '.join(remedies)}"
        )
    extent = float(np.ptp(tracks.xy, axis=0).max()) if len(tracks) else 0.0
    straight = 3 * np.linalg.norm(tracks.xy[-1:] - tracks.xy[:1])
    walked = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1).sum()
    if 0 < extent < _NARROW and (tracks.people > 1 or walked < straight):
        raise UserError(
            f"{what}: everybody is within {extent:.2g} m, expected metres: degrees and kilometres need a "
            "projection or a factor (--data.homography)"
        )


def doubts(tracks: Tracks, seconds: float, option: str) -> list[str]:
    """Return what is unusual of tracks that `check_walks` takes: usual speeds, and single fast steps."""
    moved = _speeds(tracks, seconds)
    if not (moved > 0).any():
        return []
    result, far, usual, high = [], distance(tracks), _usual(moved), brisk(tracks, seconds)
    if usual > _FAST or (high < _SLOW and far > WALKED):
        slow = f"get {far:.2g} m far at less than {high:.2g} m/s"
        how = f"move at {usual:.2g} m/s" if usual > _FAST else slow
        likely = _likely(moved, rows_apart(tracks), seconds)
        hint = f": is it {likely:.3g}?" if likely else ""
        result.append(f"people {how} with {option} {seconds:.3g}{hint}")
    if fast := int((moved > FASTEST).sum()):
        result.append(
            f"{fast} of {len(moved)} steps are faster than {FASTEST:g} m/s (up to {moved.max():.1f}): are "
            "these people on foot, each with one number?"
        )
    return result


@cache
def say(line: str) -> None:
    """Print a line about a file on stderr, once in a process."""
    print(f"pedzoo: {line}", file=sys.stderr)


def brisk(tracks: Tracks, seconds: float) -> float:
    """Return the speed that a tenth of all steps exceed, 0 where nobody has two rows."""
    moved = _speeds(tracks, seconds)
    return float(np.percentile(moved, 90)) if len(moved) else 0.0


def _usual(moved: np.ndarray) -> float:
    """Return the median of the speeds of those who move."""
    return float(np.median(moved[moved > STANDS])) if (moved > STANDS).any() else 0.0


def distance(tracks: Tracks) -> float:
    """Return how far half of all people get at least, from their first to their last place."""
    first = np.flatnonzero(np.diff(tracks.agent, prepend=tracks.agent[0] - 1))
    last = np.concatenate((first[1:], [len(tracks)])) - 1
    return float(np.median(np.linalg.norm(tracks.xy[last] - tracks.xy[first], axis=1)))


def _speeds(tracks: Tracks, seconds: float) -> np.ndarray:
    """Return speeds (M,) over rows about 0.4 s apart, so that jitter of single rows does not count."""
    apart = rows_apart(tracks) * seconds
    rows = max(1, round(STEP_SECONDS / apart)) if apart > 0 else 1
    for many in (rows, 1):  # where nobody is seen so long, from row to row
        same = tracks.agent[many:] == tracks.agent[:-many]
        if same.any():
            moved = np.linalg.norm(tracks.xy[many:] - tracks.xy[:-many], axis=1)[same]
            return moved / ((tracks.frame[many:] - tracks.frame[:-many])[same] * seconds)
    return np.zeros(0)


def _likely(moved: np.ndarray, apart: float, seconds: float) -> float | None:
    """Return the seconds between frame numbers with which people walk as usual; None for no usual rate."""
    fast = moved[moved > 0.25 * np.percentile(moved, 75)] if len(moved) else moved
    if not len(fast) or not np.median(fast) > 0:
        return None
    between = apart * seconds * float(np.median(fast)) / _WALKS
    if not 1 / (1.3 * _RATES[0]) < between < 1.3 / _RATES[-1]:
        return None
    if abs(np.log(between / (apart * seconds))) < 0.3:  # they do so already
        return None
    if abs(np.log(between / seconds)) < 0.4 and np.isclose(1 / seconds, _RATES, rtol=0.01).any():
        return seconds / apart  # it was given from row to row
    return 1 / min(_RATES, key=lambda rate: abs(np.log(rate * between))) / apart


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
    return next((unit for unit in _CLOCKS if _BETWEEN[0] <= usual * unit <= _BETWEEN[1]), None)


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
