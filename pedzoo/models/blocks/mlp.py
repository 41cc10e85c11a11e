"""Multi-layer perceptrons and how their weights begin."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Literal

from torch import nn

_RELU = partial(nn.ReLU, inplace=True)

Activation = Literal["relu", "leaky_relu"]

ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "relu": _RELU, "leaky_relu": partial(nn.LeakyReLU, 0.1, inplace=True)
}  # fmt: skip
"""By their names in settings: the published one, which can die, and one that has a slope everywhere."""


def mlp(*dims: int, layer: Callable[[], nn.Module] = _RELU) -> nn.Sequential:
    """Return Linear and an activation ``layer`` for each pair of neighbouring ``dims``.

    One follows the last linear layer, too, as in Social GAN's code: scores are never negative.
    """
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(dims):
        layers += [nn.Linear(fan_in, fan_out), layer()]
    return nn.Sequential(*layers)


def init_with_zeros(*layers: nn.Linear) -> None:
    """Let layers return 0 before training: what they would change stays as it is."""
    for layer in layers:
        nn.init.zeros_(layer.weight)
        nn.init.zeros_(layer.bias)


def init_like_sgan(module: nn.Module) -> None:
    """Draw weights of every ``nn.Linear`` as the published code: Kaiming's normal (He et al., ICCV 2015)."""
    for child in module.modules():
        if isinstance(child, nn.Linear):
            nn.init.kaiming_normal_(child.weight)
