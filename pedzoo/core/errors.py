"""Errors that a person can act on: the given value, the expected one, the fix; packages that are missing."""

import errno
import math
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import cache, wraps
from importlib.util import find_spec
from operator import index
from typing import Any, TypeVar, cast

EXTRAS = {
    "train": ("lightning",),
    "score": ("sklearn",),
    "bullet": ("pybullet",),
    "video": ("matplotlib",),
    "wandb": ("wandb",),
    "gym": ("gymnasium", "pettingzoo"),
    "onnx": ("onnx", "onnxscript", "onnxruntime"),
    "ray": ("ray",),
}
"""Modules of the extras of ``pyproject.toml``; imports of these stand where they are needed."""

Function = TypeVar("Function", bound=Callable[..., Any])

NO_ROOM = (errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a full or read-only disk, and of a file that is too large."""

LONGEST = 4000
"""Maximum length of a message, in characters."""


class UserError(ValueError):
    """The caller's mistake; the command line prints it as one line and exits with code 2."""

    def __str__(self) -> str:
        """Return the message; of a longer one than `LONGEST` begin and end."""
        text, half = super().__str__(), LONGEST // 2
        return text if len(text) <= LONGEST else f"{text[:half]} ... {text[-half:]}"


def unknown(kind: str, given: str, known: Iterable[str]) -> UserError:
    """Return the error for a name that does not exist, with the nearest spelling and all that do."""
    names = sorted(known)
    near = get_close_matches(given[:200], names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UserError(f"unknown {kind:.200} {given!r:.200}: {hint}known: {', '.join(names) or 'none'}")


def known_arguments(*further: Callable[..., Any]) -> Callable[[Function], Function]:
    """Let a function refuse keyword arguments that neither it has nor, optional, the ``further`` ones."""
    from inspect import Parameter, signature

    def checked(function: Function) -> Function:
        own, *others = (signature(part).parameters.values() for part in (function, *further))
        names = {one.name for one in own if one.kind is not Parameter.VAR_KEYWORD}
        names |= {one.name for part in others for one in part if one.default is not Parameter.empty}

        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            for name in kwargs:
                if name not in names:
                    raise unknown(f"argument of {getattr(function, '__name__', function)}", name, names)
            return function(*args, **kwargs)

        return cast("Function", call)

    return checked


def as_integer(what: str, number: object) -> int:
    """Return a whole number as Python's own: one of NumPy or torch overflows where this does not.

    Raises UserError: it is none; the message begins with ``what``.
    """
    try:
        return index(cast("Any", number))
    except TypeError as error:
        raise UserError(f"{what} {number!r:.60}: expected a whole number") from error


def at_least_one(what: str, number: object) -> int:
    """Return a whole number above 0, and raise for others, as `as_integer` does."""
    if (result := as_integer(what, number)) < 1:
        raise UserError(f"{what} {result}: expected at least 1")
    return result


def at_least_zero(place: str, **numbers: float) -> None:
    """Raise UserError for numbers that are negative, infinite or NaN; ``place`` stands before a name."""
    for name, number in numbers.items():
        if not 0 <= number < math.inf:
            raise UserError(f"{place}{name} {number}: expected at least 0")


def check_range(
    settings: object,
    kind: str,
    names: str,
    expected: str,
    least: float = 0.0,
    most: float = math.inf,
    above: bool = False,
) -> None:
    """Raise UserError for settings that are out of their range, or no finite numbers; None fits.

    Args:
        settings: The object that has them.
        kind: What stands before the names in the message.
        names: Those of its attributes, apart by spaces.
        expected: What they are to be, in words.
        least: The least value.
        most: The greatest value.
        above: Whether the least value itself is too little.
    """
    for name in names.split():
        value = getattr(settings, name)
        fits = value is None or (math.isfinite(value) and least <= value <= most)
        if not fits or (above and value == least):
            raise UserError(f"{kind}: {name} {value}: expected {expected}")


@cache
def installed(module: str) -> bool:
    """Return whether a module can be imported, without an import."""
    return find_spec(module) is not None


def install_command(extra: str) -> str:
    """Return the command that adds an extra of `EXTRAS` to this installation, from where that came from."""
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        origin = json.loads(distribution("pedzoo").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        origin = {}
    url = str(origin.get("url", ""))
    if not url:
        return f"pip install 'pedzoo[{extra}]'"
    if "dir_info" in origin:
        editable = "-e " if origin["dir_info"].get("editable") else ""
        return f"pip install {editable}'{url2pathname(urlsplit(url).path)}[{extra}]'"
    version_control = origin.get("vcs_info", {}).get("vcs")
    return f"pip install 'pedzoo[{extra}] @ {f'{version_control}+' if version_control else ''}{url}'"


def need(extra: str, what: str) -> None:
    """Raise UserError where a package of an extra is absent: ``what`` needs it, and how it is installed."""
    if absent := [module for module in EXTRAS[extra] if find_spec(module) is None]:
        raise UserError(f"{what} needs {' and '.join(absent)}, not installed here: {install_command(extra)}")


def lacks_memory(error: Exception) -> UserError | None:
    """Return the message for an error that says that memory lacks; None for any other one."""
    said = " ".join(str(error).split())
    no_memory = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
    # torch's own ones have no class, or one of the GPU's
    if no_memory or "allocate memory" in said or type(error).__name__ == "OutOfMemoryError":
        return UserError(
            f"not enough memory ({said or 'nothing is left':.300}): take fewer at once, or less data"
        )
    return None


def missing_extra(error: ModuleNotFoundError) -> UserError | None:
    """Return the message for a failed import of a package of an extra; None for any other import."""
    module = (error.name or "").partition(".")[0]
    for extra, modules in EXTRAS.items():
        if module in modules:
            return UserError(f"this needs {module}, not installed here: {install_command(extra)}")
    return None
