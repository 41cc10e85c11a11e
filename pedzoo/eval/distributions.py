"""How often a simulated crowd and the real one have which speed, distance, ...: histograms for pictures."""

from typing import Any

import torch

from pedzoo.metrics.realism.crowds import Crowd
from pedzoo.metrics.realism.features import FEATURES

BINS = 24

OUTSIDE = 0.005
"""Share of the real samples beyond either end, which count in the first and the last bin."""


def distributions(mine: Crowd, real: Crowd) -> dict[str, dict[str, Any]]:
    """Return the histograms of every feature, ready for JSON.

    Each has its ``unit``, the ``low`` and ``high`` end, and the shares of samples in `BINS` equal bins:
    ``share`` of this crowd, ``real_share`` of the recorded one. Features without real samples are left out.
    """
    result = {}
    for name, unit in FEATURES.items():
        theirs = real.samples[name].value.double()
        if not len(theirs):
            continue
        ends = torch.tensor([OUTSIDE, 1 - OUTSIDE], dtype=torch.float64)
        low, high = (float(end) for end in torch.quantile(_some(theirs), ends))
        high = high if high > low else low + 1.0
        result[name] = {"unit": unit, "low": round(low, 4), "high": round(high, 4)}
        for key, values in (("share", mine.samples[name].value.double()), ("real_share", theirs)):
            counts = torch.histc(values.clamp(low, high), BINS, low, high)
            result[name][key] = [round(float(count), 5) for count in counts / max(len(values), 1)]
    return result


def _some(values: torch.Tensor, most: int = 1_000_000) -> torch.Tensor:
    """Return at most so many of the values: `torch.quantile` takes no more than 16 million."""
    return values[:: -(-len(values) // most)]
