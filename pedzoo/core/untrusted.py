"""What is read from files: limits of their size, and checks of their values; no file makes code run.

Limits are above all real use, and checked before memory is taken: a small file can expand to a large one by
references that multiply, pictures of one colour, frame numbers far apart. The error of a file above a limit
names the limit and a remedy.
"""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import msgspec
import yaml

from pedzoo.core.errors import UserError
from pedzoo.core.registry import names_code

LARGEST_CARD = 2_000_000
"""Bytes of a model card, of the page of a model, and of the config in a file of weights."""

LARGEST_YAML = 10_000_000
"""Bytes of a config or of the yaml of a floor plan."""

LARGEST_WEIGHTS = 4_000_000_000
"""Bytes of weights that a card may name."""

LARGEST_TABLE = 1_000_000_000
"""Bytes of a recording, about 25 million rows."""

LARGEST_PICTURE = 8192 * 8192
"""Pixels of the picture of a floor plan, and cells of the plan: 400 x 400 m in cells of 5 cm."""

MOST_POSITIONS = 5_000_000
"""Rows of a recording at steps of 0.4 s: 500 hours of one person."""

MOST_PEOPLE = 10_000
"""People in a scene."""

LONGEST_RECORDING = 366 * 86_400.0
"""Seconds of a recording."""

DEEPEST = 20
"""Levels of values in YAML and JSON; libyaml does not survive a hundred thousand."""

MOST_VALUES = 100_000
"""Values in YAML: 10,000 people of a scenario have 70,000, and a second reads so many."""

MOST_DIGITS = 300
"""Letters of a whole number: a number of more is larger than every floating point number."""

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_WORDS = {str: "a text", bool: "true or false", int: "a whole number", float: "a number", NoneType: "null"}

_NO_YAML = (yaml.YAMLError, ValueError, LookupError, AttributeError, ArithmeticError)
"""Errors of values that do not fit their form, such as a date on the 99th of a month."""


def check_limit(value: float, limit: float, what: str, unit: str, remedy: str) -> None:
    """Raise UserError where a value exceeds a limit: ``what`` has how many of a ``unit``, and the remedy."""
    if not value <= limit:
        raise UserError(f"{what} has {value:,.15g} {unit}, at most {limit:,.15g} are read: {remedy}")


def read_text(path: Path, limit: int = LARGEST_YAML) -> str:
    """Return a text file of at most ``limit`` bytes.

    Raises:
        UserError: It is larger, or not in UTF-8.
        OSError: It cannot be read.
    """
    check_limit(path.stat().st_size, limit, repr(str(path)), "bytes", "is it the right file?")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{str(path)!r} is no text in UTF-8 ({error.reason}): save it as UTF-8") from error


def load_yaml(text: bytes | str, references: bool = False) -> Any:
    """Return the values of untrusted YAML; ``references`` (``*``) are for what people write for themselves.

    Raises:
        UserError: It is no YAML, has values that are not of the kind they say, too many values or levels, or
            references.
    """
    try:
        loader = _counted(text, references)
        return None if loader.counted is None else loader.construct_document(loader.counted)
    except UserError:
        raise
    except _NO_YAML as error:
        raise UserError(f"cannot be read: {' '.join(str(error).split())}") from error


def read_mapping(path: Path, what: str, expected: str) -> dict[Any, Any]:
    """Return the mapping in a YAML file of one's own, in which references may stand.

    Raises:
        UserError: It cannot be read, is no YAML, or no mapping: ``what`` it is, and what was ``expected``.
    """
    try:
        settings = load_yaml(read_text(path), references=True)
    except OSError as error:
        raise UserError(f"{what} {str(path)!r} cannot be read: {error.strerror}") from error
    except UserError as error:
        raise UserError(f"{what} {str(path)!r} is no YAML: {error}") from error
    if not isinstance(settings, dict):
        raise UserError(f"{what} {str(path)!r}: expected {expected}, not {settings!r:.60}")
    return settings


_SAFE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's: `pedzoo models` reads all cards


class _Loader(_SAFE):
    """The safe loader, with whole numbers of at most `MOST_DIGITS`."""

    counted: Any

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return a whole number."""
        check_limit(len(node.value), MOST_DIGITS, f"{node.value[:20]}...", "digits", "write a smaller number")
        return super().construct_yaml_int(node)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def check_yaml(value: Any) -> None:
    """Check all texts in a value, which jsonargparse reads as YAML: they have the limits of `load_yaml`.

    Raises:
        UserError: One exceeds them. What is no YAML passes.
    """
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str):
            with suppress(yaml.YAMLError):
                _counted(one, references=True)
        elif isinstance(one, dict | list):
            waiting += one.values() if isinstance(one, dict) else one


def _counted(text: bytes | str, references: bool) -> Any:
    """Return a loader of YAML that has ``counted`` values, references and merges (``<<``) written out."""
    expected = f"{'' if references else 'no references (*) and '}at most {DEEPEST} levels of values"
    depth = values = 0
    for event in yaml.parse(text, _Loader):
        values += not isinstance(event, yaml.CollectionEndEvent)
        check_limit(values, MOST_VALUES, "it", "values or more", "write fewer")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST or (isinstance(event, yaml.AliasEvent) and not references):
            raise UserError(f"expected {expected}")
    loader = _Loader(text)
    loader.counted = loader.get_single_node()
    try:
        values = _values_in(loader.counted, {})
    except RecursionError as error:
        raise UserError("cannot be read: a value is inside itself") from error
    check_limit(values, MOST_VALUES, "it", "values", "write fewer references (*)")
    return loader


def _values_in(node: Any, known: dict[int, int]) -> int:
    """Return the number of values with references written out: a merge would build as many pairs at most."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) not in known:
        parts = [pair[1] for pair in node.value] if isinstance(node, yaml.MappingNode) else node.value
        known[id(node)] = 1 + sum(_values_in(part, known) for part in parts)
    return known[id(node)]


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


def refuse_code(value: Any, what: str, remedy: str) -> None:
    """Raise UserError where a value names a file of code, as a key or value at any depth.

    Only a person names code: in a command, or in a config of their own.

    Args:
        value: What was read from a file.
        what: What it is, for the message.
        remedy: What a person can do who wants that code to run.
    """
    for one in _all_in(value):
        if isinstance(one, str) and names_code(one):
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
