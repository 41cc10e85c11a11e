"""Futures of a model with anchors, compared as sets: modes that are as likely as each other may swap."""

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.models.blocks.anchored import AnchorForecaster


def futures(model: AnchorForecaster, batch: TensorDict, steps: int) -> tuple[Tensor, Tensor]:
    """Return the 20 modes (1, 20, A, T, 2) and the best guess (1, 1, A, T, 2) as positions, metres."""
    both = model.candidates(batch, 20, steps), model.mode(batch, steps)
    modes, guess = (path.detach().cumsum(3) for path in both)
    return modes, guess


def farthest_futures(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> float:
    """Return the largest distance between equal futures, metres."""
    modes, others = (both[0][0].movedim(0, 1) for both in (first, second))  # (A, 20, T, 2)
    apart = (modes.unsqueeze(2) - others.unsqueeze(1)).norm(dim=-1).amax(-1)
    guess = (first[1] - second[1]).norm(dim=-1).max()
    return float(torch.stack((apart.amin(2).max(), apart.amin(1).max(), guess)).max())
