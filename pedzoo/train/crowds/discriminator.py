"""Judges of crowds: small networks that learn to tell clips of walking people from recorded ones."""

from collections import deque

import torch
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.metrics.realism.features import CHANNELS, LENGTH
from pedzoo.train.crowds.comparison import MANNER_DIM

_LARGEST = 6.0
"""Standard deviations: rarer values are all alike."""


def legible(clips: Tensor, manner: Tensor) -> Tensor:
    """Return clips (W, 8, 14) as a network reads them (W, N): changes and distances, small and large.

    ``manner`` (W, M) says how the people began to walk.
    """
    velocity, change, near, relative, seconds, exit = clips.split((2, 2, 4, 4, 1, 1), 2)
    distance = (near.unflatten(2, (2, 2)).square().sum(3) + 1e-6).sqrt()
    parts = (
        velocity,
        (change / 0.05).asinh(),
        (change / 0.5).asinh(),
        near.asinh(),
        (-distance).exp(),
        relative,
        seconds,
        exit.asinh(),
    )
    held = ((velocity[:, 1:] - velocity[:, :-1]) / 0.02).asinh()
    return torch.cat([*(part.flatten(1) for part in parts), held.flatten(1), manner], 1)


class CrowdDiscriminator(nn.Module):
    """A network, and the clips of the last updates."""

    mean: Tensor
    scale: Tensor

    def __init__(self, hidden_dim: int = 96, buffer: int = 40, drawn: int = 3) -> None:
        """Create the parameters.

        Args:
            hidden_dim: Width of the first hidden layer.
            buffer: Updates whose clips are stored.
            drawn: Of these are drawn for each step of the judge, beside the present one. Both crowds of an
                update are of one recording: recordings differ more than crowds.
        """
        super().__init__()
        size = legible(torch.zeros(1, LENGTH, len(CHANNELS)), torch.zeros(1, MANNER_DIM)).shape[1]
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("scale", torch.zeros(size))
        self.net = nn.Sequential(
            nn.Linear(size, hidden_dim), nn.LeakyReLU(0.2), nn.Linear(hidden_dim, 64), nn.LeakyReLU(0.2),
            nn.Linear(64, 1),
        )  # fmt: skip
        self.drawn = drawn
        self._past: deque[tuple[Tensor, Tensor]] = deque(maxlen=buffer)

    def forward(self, rows: Tensor) -> Tensor:
        """Return how real clips look (W,), logits, from what is `legible` of them (W, N)."""
        rows = (rows - self.mean) / self.scale.clamp_min(0.02)
        return self.net(rows.clamp(-_LARGEST, _LARGEST))[:, 0]

    def remember(self, made: Tensor, true: Tensor) -> None:
        """Take what is `legible` of an update's clips (W, N): of people who walk, and of recorded ones."""
        if not self._past:
            self.mean, self.scale = true.mean(0), true.std(0)
        self._past.append((made.detach(), true.detach()))

    def learning(self, random: torch.Generator) -> Tensor:
        """Return the cross entropy of the judge on the last clips, and on those of updates that are drawn."""
        picked = torch.randint(len(self._past), (self.drawn,), generator=random).tolist()
        pairs = [self._past[-1], *(self._past[number] for number in picked)]
        costs = [
            functional.softplus(self(made)).mean() + functional.softplus(-self(true)).mean()
            for made, true in pairs
        ]
        return torch.stack(costs).mean() / 2

    def passing(self, made: Tensor) -> Tensor:
        """Return the cost of clips (W, N) that do not pass as real; without gradients for the judge."""
        self.requires_grad_(False)
        cost = functional.softplus(-self(made)).mean()
        self.requires_grad_(True)
        return cost
