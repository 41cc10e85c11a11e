"""Devices by name, and what compiled loops take."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.errors import UserError


def usable(device: torch.device | str) -> torch.device:
    """Return the device.

    Raises:
        UserError: There is no such device here.
    """
    try:
        device = torch.device(device)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:  # torch without CUDA asserts
        reason = str(error).partition("\n")[0]
        raise UserError(
            f"device {str(device)!r} cannot be used here ({reason}): expected cpu, cuda, cuda:1, ..."
        ) from error
    return device


def compiles(*tensors: Tensor) -> bool:
    """Return whether compiled loops may take these: float32 on the CPU."""
    return all(value.device.type == "cpu" and value.dtype == torch.float32 for value in tensors)
