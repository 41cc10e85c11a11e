"""Baseline: people repeat their last displacement."""

from tensordict import TensorDict
from torch import Tensor

from pedzoo.models.base import Forecaster, Random, for_all_samples
from pedzoo.models.blocks.people import linear_extrapolation


class ConstantVelocity(Forecaster):
    """p8 + k v: the baseline without a goal that one sample of any model has to beat."""

    stochastic = False

    def __init__(self) -> None:
        """Nothing to set, nothing to train."""
        super().__init__()
        self.config = {}

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return the same future (B, K, A, T, 2) for every sample."""
        history = batch["agents", "history"]
        path = linear_extrapolation.constant_velocity(history[..., -1, :] - history[..., -2, :], steps)
        return for_all_samples(path, batch, samples)
