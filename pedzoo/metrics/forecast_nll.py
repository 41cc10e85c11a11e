"""How likely the truth was under a forecaster's own density, and whether its samples spread as far."""

import torch
from torch import Tensor
from torchmetrics import Metric

from pedzoo.core.geometry import unrotate
from pedzoo.metrics.statistics.scene_mean import SceneMean

BINS = 20
"""Classes of the probability integral transform."""


class NegativeLogLikelihood(SceneMean):
    """Mean of minus the log density of what people did, per person and step: nats, of metres.

    All steps of a person are judged together, and the sum is divided by their number: a model gains by
    knowing that slow people stay slow.
    """

    def update(self, log_likelihood: Tensor, known: Tensor) -> None:
        """Add a batch: log densities (B, A), and which steps (B, A, T) bool they are of."""
        self.add(-log_likelihood.where(known.any(-1), 0), known.sum((1, 2)))


class CalibrationError(Metric):
    """How far the truth's place among the samples is from a uniform one: 0 is calibrated, .25 a single guess.

    The share of samples behind the true last position, ahead and to the side of where a person walked, is
    uniform on [0, 1] if the truth is like a sample (probability integral transform; Gneiting, Balabdaoui and
    Raftery, JRSS B 2007). The result is the mean distance of its distribution function from the uniform one,
    over both directions. Samples at the same place as the truth count half.
    """

    full_state_update = False
    higher_is_better = False
    counts: Tensor

    def __init__(self) -> None:
        """Begin without people."""
        super().__init__()
        self.add_state("counts", torch.zeros(2, BINS + 1, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, ends: Tensor, history: Tensor, future: Tensor, valid: Tensor) -> None:
        """Add a batch.

        Args:
            ends: Last positions of samples (B, K, A, 2).
            history: Observed positions (B, A, 8, 2).
            future: True ones (B, A, T, 2).
            valid: Which of these are known (B, A, T) bool.
        """
        there = valid[..., -1]
        moved = (history[:, :, -1] - history[:, :, 0])[there]
        ahead = torch.nn.functional.normalize(moved + moved.new_tensor([1e-6, 0.0]), dim=-1)
        off = ends.transpose(1, 2)[there] - future[:, :, -1][there].unsqueeze(1)  # (P, K, 2)
        off = unrotate(off, ahead.unsqueeze(1))
        share = ((off < 0).double() + 0.5 * (off == 0)).mean(1)
        # a share on the border of two classes counts half in each
        for offset in (1e-9, -1e-9):
            place = ((share + offset) * BINS).floor().long().clamp(0, BINS - 1)
            for axis in range(2):
                self.counts[axis, :BINS] += 0.5 * torch.bincount(place[:, axis], minlength=BINS)
        self.counts[:, BINS] += len(share)

    def compute(self) -> Tensor:
        """Return the mean distance of the distribution functions, 0 to 0.5."""
        reached = self.counts[:, :BINS].cumsum(1) / self.counts[:, BINS:].clamp_min(1)
        uniform = torch.arange(1, BINS + 1, device=reached.device, dtype=reached.dtype) / BINS
        return (reached - uniform)[:, :-1].abs().mean()
