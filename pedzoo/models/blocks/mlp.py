"""Social GAN's multi-layer perceptron and its initialisation."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn import functional


def mlp(*dims: int) -> nn.Sequential:
    """Return Linear + ReLU for each pair of neighbouring ``dims``.

    The ReLU follows the last linear layer too, as in the published code: contexts, pooled vectors and even
    the discriminator's scores are never negative.
    """
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(dims):
        layers += [nn.Linear(fan_in, fan_out), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


def two_layers(inputs: int, width: int) -> nn.Sequential:
    """Return two layers with GELU."""
    return nn.Sequential(nn.Linear(inputs, width), nn.GELU(), nn.Linear(width, width), nn.GELU())


def init_with_zeros(*layers: nn.Linear) -> None:
    """Let layers return 0 before training: what they would change stays as it is."""
    for layer in layers:
        nn.init.zeros_(layer.weight)
        nn.init.zeros_(layer.bias)


def init_like_sgan(module: nn.Module) -> None:
    """Draw the weights of every ``nn.Linear`` in ``module`` from Kaiming's normal distribution.

    Biases and LSTMs keep torch's default, as in the published code (K. He et al., ICCV 2015, for the
    distribution).
    """
    for child in module.modules():
        if isinstance(child, nn.Linear):
            nn.init.kaiming_normal_(child.weight)


class ContextNoise(nn.Module):
    """Adds to a context the output of a small network for it and the noise together.

    A decoder that starts from [context; z] adds the two in every gate, so z can shift what people do and
    hardly choose between two ways of doing it. Untrained, it adds nothing.
    """

    def __init__(self, context_dim: int, noise_dim: int, hidden_dim: int) -> None:
        """Create the parameters."""
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(context_dim + noise_dim, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, context_dim)
        )

    def reset(self) -> None:
        """Forget: nothing is added."""
        last = self.net[-1]
        assert isinstance(last, nn.Linear)
        init_with_zeros(last)

    def forward(self, context: Tensor, z: Tensor) -> Tensor:
        """Return the context (..., C) of people with the noise ``z`` (..., noise_dim)."""
        return context + self.net(torch.cat((context, z), -1))


class LatentHead(nn.Module):
    """A small network that says how a latent is distributed: a diagonal Gaussian per person."""

    def __init__(self, input_dim: int, hidden_dim: int, latent_dim: int) -> None:
        """Create the parameters."""
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(input_dim, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, 2 * latent_dim)
        )

    def forward(self, *inputs: Tensor) -> Normal:
        """Return the distribution of the latents (P, latent_dim), given ``inputs`` (P, ...) side by side."""
        mean, scale = self.net(torch.cat(inputs, -1)).chunk(2, -1)
        # 1 where the network says 0, and never so small that a divergence overflows
        return Normal(mean, functional.softplus(scale + 0.5413) + 1e-3, validate_args=False)
