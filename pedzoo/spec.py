"""Things that are named with their settings behind a colon: ``orca:radius=0.3,walls=true``."""

from __future__ import annotations

import inspect
import re
from typing import Any, NamedTuple, get_type_hints

from pedzoo.errors import UserError, unknown
from pedzoo.registry import Registry

_ADDRESS = re.compile(r"(hf|https?)://[^/:]*(:\d+(?=/))?[^:]*")
"""An address on the net: the colons of its scheme and its port are its own."""


class Spec(NamedTuple):
    """A name and the settings that were written behind it, as text."""

    name: str
    settings: dict[str, str]


def parse(text: str) -> Spec:
    """Return the parts of ``name``, ``name:key=value,key=[a,b]`` or ``path/to/file.py:Class:key=value``.

    A name may be an address: ``hf://owner/repo:key=value``.

    Raises:
        UserError: A setting without ``=``, or given twice.
    """
    address = _ADDRESS.match(text)
    name = address[0] if address else text.partition(":")[0]
    _, colon, rest = text.removeprefix(name).partition(":")
    if name.endswith(".py"):
        inside, colon, rest = rest.partition(":")
        name = f"{name}:{inside}"
    settings: dict[str, str] = {}
    for part in split(rest) if colon else []:
        key, equals, value = part.partition("=")
        if not equals or not key.strip():
            raise UserError(f"{text!r}: {part!r} is no setting: expected {name}:key=value,key=value")
        if key.strip() in settings:
            raise UserError(f"{text!r}: {key.strip()!r} is given twice")
        settings[key.strip()] = value.strip()
    return Spec(name, settings)


def build(registry: Registry, text: str, base: type, **given: Any) -> Any:
    """Return an instance of what ``text`` names, every setting checked for its type.

    Args:
        registry: Where the name is looked up.
        text: As `parse` takes it.
        base: The class that it must be a subclass of.
        given: Arguments from elsewhere; those in the text count more.

    Raises:
        UserError: An unknown name or setting, or a value of the wrong type.
    """
    name, settings = parse(text)
    cls = registry.get(name)
    if not issubclass(cls, base):
        raise UserError(f"{name!r} is no {registry.kind}: expected a subclass of {base.__qualname__}")
    return make(cls, registry.kind, name, settings, **given)


def make(cls: type, kind: str, name: str, settings: dict[str, str], **given: Any) -> Any:
    """Return ``cls`` built from settings written as text and from values; errors as in `build`."""
    known = [item for item in inspect.signature(cls).parameters]
    hints = get_type_hints(cls.__init__)
    arguments = {key: value for key, value in given.items() if key in known}
    for key, value in settings.items():
        if key not in known:
            raise unknown(f"setting of {kind} {name}", key, known)
        arguments[key] = _value(f"{name}:{key}", value, hints.get(key, str))
    try:
        inspect.signature(cls).bind(**arguments)
    except TypeError as error:
        raise UserError(f"{kind} {name!r}: {error}; its settings: {', '.join(known) or 'none'}") from error
    return cls(**arguments)


def _value(where: str, text: str, hint: Any) -> Any:
    from argparse import ArgumentError

    from jsonargparse import ArgumentParser

    if hint is str:
        return text
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--value", type=hint)
    try:
        return parser.parse_args([f"--value={text}"]).value
    except ArgumentError as error:
        expected = hint.__name__ if isinstance(hint, type) else _short(hint)
        raise UserError(f"{where}={text}: expected {expected}") from error


def _short(hint: Any) -> str:
    """Return a type as people write it: without the modules of its parts."""
    return str(hint).replace("typing.", "").replace("collections.abc.", "")


def split(text: str) -> list[str]:
    """Split at commas outside brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
