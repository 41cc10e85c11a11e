"""Arithmetic of vectors whose two coordinates come first (2, ...), and of shares: conditions as 0 and 1.

On a CPU floating point is computed in vectors of 8, truth values (also `torch.where`) one by one: ORCA is
several times faster with shares.
"""

from __future__ import annotations

import torch
from torch import Tensor


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the scalar products (...)."""
    return (a[0] * b[0]).add_(a[1] * b[1])


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross products (...): positive where ``b`` is to the left of ``a``."""
    return (a[0] * b[1]).sub_(a[1] * b[0])


def left(a: Tensor) -> Tensor:
    """Return the vectors (2, ...) a quarter turn to the left."""
    return torch.stack((-a[1], a[0]))


def right(a: Tensor) -> Tensor:
    """Return the vectors (2, ...) a quarter turn to the right."""
    return torch.stack((a[1], -a[0]))


def above(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` > ``b``, else 0. No gradient flows."""
    return torch.gt(a, b, out=a.new_empty(0))


def at_least(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` >= ``b``, else 0. No gradient flows."""
    return torch.ge(a, b, out=a.new_empty(0))


def below(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` < ``b``, else 0. No gradient flows."""
    return torch.lt(a, b, out=a.new_empty(0))


def at_most(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` <= ``b``, else 0. No gradient flows."""
    return torch.le(a, b, out=a.new_empty(0))


def pick(share: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return ``a`` where the share is 1, ``b`` where it is 0; both finite."""
    return torch.lerp(b, a, share)
