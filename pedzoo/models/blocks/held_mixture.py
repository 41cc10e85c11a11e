"""A distribution of the next change of velocity: none at all, or a draw of a mixture of Gaussians."""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional

HELD = 0.0045
"""m/s: a velocity that changes by less is held. Recordings are rounded."""


class Change(NamedTuple):
    """A distribution of the next change of velocity (..., 2), m/s: none at all, or a mixture of M Gaussians.

    The density of a change is that of the mixture, with respect to area, and of no change a probability.
    """

    hold: Tensor  # log odds of no change (...)
    logits: Tensor  # log weights of the Gaussians (..., M)
    mean: Tensor  # their means (..., M, 2), m/s
    scale: Tensor  # their standard deviations (..., M, 2), m/s
    tilt: Tensor  # their correlations (..., M)

    def log_prob(self, change: Tensor, held: Tensor) -> Tensor:
        """Return the log likelihood (...) of changes (..., 2), where ``held`` (...) bool of no change."""
        z = (change.unsqueeze(-2) - self.mean) / self.scale
        rest = 1 - self.tilt.square()
        square = (z.square().sum(-1) - 2 * self.tilt * z[..., 0] * z[..., 1]) / rest
        log = -0.5 * square - self.scale.log().sum(-1) - 0.5 * rest.log() - math.log(2 * math.pi)
        mixture = (self.logits.log_softmax(-1) + log).logsumexp(-1)
        none, some = functional.logsigmoid(self.hold), functional.logsigmoid(-self.hold)
        return torch.where(held, none, some + mixture)

    def tempered(self, temperature: float) -> Self:
        """Return the distribution with every Gaussian and the choice among them sharper, below 1."""
        logits, scale = self.logits / temperature, self.scale * math.sqrt(temperature)
        return self if temperature == 1 else self._replace(logits=logits, scale=scale)

    def at(self, noise: Tensor) -> Tensor:
        """Return the changes (..., 2) that normal noise (..., 4) chooses: hold, component, two more."""
        share = 0.5 * (1 + torch.erf(noise[..., :2] / math.sqrt(2)))
        reached = self.logits.softmax(-1).cumsum(-1)[..., :-1]
        chosen = (share[..., 1:] >= reached).sum(-1, keepdim=True)
        pair = chosen.unsqueeze(-1).expand(*chosen.shape, 2)
        mean, scale = (value.gather(-2, pair).squeeze(-2) for value in (self.mean, self.scale))
        tilt = self.tilt.gather(-1, chosen)[..., 0]
        first, second = noise[..., 2], noise[..., 3]
        second = tilt * first + (1 - tilt.square()).sqrt() * second
        drawn = mean + scale * torch.stack((first, second), -1)
        return torch.where((share[..., 0] < self.hold.sigmoid()).unsqueeze(-1), 0.0, drawn)

    @property
    def average(self) -> Tensor:
        """The mean change (..., 2), m/s."""
        mean = (self.logits.softmax(-1).unsqueeze(-1) * self.mean).sum(-2)
        return (-self.hold).sigmoid().unsqueeze(-1) * mean
