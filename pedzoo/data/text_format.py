"""The text forms that recordings come in: any table with a line that names its columns, and two without.

Social GAN's has no such line (``frame ped x y``); PedPy's (``id frame x y z``) says ``# framerate: 16``.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TextIO

from pedzoo.core.errors import UserError
from pedzoo.core.untrusted import LARGEST_TABLE, check_limit

if TYPE_CHECKING:
    import numpy as np

COLUMNS = ("frame", "agent", "x", "y")
NAMES = {
    "frame": "frame frameid framenumber frameno framenr frameindex fr timestep",
    "time": "time t simtime timestamp timesec seconds sec",
    "agent": "agent agentid ped pedid id track trackid pedestrian pedestrianid personid persid pid "
    "object objectid",
    "x": "x posx xpos positionx startx",
    "y": "y posy ypos positiony starty",
    "end time": "endtime",
    "end x": "endx",
    "end y": "endy",
}
"""Names of columns, without capitals, separators and units; Vadere has a footstep with its end in a row."""

LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **{"cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "feet": 0.3048},
    **dict.fromkeys(("px", "pixel", "pixels"), 0.0),
}
"""Metres of a unit; 0 for pixels, which only a homography makes metres."""

TIMES = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # seconds of a unit

LONGEST_LINE = 131_072
"""Letters that are read of a line before it is refused; csv has the same limit for a field."""

CUT = "cut the recording into several files"

_PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip or a workbook", b"BZh": "bzip2", b"\xfd7zXZ": "xz"}
_NAME = re.compile(
    rf"(.+?)(?:-pid\d+)?(?:\s*[\s_/(\[]\s*({'|'.join((*LENGTHS, *TIMES))})[\])]?)?", re.IGNORECASE
)


class Source(NamedTuple):
    """What a file says of itself."""

    form: str = ""  # what it was taken for, in words; empty for columns as ours
    seconds: float | None = None  # between two frame numbers, where the file says it; else None
    # whether frame numbers were made of times in it, so that no option can change their unit
    timed: bool = False
    # of its unit of length, already applied to positions; 0 for pixels, which are as they were
    metres: float = 1.0


PLAIN = Source()  # of tracks that were not read, and of files with our columns


class Column(NamedTuple):
    """A column that a line names: where it stands, its name there, and its unit."""

    place: int
    name: str
    unit: str


_ENDS = ["end time", "end x", "end y"]
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".traj", ".sqlite", ".sqlite3", ".db")
_RATE = re.compile(r"(?:frame\s*rate|\bfps)[^\d\n]*(\d+(?:[.,]\d*)?)", re.IGNORECASE)
_IN_COMMENT = re.compile(rf"(?:\bx\s*/|\bin)\s*({'|'.join(LENGTHS)})\b", re.IGNORECASE)


def cells_of(line: str, delimiter: str | None, what: str) -> list[str]:
    """Return the cells of a line; the message for one that is too long begins with ``what``."""
    if len(line) > LONGEST_LINE:
        raise UserError(f"{what} has a line of more than {LONGEST_LINE:,} letters: is it a recording?")
    if delimiter is None:
        return line.split()
    try:
        return next(csv.reader([line.strip("\r\n ")], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:
        raise UserError(f"{what}: {line.strip()!r:.200} cannot be read: {error}") from error


def _named_in(line: str, what: str) -> tuple[dict[str, Column], int]:
    """Return the columns of `NAMES` that a line names, of several the first in that list; and its width."""
    columns, cells = {}, cells_of(line.lstrip("# \t"), _separator_of(line), what)
    for place, name in enumerate(cells):
        if match := _NAME.fullmatch(name.strip().lower()):
            columns.setdefault(re.sub(r"[^a-z0-9]", "", match[1]), Column(place, name, match[2] or ""))
    found = {kind: [one for one in known.split() if one in columns] for kind, known in NAMES.items()}
    return {kind: columns[names[0]] for kind, names in found.items() if names}, len(cells)


def _separator_of(line: str, numbers: bool = False) -> str | None:
    """Return the separator of a line: between spaced numbers, a comma begins a fraction."""

    def spaced(by: str) -> bool:
        return any(len(cell.split()) > 1 for cell in line.split(by))

    if ";" in line:
        return ";"
    if "\t" in line:
        return "\t" if spaced("\t") and not numbers else None
    return "," if "," in line and not (numbers and spaced(",")) else None


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def is_recording(text: str) -> bool:
    """Return whether a text names a file of walks rather than a policy."""
    path = Path(text)
    if path.suffix.lower() in (".gz", ".zip"):
        path = path.with_suffix("")
    return path.suffix.lower() in _SUFFIXES


def check_dt(
    dt: float | None, of: str = "--data.files", option: str = "--data.dt", files: Sequence[str | Path] = ()
) -> None:
    """Refuse seconds between two frame numbers that are missing, not above 0, or 5 s or more.

    Args:
        dt: The seconds; None is fine where all ``files`` may say their own times.
        of: Whose frame numbers these are, for the message.
        option: The option that has them.
        files: The recordings.

    Raises:
        UserError: They are.
    """
    if dt is None and files and all(_may_have_times(Path(file)) for file in files):
        return
    if dt is None or not 0 < dt < 5:
        raise UserError(
            f"{option} is {dt}: give the seconds between two consecutive frame numbers of {of} "
            "(0.04 for a 25 Hz video whose frames are numbered one by one)"
        )


def _may_have_times(path: Path) -> bool:
    try:
        return is_sqlite(path) or (form := TextFormat.of(path)).rate is not None or form.time is not None
    except OSError:
        return False
    except (UserError, UnicodeError):  # refused, with words of their own, where they are read
        return True


def is_sqlite(path: Path) -> bool:
    """Return whether a file is a database of SQLite, whatever its name."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


@dataclass(frozen=True)
class TextFormat:
    """How a text file holds its table."""

    encoding: str  # of the text
    skip: int  # lines before the first row
    delimiter: str | None  # separator of two values; None for white space
    width: int  # columns
    # where frame (or time), agent, x and y stand; behind them a time beside frames, or the ends of footsteps
    # (time, x, y)
    columns: tuple[int, ...]
    names: tuple[str, ...]  # what these are called in the file; empty where nothing says it
    time: float | None  # seconds of the unit of a time; 0 where it has none, None without such a column
    rate: float | None  # frames per second, by a comment; else None
    metres: float  # see `Source`
    decimal: bool  # whether fractions begin with a comma

    @classmethod
    def of(cls, path: Path) -> TextFormat:
        """Find out from a file's first lines. Raises UserError: it lacks a column, or is too large."""
        what = f"recording {str(path)!r}"
        check_limit(path.stat().st_size, LARGEST_TABLE, what, "bytes", CUT)
        with path.open("rb") as file:
            begin = file.read(1024)
        encoding = "utf-16" if begin.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
        packed = [kind for first, kind in _PACKED.items() if begin.startswith(first)]
        if packed or (b"\0" in begin and encoding != "utf-16"):
            kind = f"it is {packed[0]}: unpack or export it" if packed else "it has bytes of zero"
            raise UserError(f"{what} is not a text file ({kind})")
        with path.open(encoding=encoding) as file:
            comments, head = _until_text(what, file)
            named = bool(head) and not any(map(_is_number, cells_of(head, _separator_of(head), what)))
            row = _until_text(what, file)[1] if named else head
        delimiter = _separator_of(head) if named else None
        if delimiter is None or ";" in row:
            delimiter = _separator_of(row, numbers=True)
        width, found = len(cells_of(row or head, delimiter, what)), {}
        for text in [head] if named else reversed(comments):
            columns, count = _named_in(text, what)
            lacking = [
                one for one in COLUMNS if one not in columns and (one != "frame" or "time" not in columns)
            ]
            if not named and (count != width or (lacking and not {"x", "y"} <= {*columns})):
                continue  # a remark
            if lacking:
                degrees = "; project degrees to metres" * bool(re.search(r"(?i)\blat|\blon|degree", text))
                raise UserError(
                    f"{what} has no column {lacking[0]!r}: its first line is {text.strip()!r:.200}, expected "
                    f"{','.join(COLUMNS)} (any order, time instead of frame, more are ignored){degrees}"
                )
            if count != width and row:
                raise UserError(
                    f"{what}: {row.strip()!r:.200} has {width} columns, but {count} are named; numbers with "
                    "a comma need another separator of columns"
                )
            found = columns
            break
        comment = "\n".join(comments)
        rate = float(match[1].replace(",", ".")) if (match := _RATE.search(comment)) else None
        if not found and head and width != 4 and not (rate and width == 5):
            raise UserError(
                f"{what} has {width} columns: expected {', '.join(COLUMNS)}, or a first line that names the "
                "columns"
            )
        kinds = ["frame" if "frame" in found else "time", "agent", "x", "y"] if found else []
        if kinds and kinds[0] == "time" and {*_ENDS} <= {*found}:
            kinds += _ENDS
        elif kinds and kinds[0] == "frame" and "time" in found:
            cells = cells_of(row, delimiter, what)
            kinds += ["time"] * bool(row and _is_number(cells[found["time"].place]))
        used = [found[kind] for kind in kinds]
        units = [one.unit for one in used if one.unit in LENGTHS] or [
            match[1].lower() for match in _IN_COMMENT.finditer(comment)
        ]
        if len(lengths := {LENGTHS[unit] for unit in units}) > 1:
            raise UserError(f"{what} has {' and '.join(units)}: expected one unit of length")
        return cls(
            encoding=encoding,
            skip=len(comments) + named,
            delimiter=delimiter,
            width=width,
            # PedPy's begin with the person where nothing names the columns
            columns=tuple(one.place for one in used) or ((1, 0, 2, 3) if rate else (0, 1, 2, 3)),
            names=tuple(one.name for one in used),
            time=TIMES.get(found["time"].unit, 0.0) if "time" in kinds else None,
            rate=rate,
            metres=lengths.pop() if lengths else 1.0,
            decimal=delimiter != "," and "," in row,
        )

    @property
    def form(self) -> str:
        """What the file is, in words; empty for columns as ours."""
        if self.steps:
            return "footsteps of Vadere"
        if self.rate:
            return f"PedPy text ({', '.join(self.names) or 'id, frame, x, y'})"
        if {*self.names} <= {*COLUMNS} and not self.decimal:
            return ""
        kind = {",": "CSV", ";": "CSV with semicolons"}.get(self.delimiter or "", "text")
        return f"{kind} ({', '.join(self.names or COLUMNS)})" + " with decimal commas" * self.decimal

    @property
    def steps(self) -> bool:
        """Whether rows are footsteps, with a begin and an end."""
        return len(self.columns) == len(COLUMNS) + len(_ENDS)

    def numbers(self, path: Path) -> np.ndarray:
        """Return the table (N, C) of ``columns``. Raises UserError: a value is missing or no number."""
        import numpy as np  # commands look at first lines before anything heavy is imported

        try:
            # numpy unpacks archives where it is given a path; callers have words for empty files
            with path.open(encoding=self.encoding) as file, warnings.catch_warnings(action="ignore"):
                lines = islice(file, self.skip, None)
                texts = (line.replace(",", ".") for line in lines) if self.decimal else lines
                table = np.loadtxt(texts, ndmin=2, comments=None, quotechar='"', delimiter=self.delimiter)
            if not len(table) or table.shape[1] == self.width:
                return table[:, self.columns] if len(table) else table
        except UnicodeDecodeError:
            raise
        except ValueError:
            pass  # a text beside numbers, or a mistake
        return np.fromiter(self._one_by_one(path), dtype=np.dtype((float, len(self.columns))))

    def _one_by_one(self, path: Path) -> Iterator[list[float]]:
        """Yield the rows as Python reads them: more forgiving than `numpy.loadtxt`, and knows the line."""
        for number, fields in self._lines(path):
            row = []
            if len(fields) == self.width or (len(fields) == self.width + 1 and not fields[-1]):
                with suppress(ValueError):
                    row = [float(fields[column]) for column in self.columns]
            if not row:
                raise UserError(
                    f"recording {str(path)!r}, line {number}: expected {self.width} columns with numbers "
                    f"{', '.join(self.names or COLUMNS)}, got {(self.delimiter or ' ').join(fields)!r:.200}"
                )
            yield row

    def line_of(self, path: Path, row: int) -> int:
        """Return the number of the line that holds a row of the table."""
        return next(islice(self._lines(path), row, None))[0]

    def _lines(self, path: Path) -> Iterator[tuple[int, list[str]]]:
        with path.open(encoding=self.encoding) as file:
            for number, line in enumerate(file, 1):
                if number > self.skip and line.strip() and not line.lstrip().startswith("#"):
                    if self.delimiter != ",":
                        line = line.replace(",", ".")
                    yield number, cells_of(line, self.delimiter, f"recording {str(path)!r}, line {number}")


def _until_text(what: str, file: TextIO) -> tuple[list[str], str]:
    """Return a text's next lines that are empty or comments, and the one behind them."""
    before = []
    for line in iter(lambda: file.readline(LONGEST_LINE + 1), ""):
        cells_of(line, None, what)
        if line.strip() and not line.lstrip().startswith("#"):
            return before, line
        before.append(line)
    return before, ""
