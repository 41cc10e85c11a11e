"""Checks of what was read from a file: its typed form, and plain values."""

import math
import re
from collections.abc import Mapping, Set
from dataclasses import is_dataclass
from functools import cache, partial
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints

from typing_extensions import is_typeddict

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import names_code, whole_name

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_WORDS = {
    str: "a text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    list: "a list",
    dict: "a mapping",
    NoneType: "null",
}

_hints = cache(partial(get_type_hints, include_extras=True))


def check(result: Any, form: Any, where: str = "") -> None:
    """Check that a value has a form.

    Args:
        result: The value.
        form: A `TypedDict` (``closed`` ones refuse other keys), a dataclass (its fields as keys),
            ``list[X]``, ``dict[str, X]``, ``tuple[X, X]`` (a list of so many), ``Literal``, a plain type; one
            of these ``| None``; or ``Annotated[type, form]``.
        where: What it is, for the message.

    Raises:
        UserError: A key is unknown or missing, or a value is of another type.
    """
    while get_origin(form) in (Annotated, NotRequired):
        form = get_args(form)[-1]
    choices = get_args(form) if get_origin(form) in (Union, UnionType) else (form,)
    if form is Any or (NoneType in choices and _fits(result, NoneType)):
        return
    form = choices[0]
    if is_typeddict(form) or is_dataclass(form):
        check_keys(result, form, where)
        for key in _hints(form).keys() & result.keys():
            check(result[key], _hints(form)[key], f"{where} {key}".strip())
        return
    if not _fits(result, form):
        expected = " or ".join(map(_in_words, choices))
        raise UserError(f"{where or 'it'} is {result!r:.60}, expected {expected}")
    kind, inner = get_origin(form), get_args(form)
    if kind is dict:
        for key, value in result.items():
            check(value, inner[1], f"{where} {key!r:.60}")
    elif kind is list:
        for value in result:
            check(value, inner[0], where)


def check_keys(result: Any, form: Any, where: str = "") -> None:
    """Check the keys of a mapping, and not their values. Arguments and errors as of `check`."""
    known, where = _hints(form), f"{where} " if where else ""
    if not isinstance(result, Mapping):
        raise UserError(f"{where or 'it '}is {result!r:.60}, expected a mapping of {', '.join(known)}")
    for key in result:
        if key not in known and getattr(form, "__closed__", True):
            raise unknown(f"{where}key", str(key), known)
    for key in known:
        if key not in result and get_origin(known[key]) is not NotRequired:
            raise UserError(f"{where}{key} is missing")


def _fits(result: Any, form: Any) -> bool:
    kind, inner = get_origin(form) or form, get_args(form)
    if kind is Literal:
        return any(result == one and type(result) is type(one) for one in inner)
    if kind is tuple:
        return isinstance(result, list) and len(result) == len(inner) and all(map(_fits, result, inner))
    if isinstance(result, bool):
        return kind is bool
    return isinstance(result, int | float if kind is float else kind)


def _in_words(form: Any) -> str:
    kind = get_origin(form) or form
    if kind is Literal:
        return " or ".join(map(repr, get_args(form)))
    return f"{len(get_args(form))} numbers" if kind is tuple else _WORDS[kind]


def check_plain(value: Any) -> None:
    """Check that a value is made of texts, finite numbers of 64 bits, lists and mappings, as JSON is.

    Raises:
        UserError: It holds something else, such as YAML's dates and sets, or control characters, which are
            orders to a terminal.
    """
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str) and _CONTROL.search(one):
            raise UserError(f"{one!r:.60}: expected no control characters")
        if isinstance(one, Mapping) and all(isinstance(key, str | int) for key in one):
            waiting += [*one, *one.values()]
        elif isinstance(one, list | tuple):
            waiting += one
        elif not isinstance(one, str | NoneType) and not _plain_number(one):
            given = type(one).__name__ if isinstance(one, int) else f"{one!r:.60}"  # repr has limits
            raise UserError(f"{given}: expected plain values (text, finite numbers, lists, mappings)")


def _plain_number(value: Any) -> bool:
    if isinstance(value, int):
        return abs(value) < 2**63
    return isinstance(value, float) and math.isfinite(value)


def refuse_code(value: Any, what: str, remedy: str, typed: Set[str] = frozenset()) -> None:
    """Check that nothing in a value, key or value at any depth, names a file of code.

    Only a person names code: in a command, or in a config of their own.

    Args:
        value: What was read from a file.
        what: What it is, for the message.
        remedy: What a person can do who wants that code to run.
        typed: What that person has named, as of `whole_name`.

    Raises:
        UserError: It names another one.
    """
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str) and names_code(one) and whole_name(one) not in typed:
            raise UserError(
                f"{what}: {one!r:.200} is in a file of code, and no other file ever makes code run: {remedy}"
            )
        if isinstance(one, Mapping):
            waiting += [*one, *one.values()]
        elif isinstance(one, list | tuple):
            waiting += one
