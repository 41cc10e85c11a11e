"""Devices by name."""

from __future__ import annotations

import torch

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
