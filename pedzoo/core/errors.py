"""Errors that a person can act on: the given value, the expected one, and the fix."""

from collections.abc import Iterable
from difflib import get_close_matches


class UserError(ValueError):
    """The caller's mistake; the command line prints it as one line and exits with code 2."""


def unknown(kind: str, given: str, known: Iterable[str]) -> UserError:
    """Return the error for a name that does not exist, with the nearest spelling and all that do."""
    names = sorted(known)
    near = get_close_matches(given[:200], names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UserError(f"unknown {kind:.200} {given!r:.200}: {hint}known: {', '.join(names) or 'none'}")
