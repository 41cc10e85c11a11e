"""Gaussian latent variables of variational models."""

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn import functional


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
