"""Checks of what was read from somebody's file: the keys of a mapping, their types, and plain values."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import Any

from pedzoo.errors import UserError, unknown

NOTHING = type(None)

Kinds = Mapping[str, tuple[type, ...]]
"""Keys and the types that their values may have."""

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    list: "a list",
    dict: "a mapping",
    NOTHING: "null",
}


def check_keys(
    found: Any, kinds: Kinds, where: str = "", more: bool = False, optional: Collection[str] = ()
) -> None:
    """Check the keys of a mapping.

    Args:
        found: What should be one.
        kinds: Its keys.
        where: What it is, for the message.
        more: It may have others, too.
        optional: Keys that may be missing.

    Raises:
        UserError: A key is unknown, missing or of another type.
    """
    where = f"{where} " if where else ""
    if not isinstance(found, Mapping):
        raise UserError(f"{where or 'it '}is {found!r:.60}, expected a mapping of {', '.join(kinds)}")
    for key in found:
        if key not in kinds and not more:
            raise unknown(f"{where}key", str(key), kinds)
    for key, wanted in kinds.items():
        if key not in found and key not in optional:
            raise UserError(f"{where}{key} is missing")
        if key in found and not isinstance(found[key], wanted):
            expected = " or ".join(_WORDS[kind] for kind in wanted)
            raise UserError(f"{where}{key} is {found[key]!r:.60}, expected {expected}")


def check_numbers(found: Mapping[Any, Any], where: str, ends: int = 1) -> None:
    """Check that the values of a mapping are numbers, or lists of ``ends`` numbers.

    Raises:
        UserError: One is something else.
    """
    for key, value in found.items():
        numbers = value if ends > 1 else [value]
        if not isinstance(numbers, list) or len(numbers) != ends or not all(map(_is_number, numbers)):
            expected = "a number" if ends == 1 else f"{ends} numbers"
            raise UserError(f"{where} {key!r:.60} is {value!r:.60}, expected {expected}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def check_plain(value: Any) -> None:
    """Check that a value is made of texts, finite numbers, lists and mappings, as JSON is.

    Raises:
        UserError: It holds something else, such as YAML's dates and sets, or a text that does more than be
            read: control characters are orders to a terminal.
    """
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str) and _CONTROL.search(one):
            raise UserError(f"{one!r:.60}: expected no control characters")
        if isinstance(one, Mapping) and all(isinstance(key, str | int) for key in one):
            waiting += [*one, *one.values()]
        elif isinstance(one, list):
            waiting += one
        elif not isinstance(one, str | int | NOTHING) and not (isinstance(one, float) and math.isfinite(one)):
            raise UserError(f"{one!r:.60}: expected plain values (text, finite numbers, lists, mappings)")
