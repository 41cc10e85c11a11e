"""What stands in files of code, ``path/to/file.py:NAME``, as their text says: none of them is run."""

import ast
import re
from pathlib import Path
from typing import Literal

from pedzoo.core.errors import UserError, unknown

Kind = Literal["class", "function"]

_UNSEEN = re.compile(r"\b(globals|locals|vars|exec|eval|setattr|__dict__|__getattr__)\b|import\s*\*")
"""A file with one of these may have names that are not written in it."""


def names_in(file: Path, kind: Kind) -> list[str]:
    """Return the public classes or functions that a file defines itself, in their order."""
    node_type = ast.ClassDef if kind == "class" else ast.FunctionDef
    try:
        body = ast.parse(file.read_text(encoding="utf-8")).body
    except (OSError, SyntaxError, ValueError):  # whoever runs the file says what is wrong with it
        return []
    return [node.name for node in body if isinstance(node, node_type) and not node.name.startswith("_")]


def check_named(given: str, file: Path, kind: Kind) -> None:
    """Refuse ``file.py`` or ``file.py:``, which do not say what of the file is meant.

    Args:
        given: What was given.
        file: Where the file is.
        kind: What is expected of it.

    Raises:
        UserError: No name is given.
    """
    name, _, wanted = given.rpartition(":") if ".py:" in given else (given, "", "")
    if wanted:
        return
    known = [f"{name}:{one}" for one in names_in(file, kind)[:5]]
    such = f", such as {' or '.join(known)}" if known else f"; it defines no {kind}"
    raise UserError(f"{name!r:.200}: expected {name:.200}:{kind.upper()}{such}")


def check_there(given: str, file: Path, kind: Kind) -> None:
    """Refuse ``file.py:NAME`` where that name is certainly not in the file; doubtful ones pass.

    Raises:
        UserError: As of `check_named`, or the name stands nowhere in the file.
    """
    check_named(given, file, kind)
    place, _, name = given.rpartition(":")
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return
    if re.search(rf"\b{re.escape(name)}\b", text) or _UNSEEN.search(text) or not name.isascii():
        return
    if known := names_in(file, kind):  # else it is no Python, or takes all of it from elsewhere
        raise missing(place, kind, name, known)


def missing(place: str, kind: Kind, name: str, known: list[str]) -> UserError:
    """Return the error for a name that is not in a file."""
    return unknown(f"{kind} in {place}", name, known)
