"""Old spellings that still work: ``world`` is ``physics`` now, and its ``grid`` is ``compiled``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import cache, wraps
from typing import Any, TypeVar, cast

from pedzoo.core.errors import UserError

Function = TypeVar("Function", bound=Callable[..., Any])

OLD_BACKENDS = {"grid": "compiled"}


@cache
def say(old: str, new: str) -> None:
    """Tell the new spelling on stderr, once in a process."""
    print(f"pedzoo: {old} is now {new}", file=sys.stderr)


def backend(name: str) -> str:
    """Return a physics backend's name as it is now."""
    new = OLD_BACKENDS.get(name, name)
    if new != name:
        say(f"physics {name!r}", repr(new))
    return new


def old_world(world: str, physics: str | None = None) -> str:
    """Return the backend that the setting ``world`` stands for.

    Raises:
        UserError: ``physics`` is given, too.
    """
    if physics is not None:
        raise UserError(f"world {world!r} is the old spelling of physics {physics!r}: leave out world")
    new = OLD_BACKENDS.get(world, world)
    say(f"world={world!r}", f"physics={new!r}")
    return new


def takes_world(function: Function) -> Function:
    """Let ``function`` take its keyword argument ``physics`` by the old name ``world``, too."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if (world := kwargs.pop("world", None)) is not None:
            kwargs["physics"] = old_world(world, kwargs.get("physics"))
        return function(*args, **kwargs)

    return cast("Function", call)


def new_words(argv: list[str]) -> list[str]:
    """Return a command line with ``--world`` written as ``--physics``."""
    result = list(argv)
    for i, word in enumerate(argv):
        flag, joined, value = word.partition("=")
        if flag != "--world":
            continue
        result[i] = "--physics" + joined + OLD_BACKENDS.get(value, value)
        old = value
        if not joined and i + 1 < len(argv):
            old = argv[i + 1]
            result[i + 1] = OLD_BACKENDS.get(old, old)
        say(f"--world {old}", f"--physics {OLD_BACKENDS.get(old, old)}")
    return result


def new_keys(protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return a protocol, as a card has it, with ``world`` written as ``physics``."""
    result = dict(protocol)
    if "world" in result:
        world = result.pop("world")
        result["physics"] = OLD_BACKENDS.get(world, world)
    return result
