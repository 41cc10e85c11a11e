"""Which versions a result was made with."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pedzoo import __version__

PACKAGES = ("torch", "lightning", "torchrl", "tensordict", "torchmetrics", "numpy", "scipy", "pybullet")
"""What numbers depend on beside pedzoo."""


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, and the commit where pedzoo runs from a checkout."""
    result = {"pedzoo": __version__, "python": sys.version.split()[0]}
    for package in PACKAGES:
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = "absent"
    if commit := _commit():
        result["commit"] = commit
    return result


def _commit() -> str:
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""  # installed from a wheel: a surrounding repository is another project's
    try:
        command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
