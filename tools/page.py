"""Numbers as Markdown, for the pages that tools make."""

from __future__ import annotations

import math

from torch import Tensor


def share(values: Tensor) -> str:
    """Return how many are true."""
    return percent(float(values.double().mean()))


def percent(value: float) -> str:
    """Return a share; a dash for NaN."""
    return "-" if math.isnan(value) else f"{100 * value:.0f} %"


def median(values: Tensor) -> str:
    """Return a median; a dash for none."""
    return f"{float(values.median()):.2f}" if len(values) else "-"
