"""Finished units in a file, line by line: an evaluation that was interrupted goes on where it was."""

import json
import os
import sys
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically

Rows = list[dict[str, Any]]


_BEGIN = b'{"unit": "'
"""What every line begins with."""


def _entry(line: bytes) -> tuple[str, Rows] | None:
    """Return the unit and the rows of a line, None for one that was not written whole."""
    try:
        entry = json.loads(line) if line.endswith(b"\n") else None
    except (ValueError, RecursionError):
        return None
    match entry:
        case {"unit": str(unit), "rows": [*rows]} if all(isinstance(row, dict) for row in rows):
            return unit, rows
    return None


class Journal:
    """An append-only file with one line of JSON per finished unit.

    Attributes:
        path: The file; None keeps nothing.
        done: Rows of the units that were there when it was opened, by the units' digests.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file, if there is one; lines that are torn are dropped, and said.

        Raises:
            UserError: It is no such file, or cannot be read or mended.
        """
        self.path = path
        self.done: dict[str, Rows] = {}
        if path is None or not path.exists():
            return
        try:
            content = path.read_bytes()
        except OSError as error:
            raise UserError(f"cannot read {str(path)!r}: {error.strerror}") from error
        lines = content.splitlines(keepends=True)
        whole = [line for line in lines if (entry := _entry(line)) and not self.done.update([entry])]
        if not whole and not content.startswith(_BEGIN[: len(content)]):
            raise UserError(
                f"{str(path)!r} holds no finished parts of an evaluation: name another file, or remove it"
            )
        if torn := len(lines) - len(whole):
            parts = f"{torn} finished part{'s' * (torn > 1)}"
            print(f"pedzoo: {path} was cut off in a write: {parts} will be done once more", file=sys.stderr)
            try:
                write_atomically(path, b"".join(whole))
            except OSError as error:
                raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error

    def add(self, digest: str, rows: Rows) -> None:
        """Append a finished unit.

        Raises:
            UserError: The file cannot be written.
        """
        if self.path is None:
            return
        line = json.dumps({"unit": digest, "rows": rows}, allow_nan=False) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a") as file:
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise UserError(f"cannot write {str(self.path)!r}: {error.strerror}") from error
