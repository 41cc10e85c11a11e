"""Columns of tables of text: their names, units and separators, and how letters are written."""

import csv
import re
from pathlib import Path
from typing import NamedTuple

from pedzoo.core.errors import UserError

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

TIMES = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds of a unit."""

LONGEST_LINE = 131_072
"""Letters that are read of a line before it is refused; csv has the same limit for a field."""

_PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip or a workbook", b"BZh": "bzip2", b"\xfd7zXZ": "xz"}
_NAME = re.compile(
    rf"(.+?)(?:-pid\d+)?(?:\s*[\s_/(\[]\s*({'|'.join((*LENGTHS, *TIMES))})[\])]?)?", re.IGNORECASE
)


class Source(NamedTuple):
    """What a file says of itself.

    Attributes:
        form: What it was taken for, in words; empty for columns as ours.
        seconds: Between two frame numbers, where the file says it; else None.
        timed: Whether frame numbers were made of times in it, so that no option can change their unit.
        metres: Of its unit of length, already applied to positions; 0 for pixels, which are as they were.
    """

    form: str = ""
    seconds: float | None = None
    timed: bool = False
    metres: float = 1.0


PLAIN = Source()
"""Of tracks that were not read, and of files with our columns."""


class Column(NamedTuple):
    """A column that a line names: where it stands, its name there, and its unit."""

    place: int
    name: str
    unit: str


def columns_of(line: str, what: str) -> dict[str, Column]:
    """Return the columns of `NAMES` that a line names; of several of a kind the first in that list."""
    columns = {}
    for place, name in enumerate(cells_of(line.lstrip("# \t"), separator_of(line), what)):
        if match := _NAME.fullmatch(name.strip().lower()):
            columns.setdefault(re.sub(r"[^a-z0-9]", "", match[1]), Column(place, name, match[2] or ""))
    return {
        kind: columns[names[0]]
        for kind, known in NAMES.items()
        if (names := [one for one in known.split() if one in columns])
    }


def width_of(line: str, what: str) -> int:
    """Return how many columns a line names."""
    return len(cells_of(line.lstrip("# \t"), separator_of(line), what))


def separator_of(line: str, numbers: bool = False) -> str | None:
    """Return the separator of a line: between spaced numbers, a comma begins a fraction."""

    def spaced(by: str) -> bool:
        return any(len(cell.split()) > 1 for cell in line.split(by))

    if ";" in line:
        return ";"
    if "\t" in line:
        return "\t" if spaced("\t") and not numbers else None
    return "," if "," in line and not (numbers and spaced(",")) else None


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


def is_number(text: str) -> bool:
    """Return whether a text is a number, with a point or a comma."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def encoding_of(path: Path) -> str:
    """Return how the letters of a file are written, by its first bytes.

    Raises:
        UserError: They are not those of a text.
    """
    with path.open("rb") as file:
        begin = file.read(1024)
    if begin.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    packed = [kind for first, kind in _PACKED.items() if begin.startswith(first)]
    if packed or b"\0" in begin:
        kind = f"it is {packed[0]}: unpack or export it" if packed else "it has bytes of zero"
        raise UserError(f"recording {str(path)!r} is not a text file ({kind})")
    return "utf-8-sig"
