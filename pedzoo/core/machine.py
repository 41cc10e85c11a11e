"""The machine: its devices by name, its usual physics, and the versions of installed packages."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from pedzoo import __version__
from pedzoo.core.errors import UserError, installed
from pedzoo.core.registry import ROOT

if TYPE_CHECKING:
    import torch
    from torch import Tensor

PACKAGES = ("torch", "lightning", "torchrl", "tensordict", "torchmetrics", "numpy", "scipy", "pybullet")
"""Versions on which numbers depend, beside pedzoo's."""


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, and the commit where pedzoo runs from a checkout."""
    result = {"pedzoo": __version__, "python": sys.version.split()[0]}
    for package in PACKAGES:
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = "absent"
    if (ROOT / ".git").exists():  # else from a wheel: a surrounding repository is another project's
        command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
        with suppress(OSError, subprocess.SubprocessError):
            done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
            result["commit"] = done.stdout.strip()
    return result


def usable(device: torch.device | str) -> torch.device:
    """Return the device. Raises UserError: there is no such device here."""
    import torch

    try:
        device = torch.device(device)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:  # torch without CUDA asserts
        reason = str(error).partition("\n")[0]
        raise UserError(
            f"device {str(device)!r} cannot be used here ({reason}): expected cpu, cuda, cuda:1, ..."
        ) from error
    return device


def usual_physics(fast: bool = False) -> str:
    """Return the physics where none is named: what the variable ``PEDZOO_PHYSICS`` says.

    Without it that is ``bullet``, or ``compiled`` where there is no pybullet, or where walks are to be
    ``fast``, as in environments and trainings.
    """
    usual = "bullet" if installed("pybullet") and not fast else "compiled"
    return os.environ.get("PEDZOO_PHYSICS") or usual


def compiles(*tensors: Tensor) -> bool:
    """Return whether compiled loops may take these: float32 on the CPU."""
    import torch

    return all(value.device.type == "cpu" and value.dtype == torch.float32 for value in tensors)
