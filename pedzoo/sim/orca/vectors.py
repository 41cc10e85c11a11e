"""Arithmetic of vectors whose two coordinates come first, (2, ...)."""

from __future__ import annotations

import torch
from torch import Tensor


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the scalar products (...)."""
    return a[0] * b[0] + a[1] * b[1]


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross products (...): positive where ``b`` is to the left of ``a``."""
    return a[0] * b[1] - a[1] * b[0]


def left(a: Tensor) -> Tensor:
    """Return the vectors (2, ...) a quarter turn to the left."""
    return torch.stack((-a[1], a[0]))


def unit(a: Tensor) -> Tensor:
    """Return the directions (2, ...); that of a zero vector is zero."""
    return a * (1 / dot(a, a).sqrt().clamp_min(torch.finfo(a.dtype).tiny))


def pick(condition: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return ``a`` where ``condition``, else ``b``; both finite. Much faster on a CPU than `torch.where`."""
    share = condition.to(a.dtype)
    return a * share + b * (1 - share)
