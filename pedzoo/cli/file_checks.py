"""Files that a command line names: refused where they are not there, or certainly not what is expected.

Nothing heavy is imported, and no code of a file is run; see `pedzoo.cli.checks`.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.core.paths import Kind, check_there, expanded
from pedzoo.core.registry import file_of_code, names_code
from pedzoo.core.spec import name_of
from pedzoo.data.text_format import TextFormat, check_dt, is_sqlite


def is_code(text: str) -> bool:
    """Return whether a text names a file of code, or something in one."""
    return names_code(text) or text.endswith(".py")


def check_code(what: str, text: str, kind: Kind = "class") -> None:
    """Refuse ``file.py:NAME`` where there is no such file, or certainly nothing of that name in it."""
    text = name_of(text)
    if not is_code(text):  # a path with a colon
        return
    place = text.rpartition(":")[0] if names_code(text) else text
    check_file(what, place)
    if file := file_of_code(place):
        check_there(text, file, kind)


def check_file(what: str, text: str) -> None:
    """Refuse a file that is not there; ``what`` is the word for it, or the option."""
    if not os.path.exists(expanded(text)):
        raise UserError(f"{what}: no file {text!r}")


def check_recording(what: str, text: str) -> None:
    """Refuse a recording that is not there, or whose first line names no or other columns."""
    check_file(what, text)
    with suppress(OSError, UnicodeDecodeError):  # the command has words for these
        if not is_sqlite(path := Path(expanded(text))):
            TextFormat.of(path)


def check_seconds(option: str, text: str | None, of: str, files: Sequence[str] = ()) -> None:
    """Refuse seconds between frame numbers that cannot be, or are missing; what is no number passes.

    The ``files`` may say them instead.
    """
    try:
        dt = None if text in (None, "", "null") else float(text)
    except ValueError:
        return
    check_dt(dt, of, option, [expanded(file) for file in files])


def check_checkpoint(option: str, text: str) -> None:
    """Refuse a checkpoint that is not there."""
    if not Path(text).is_file():
        raise UserError(f"no checkpoint {text!r}")


def check_run(option: str, text: str) -> None:
    """Refuse a folder that is no run."""
    if not (Path(text) / "config.yaml").is_file():
        raise UserError(f"cannot resume {text!r}: it has no config.yaml")
