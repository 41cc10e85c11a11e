"""Personal traits: the noise changes how a situation is read, and not only the answer."""

import torch
from torch import Tensor, nn

from pedzoo.models.blocks.mlp import init_with_zeros


class Trait(nn.Module):
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
