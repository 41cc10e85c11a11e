"""How a person walks, read from the first steps that are seen of them.

Recorded people differ in how they walk, and tracks in how they were annotated. Both show in a person's first
rows and last for the walk.
"""

import torch
from torch import Tensor
from torch.nn import functional

STYLE_DIM = 6
"""Numbers of a style."""

_FLOOR = 0.003
"""Metres: smaller changes of a step are all alike."""

_HELD = 0.006
"""Metres: a velocity that changes less in a step is held."""

_CENTRE = 3.5
"""Minus the logarithm of a usual change, metres."""

_FINEST, _FINE_CENTRE = 2e-4, 5.0
"""The same two of the smaller changes: tracks that were drawn in straight pieces have none."""


_RAREST = 0.15
"""At least this share of velocities changes."""

_EVEN = 0.0025
"""Metres: people of recordings who walk change their steps by more than this in the mean."""

USUAL = (-0.84, 0.0, 0.0, -0.3, 0.0, -1.51)
"""Velocities change in 9 of 10 steps, by some 1 cm per step, and places jitter by half a millimetre."""


def style_of(first: Tensor) -> Tensor:
    """Return the styles (..., 6) of people by their first places (..., T, 2), metres, 0.4 s apart.

    The logarithms of the mean second and third difference and of the mean step aside, the share of velocities
    that are held, how alike two successive second differences are, and the logarithm of the smaller second
    differences. All are of the order of 1.
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
    fine = (size.sort(-1).values[..., : max(2, size.shape[-1] // 2)].mean(-1) + _FINEST).log() + _FINE_CENTRE
    return torch.stack((*logs, 2 * held - 0.5, 2 * alike, fine / 1.5), -1)


def kinks_of(style: Tensor) -> Tensor:
    """Return the mean second difference (...,) of people with a style (..., 6), metres."""
    return (style[..., 0] - _CENTRE).exp() - _FLOOR


def kink_of_change(style: Tensor) -> Tensor:
    """Return the mean second difference (...,) of the steps whose velocity is not held, metres.

    Kinks of tracks drawn in straight pieces are rare and large: a mean over all steps hides their size.
    """
    return kinks_of(style) / (1 - held_of(style)).clamp_min(_RAREST)


def jitter_of(style: Tensor) -> Tensor:
    """Return the mean of the smaller half of their second differences (...,), metres."""
    return (1.5 * style[..., 5] - _FINE_CENTRE).exp() - _FINEST


def held_of(style: Tensor) -> Tensor:
    """Return the share of their velocities that are held (...,)."""
    return (style[..., 3] + 0.5) / 2


def unless_even(style: Tensor, change: Tensor) -> Tensor:
    """Return styles (..., 6), or the usual one of scenes whose people walk more evenly than recorded ones.

    Such steps were made by a rule, as those of a warm start, and say nothing of how people walk.

    Args:
        style: Of people.
        change: Mean second difference of those of the scene who walk (..., 1), metres; infinite if none does.
    """
    return torch.lerp(style.new_tensor(USUAL), style, (change / _EVEN).clamp(0, 1))
