"""How a person walks, read from the first steps that are seen of them.

Recorded people differ in how they walk, and tracks in how they were annotated. Both show in a person's first
rows and last for the walk.
"""

import torch
from torch import Tensor
from torch.nn import functional

STYLE_DIM = 5
"""Numbers of a style."""

_FLOOR = 0.003
"""Metres: smaller changes of a step are all alike."""

_HELD = 0.006
"""Metres: a velocity that changes less in a step is held."""

_CENTRE = 3.5
"""Minus the logarithm of a usual change, metres."""


def style_of(first: Tensor) -> Tensor:
    """Return the styles (..., 5) of people by their first places (..., T, 2), metres, 0.4 s apart.

    The logarithms of the mean second and third difference and of the mean step aside, the share of velocities
    that are held, and how alike two successive second differences are. All are of the order of 1.
    """
    step = first.diff(dim=-2)
    change = step.diff(dim=-2)
    way = functional.normalize(first[..., -1, :] - first[..., 0, :], dim=-1).unsqueeze(-2)
    aside = (step[..., 0] * way[..., 1] - step[..., 1] * way[..., 0]).abs().mean(-1)
    size = change.norm(dim=-1)
    logs = [
        (value + _FLOOR).log() + _CENTRE
        for value in (size.mean(-1), change.diff(dim=-2).norm(dim=-1).mean(-1), aside)
    ]
    held = (size < _HELD).to(size.dtype).mean(-1)
    alike = (change[..., 1:, :] * change[..., :-1, :]).sum((-1, -2))
    alike = alike / change.square().sum((-1, -2)).clamp_min(1e-5)
    return torch.stack((*logs, 2 * held - 0.5, 2 * alike), -1)


def jitter_of(style: Tensor) -> Tensor:
    """Return the mean second difference (...,) of people with a style (..., 5), metres, and 3 mm."""
    return (style[..., 0] - _CENTRE).exp()
