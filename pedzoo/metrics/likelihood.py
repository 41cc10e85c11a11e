"""How likely the truth was under a forecaster's own density."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric


class NegativeLogLikelihood(Metric):
    """Mean of minus the log density of what people did, per person and step: nats, of metres.

    All steps of a person are judged together and the sum is divided by their number, so a model gains by
    knowing that who is slow stays slow. State in float64, summed over processes.

    Attributes:
        latest: Nats and numbers of steps (B,) of each scene of the last update, for intervals over scenes.
    """

    higher_is_better = False
    full_state_update = False
    total: Tensor
    count: Tensor
    latest: tuple[Tensor, Tensor]

    def __init__(self) -> None:
        """Nothing to set."""
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, log_likelihood: Tensor, known: Tensor) -> None:
        """Add a batch: log densities (B, A), and which steps (B, A, T) bool they are of."""
        nats = -log_likelihood.where(known.any(-1), 0)
        self.latest = nats.sum(1, dtype=torch.float64), known.sum((1, 2))
        self.total += nats.sum(dtype=torch.float64)
        self.count += known.sum()

    def compute(self) -> Tensor:
        """Return the mean, nats per step; NaN before anybody."""
        return self.total / self.count
