"""Which endings names of files have that are written. Needs nothing heavy."""

from collections.abc import Iterable
from pathlib import Path

from pedzoo.core.errors import UserError

PLOTS = (".png", ".pdf", ".svg")

CODECS = {".webm": "VP90", ".mp4": "vp09"}
"""Endings of videos. VP9 is the codec that OpenCV's wheels can write and every browser can show."""

PAGES = (".html", ".htm")
"""Those that browsers open."""

REPORTS = (".json",)


def check_ending(what: str, path: str | Path, endings: Iterable[str]) -> None:
    """Refuse a name with another ending, in capitals or not.

    Args:
        what: The option or the kind of file, and the name: how the message begins.
        path: The name.
        endings: Those that it may have.

    Raises:
        UserError: It has another one, or none.
    """
    if Path(path).suffix.lower() not in (allowed := tuple(endings)):
        raise UserError(f"{what}: expected a file that ends in {' or '.join(allowed)}")
