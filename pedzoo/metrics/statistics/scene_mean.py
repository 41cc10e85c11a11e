"""Means over people: exact sums, over processes too, and those of each scene."""

import torch
from torch import Tensor
from torchmetrics import Metric


class SceneMean(Metric):
    """A sum over people with their count; state in float64, summed over processes.

    Attributes:
        latest: Sums and counts (B,) of each scene of the last update, for intervals over scenes.
    """

    higher_is_better: bool | None = False
    full_state_update = False
    total: Tensor
    count: Tensor
    latest: tuple[Tensor, Tensor]

    def __init__(self) -> None:
        """Begin without people."""
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    def add(self, value: Tensor, count: Tensor) -> None:
        """Add a batch: each person's value (B, A), zero where not counted, and each scene's count (B,)."""
        self.latest = value.sum(1, dtype=torch.float64), count
        self.total += value.sum(dtype=torch.float64)
        self.count += count.sum()

    def compute(self) -> Tensor:
        """Return the mean; NaN before the first batch."""
        return self.total / self.count
