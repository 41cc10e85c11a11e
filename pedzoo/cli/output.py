"""What several commands print or write: JSON files and the versions that belong in them."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pedzoo import __version__
from pedzoo.errors import UserError


def write_json(file: str | Path, content: dict[str, Any]) -> None:
    """Write ``content`` to ``file`` (``-`` for the terminal).

    Raises:
        UserError: The file's folder does not exist or cannot be written.
    """
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if str(file) == "-":
        sys.stdout.write(text)
        return
    try:
        Path(file).write_text(text)
    except OSError as error:
        raise UserError(f"cannot write {str(file)!r}: {error.strerror}") from error


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, and the commit where pedzoo runs from a checkout."""
    found = {"pedzoo": __version__, "python": sys.version.split()[0]}
    for package in ("torch", "lightning", "torchrl", "tensordict", "torchmetrics", "numpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    if commit := _commit():
        found["commit"] = commit
    return found


def _commit() -> str:
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""  # installed from a wheel: a surrounding repository would be somebody else's
    try:
        command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
