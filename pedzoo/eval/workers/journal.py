"""Finished units in a file, line by line: an evaluation that was interrupted goes on where it was."""

import json
import os
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError

Rows = list[dict[str, Any]]


_BEGIN = b'{"unit": "'
"""What every line begins with."""


class Journal:
    """An append-only file with one line of JSON per finished unit.

    Attributes:
        path: The file; None keeps nothing.
        done: Rows of the units that were there when it was opened, by the units' digests.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file, if there is one; a last line that was cut off is dropped.

        Raises:
            UserError: It is no such file, or cannot be read.
        """
        self.path = path
        self.done: dict[str, Rows] = {}
        if path is None or not path.exists():
            return
        try:
            content = path.read_bytes()
        except OSError as error:
            raise UserError(f"cannot read {str(path)!r}: {error.strerror}") from error
        *lines, torn = content.split(b"\n")
        try:
            if not content.startswith(_BEGIN[: len(content)]):
                raise ValueError
            entries = [json.loads(line) for line in lines]
            self.done = {entry["unit"]: entry["rows"] for entry in entries}
        except (ValueError, LookupError) as error:
            raise UserError(
                f"{str(path)!r} holds no finished parts of an evaluation: name another file, or remove it"
            ) from error
        if torn:
            try:
                os.truncate(path, len(content) - len(torn))
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
        except OSError as error:
            raise UserError(f"cannot write {str(self.path)!r}: {error.strerror}") from error
