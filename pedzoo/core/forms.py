"""Checks of values that were read from a file: their types, plain values, and no code."""

import math
import re
from collections.abc import Iterator, Mapping, Set
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import msgspec

from pedzoo.core.errors import UserError
from pedzoo.core.registry import absolute_name, names_code

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_WORDS = {str: "a text", bool: "true or false", int: "a whole number", float: "a number", NoneType: "null"}


def check(value: Any, form: Any, where: str = "") -> None:
    """Raise UserError for a value that msgspec does not convert to a type; ``where`` names it in the message.

    The type may be plain, a ``Literal``, a union, a container, a `TypedDict` or a `msgspec.Struct`. Its keys
    are checked, too.
    """
    try:
        msgspec.convert(value, form)
    except msgspec.ValidationError as error:
        raise UserError(said(error, where, value, form)) from error
    except TypeError:
        return  # a type of a plugin's that msgspec does not know: its class checks the value


def said(error: msgspec.ValidationError, where: str = "", value: Any = None, form: Any = None) -> str:
    """Return msgspec's message with the place in front: ``training.epoch: Expected `int`, got `str```."""
    reason, _, place = str(error).partition(" - at `$")
    if (where and not place and not isinstance(value, Mapping)) or get_origin(form) is Literal:
        return f"{where or 'it'} is {value!r:.60}, expected {_in_words(form)}"
    place = f"{where}{place.rstrip('`')}".strip(".")
    return f"{place}: {reason}" if place else reason


def _in_words(form: Any) -> str:
    if get_origin(form) is Literal:
        return " or ".join(map(repr, get_args(form)))
    if get_origin(form) in (Union, UnionType):
        return " or ".join(map(_in_words, get_args(form)))
    return _WORDS.get(form) or str(getattr(form, "__name__", form))


def check_plain(value: Any) -> None:
    """Raise UserError for all but texts, finite numbers of 64 bits, lists and mappings, as JSON has them.

    YAML has dates and sets, too. Control characters are refused: they are orders to a terminal.
    """
    for one in _all_in(value):
        if isinstance(one, str) and _CONTROL.search(one):
            raise UserError(f"{one!r:.60}: expected no control characters")
        fits = isinstance(one, str | bool | NoneType | list | tuple)
        fits |= isinstance(one, Mapping) and all(isinstance(key, str | int) for key in one)
        fits |= isinstance(one, int) and abs(one) < 2**63
        fits |= isinstance(one, float) and math.isfinite(one)
        if not fits:
            given = type(one).__name__ if isinstance(one, int) else f"{one!r:.60}"  # repr has limits
            raise UserError(f"{given}: expected plain values (text, finite numbers, lists, mappings)")


def refuse_code(value: Any, what: str, remedy: str, typed: Set[str] = frozenset()) -> None:
    """Raise UserError where a value names a file of code, as a key or value at any depth.

    Only a person names code: in a command, or in a config of their own.

    Args:
        value: What was read from a file.
        what: What it is, for the message.
        remedy: What a person can do who wants that code to run.
        typed: What that person has named, as of `absolute_name`: it passes.
    """
    for one in _all_in(value):
        if isinstance(one, str) and names_code(one) and absolute_name(one) not in typed:
            raise UserError(
                f"{what}: {one!r:.200} is in a file of code, and no other file ever makes code run: {remedy}"
            )


def _all_in(value: Any) -> Iterator[Any]:
    """Yield a value and all keys and values in it, at any depth."""
    waiting = [value]
    while waiting:
        yield (one := waiting.pop())
        if isinstance(one, Mapping):
            waiting += [*one, *one.values()]
        elif isinstance(one, list | tuple):
            waiting += one
