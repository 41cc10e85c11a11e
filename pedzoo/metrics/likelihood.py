"""How likely the truth was under a forecaster's own density."""

from torch import Tensor

from pedzoo.metrics.sums.scene_mean import SceneMean


class NegativeLogLikelihood(SceneMean):
    """Mean of minus the log density of what people did, per person and step: nats, of metres.

    All steps of a person are judged together, and the sum is divided by their number: a model gains by
    knowing that slow people stay slow.
    """

    def update(self, log_likelihood: Tensor, known: Tensor) -> None:
        """Add a batch: log densities (B, A), and which steps (B, A, T) bool they are of."""
        self.add(-log_likelihood.where(known.any(-1), 0), known.sum((1, 2)))
