"""A mixture of Gaussians over whole futures: the output of a one-shot multi-modal forecaster.

Each component m is one future with a mean and an uncertainty at every step; its weight pi_m is the
probability that the future is of its kind. Given the component, steps are independent:

    p(y) = sum_m pi_m prod_t N(y_t; mu_mt, diag(sigma_mt^2)).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional


class FutureMixture(NamedTuple):
    """A density over displacements (..., T, 2) for each of any number of people.

    Attributes:
        logits: Unnormalised log weights (..., M).
        mean: Means (..., M, T, 2), metres per step.
        scale: Standard deviations (..., M, T, 2), metres per step.
    """

    logits: Tensor
    mean: Tensor
    scale: Tensor

    def component_log_prob(self, path: Tensor, known: Tensor) -> Tensor:
        """Return log densities (..., M) of ``known`` steps of a path (..., T, 2), nats."""
        off = (path.unsqueeze(-3) - self.mean) / self.scale
        nats = -0.5 * off.square() - self.scale.log() - 0.5 * math.log(2 * math.pi)
        return (nats.sum(-1) * known.unsqueeze(-2)).sum(-1)

    def log_prob(self, path: Tensor, known: Tensor) -> Tensor:
        """Return log densities (...) of a path under the mixture, nats; arguments as above."""
        weighted = self.logits.log_softmax(-1) + self.component_log_prob(path, known)
        return weighted.logsumexp(-1)

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


class MixtureDecoder(nn.Module):
    """An LSTM that writes all components of a `FutureMixture`, for any number of steps.

    Nothing sampled is fed back: one pass gives every component at every step. The LSTM starts from the
    context and reads the latent at each step.
    """

    def __init__(
        self, context_dim: int, latent_dim: int, hidden_dim: int, components: int, min_scale: float
    ) -> None:
        """Create the parameters.

        Args:
            context_dim: Width of a person's features.
            latent_dim: Width of the latent.
            hidden_dim: Width of the LSTM's state.
            components: Number of components M.
            min_scale: Smallest standard deviation, metres per step.
        """
        super().__init__()
        self.components, self.min_scale = components, min_scale
        self.start = nn.Linear(context_dim + latent_dim, hidden_dim)
        self.lstm = nn.LSTM(latent_dim, hidden_dim)
        self.output = nn.Linear(hidden_dim, 4 * components)
        self.logits = nn.Linear(hidden_dim, components)

    def forward(self, context: Tensor, latent: Tensor, base: Tensor) -> FutureMixture:
        """Return each person's mixture; its means are added to displacements ``base`` (P, T, 2)."""
        people, steps = base.shape[:2]
        start = self.start(torch.cat((context, latent), -1)).tanh()
        state = start.unsqueeze(0), torch.zeros_like(start).unsqueeze(0)
        hidden, _ = self.lstm(latent.expand(steps, *latent.shape), state)
        written = self.output(hidden).view(steps, people, self.components, 4).permute(1, 2, 0, 3)
        mean, scale = written.split(2, -1)
        # as large as walking people's changes of velocity at first, not as their velocities
        scale = 0.1 * functional.softplus(scale) + self.min_scale
        return FutureMixture(self.logits(start), base.unsqueeze(1) + 0.1 * mean, scale)


def _pick(values: Tensor, component: Tensor) -> Tensor:
    index = component[..., None, None, None].expand(*component.shape, 1, *values.shape[-2:])
    return values.gather(-3, index).squeeze(-3)
