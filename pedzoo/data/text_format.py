"""The text forms that recordings come in.

Social GAN's (no header, white space, ``frame ped x y``) and CSV with a header that names at least ``frame``,
``agent``, ``x`` and ``y`` in any order. A header over white space and CSV without one work, too.
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import LARGEST_TABLE, check_limit

if TYPE_CHECKING:
    import numpy as np

COLUMNS = ("frame", "agent", "x", "y")
ALIASES = {"agent": ("agent", "ped", "id", "track_id"), "frame": ("frame", "frame_id")}
ENCODING = "utf-8-sig"
"""UTF-8, with or without the mark that spreadsheets put in front."""


def is_recording(text: str) -> bool:
    """Return whether a text names a file of walks rather than a policy."""
    return Path(text).suffix.lower() in (".csv", ".txt", ".tsv")


def check_dt(dt: float | None, of: str = "--data.files", option: str = "--data.dt") -> None:
    """Refuse seconds between two frame numbers that are missing or cannot be.

    Args:
        dt: The seconds.
        of: Whose frame numbers these are, for the message.
        option: The option that has them.

    Raises:
        UserError: They are missing, not above 0, or 5 s or more.
    """
    if dt is None or not 0 < dt < 5:
        raise UserError(
            f"{option} is {dt}: give the seconds between two consecutive frame numbers of {of} "
            "(0.04 for a 25 Hz video whose frames are numbered one by one)"
        )


@dataclass(frozen=True)
class TextFormat:
    """How a text file holds its table.

    Attributes:
        delimiter: Separator of two values; None for white space.
        header: Whether the first line names the columns.
        columns: Where frame, agent, x and y stand.
    """

    delimiter: str | None
    header: bool
    columns: tuple[int, ...]

    @classmethod
    def of(cls, path: Path) -> TextFormat:
        """Find out from the first line of a file.

        Raises:
            UserError: It names no or other columns, there are not four, or the file is too large.
        """
        remedy = "cut the recording into several files"
        check_limit(path.stat().st_size, LARGEST_TABLE, f"recording {str(path)!r}", "bytes", remedy)
        with path.open(encoding=ENCODING) as file:
            head = file.readline()
        delimiter = "," if "," in head else None
        names = [name.strip().lower() for name in _fields(head.lstrip("# "), delimiter)]
        if any(_is_number(name) for name in names) or not head.strip():
            if len(names) not in (0, 4):
                raise UserError(
                    f"recording {str(path)!r} has {len(names)} columns: expected {', '.join(COLUMNS)}, or a "
                    "first line that names the columns"
                )
            return cls(delimiter, False, (0, 1, 2, 3))
        columns = []
        for column in COLUMNS:
            matches = [names.index(alias) for alias in ALIASES.get(column, (column,)) if alias in names]
            if not matches:
                raise UserError(
                    f"recording {str(path)!r} has no column {column!r}: its first line is "
                    f"{head.strip()!r:.200}, expected {','.join(COLUMNS)} (any order, more columns are "
                    "ignored)"
                )
            columns.append(matches[0])
        return cls(delimiter, True, tuple(columns))

    def numbers(self, path: Path) -> np.ndarray:
        """Return the table (N, 4).

        Raises:
            UserError: Text in a number's place, or a value is missing.
        """
        import numpy as np  # commands look at first lines before anything heavy is imported

        try:
            # numpy unpacks archives where it is given a path; callers have words for empty files
            with path.open(encoding=ENCODING) as file, warnings.catch_warnings(action="ignore"):
                table = np.loadtxt(
                    file,
                    ndmin=2,
                    comments=None,
                    quotechar='"',
                    delimiter=self.delimiter,
                    skiprows=int(self.header),
                    usecols=self.columns if self.header else None,
                )
        except UnicodeDecodeError:
            raise
        except ValueError:
            table = None
        if table is None or (len(table) and table.shape[1] != len(COLUMNS)):  # begins with an empty line
            return np.fromiter(self._one_by_one(path), dtype=np.dtype((float, len(COLUMNS))))
        return table

    def _one_by_one(self, path: Path) -> Iterator[list[float]]:
        """Yield the rows as Python reads them: more forgiving than `numpy.loadtxt`, and knows the line."""
        for number, fields in self._lines(path):
            try:
                row = [float(fields[column]) for column in self.columns]
            except (ValueError, IndexError):
                row = []
            if not row or (len(fields) != 4 and not self.header):
                raise UserError(
                    f"recording {str(path)!r}, line {number}: expected numbers {', '.join(COLUMNS)}, "
                    f"got {(self.delimiter or ' ').join(fields)!r:.200}"
                )
            yield row

    def line_of(self, path: Path, row: int) -> int:
        """Return the number of the line that holds a row of the table."""
        return next(islice(self._lines(path), row, None))[0]

    def _lines(self, path: Path) -> Iterator[tuple[int, list[str]]]:
        with path.open(encoding=ENCODING) as file:
            for number, line in enumerate(file, 1):
                if line.strip() and number > self.header:
                    yield number, _fields(line, self.delimiter)


def _fields(line: str, delimiter: str | None) -> list[str]:
    return next(csv.reader([line.strip()], skipinitialspace=True), []) if delimiter else line.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
