"""A mixture of Gaussians over whole futures: the output of a one-shot multi-modal forecaster.

Each component m is one future with a mean and an uncertainty at every step; its weight pi_m is the
probability that the future is of its kind. Given the component, steps are independent:

    p(y) = sum_m pi_m prod_t N(y_t; mu_mt, diag(sigma_mt^2)).
"""

import math
from typing import NamedTuple

from torch import Tensor


class FutureMixture(NamedTuple):
    """A density over displacements (..., T, 2) for each of any number of people."""

    logits: Tensor  # unnormalised log weights (..., M)
    mean: Tensor  # means (..., M, T, 2), metres per step
    scale: Tensor  # standard deviations (..., M, T, 2), metres per step

    def log_prob(self, path: Tensor, known: Tensor) -> Tensor:
        """Return log densities (...) of ``known`` steps of a path (..., T, 2) under the mixture, nats."""
        off = (path.unsqueeze(-3) - self.mean) / self.scale
        nats = -0.5 * off.square() - self.scale.log() - 0.5 * math.log(2 * math.pi)
        nats = (nats.sum(-1) * known.unsqueeze(-2)).sum(-1)
        return (self.logits.log_softmax(-1) + nats).logsumexp(-1)

    def most_likely(self) -> Tensor:
        """Return the component (...) long of the largest weight."""
        return self.logits.argmax(-1)

    def at_quantile(self, share: Tensor) -> Tensor:
        """Return the component (...) long at which the weights, added up in order, pass ``share`` (...).

        A uniform share in [0, 1) gives each component with its probability.
        """
        reached = self.logits.softmax(-1).cumsum(-1)[..., :-1]
        return (share.unsqueeze(-1) >= reached).sum(-1)

    def mean_of(self, component: Tensor) -> Tensor:
        """Return the mean (..., T, 2) of each person's ``component`` (...) long."""
        return _pick(self.mean, component)

    def scale_of(self, component: Tensor) -> Tensor:
        """Return the standard deviation (..., T, 2) likewise."""
        return _pick(self.scale, component)


def _pick(values: Tensor, component: Tensor) -> Tensor:
    index = component[..., None, None, None].expand(*component.shape, 1, *values.shape[-2:])
    return values.gather(-3, index).squeeze(-3)
