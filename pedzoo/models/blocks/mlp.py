"""Social GAN's multi-layer perceptron and its initialisation."""

from __future__ import annotations

from itertools import pairwise

from torch import nn


def mlp(*dims: int) -> nn.Sequential:
    """Return Linear + ReLU for each pair of neighbouring ``dims``.

    The ReLU follows the last linear layer too, as in the published code: contexts, pooled vectors and even
    the discriminator's scores are never negative.
    """
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(dims):
        layers += [nn.Linear(fan_in, fan_out), nn.ReLU()]
    return nn.Sequential(*layers)


def init_like_sgan(module: nn.Module) -> None:
    """Draw the weights of every ``nn.Linear`` in ``module`` from Kaiming's normal distribution.

    Biases and LSTMs keep torch's default, as in the published code (K. He et al., ICCV 2015, for the
    distribution).
    """
    for child in module.modules():
        if isinstance(child, nn.Linear):
            nn.init.kaiming_normal_(child.weight)
