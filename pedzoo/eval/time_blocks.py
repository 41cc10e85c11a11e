"""Intervals of open-loop errors: windows overlap, so stretches of time take the place of windows."""

from collections.abc import Mapping

import torch
from torch import Tensor

from pedzoo.data.scenes import SceneSet
from pedzoo.metrics.statistics.intervals import Interval, ratio_interval

FEW = 10
"""Tables mark intervals of fewer blocks as rough."""


class BlockSums:
    """Sums of errors over blocks of time, which give 95 % intervals of their means.

    A window begins at every frame and shares nearly all of its frames with the next one: taken as
    independent, windows would give intervals several times too narrow. A block is as many windows in a row as
    a window has frames, within one recording, so that only neighbouring blocks share frames (the block
    jackknife: Künsch, "The jackknife and the bootstrap for general stationary observations", Annals of
    Statistics 17, 1989). What differs between scenes and between trainings is not in these intervals.

    Attributes:
        block: Of each window (S,) long.
    """

    def __init__(self, scenes: SceneSet) -> None:
        """Cut the windows of a split into blocks."""
        windows = [counts.windows for _, counts in scenes.counts]
        self.block = blocks(windows, scenes.obs_len + scenes.pred_len)
        self._sums: dict[str, tuple[Tensor, Tensor]] = {}

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return int(self.block[-1]) + 1

    def add(self, scenes: Tensor, errors: Mapping[str, tuple[Tensor, Tensor]]) -> None:
        """Add the sums and numbers of people (B,) of each error in some scenes (B,)."""
        block = self.block[scenes]
        for name, result in errors.items():
            if name not in self._sums:
                nothing = torch.zeros(self.count, dtype=torch.float64)
                self._sums[name] = nothing, nothing.clone()
            for total, value in zip(self._sums[name], result, strict=True):
                total.index_add_(0, block, value.double().cpu())

    def intervals(self) -> dict[str, Interval]:
        """Return the interval of every mean; see `ratio_interval` for when there is none."""
        result = {name: ratio_interval(above, below) for name, (above, below) in self._sums.items()}
        return {name: ends for name, ends in result.items() if ends}


def blocks(windows: list[int], length: int) -> Tensor:
    """Return the number of each window's block (S,): ``length`` windows in a row, of one recording.

    ``windows`` are those of each recording, which come one after the other. What is left at the end of a
    recording joins its last block, unless it is the only one.
    """
    result, before = [], 0
    for number in windows:
        whole = max(1, number // length)
        result.append(before + (torch.arange(number) // length).clamp_max(whole - 1))
        before += whole if number else 0
    return torch.cat(result)
