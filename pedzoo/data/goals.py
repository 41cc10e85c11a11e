"""Goal protocols for recorded people: a forecaster's knowledge of where they go.

``window_end`` is the answer's own last position and leaks it: untrained interpolation to it scores
FDE 0. It is the paper's Table I. ``destination`` is where the person was last recorded, which is what a
planner knows; ``random_future`` is any later point of the same track, for training only.
"""

import torch
from torch import Tensor

from pedzoo.core.types import GoalProtocol

TIMED = frozenset({"window_end"})
"""Protocols whose goal is reached exactly at the last predicted step."""


def recorded_goals(
    protocol: GoalProtocol,
    xy: Tensor,
    last: Tensor,
    end: Tensor,
    window_end: Tensor,
    generator: torch.Generator | None,
) -> Tensor:
    """Return goals (B, A, 2) by a protocol other than ``none``.

    They are rows of positions ``xy`` (N, 2) between the last observed one, ``last`` (B, A), and the last
    recorded one, ``end`` (B, A), or ``window_end`` (B, A, 2), the last known one of the window.
    """
    if protocol == "window_end":
        return window_end
    if protocol == "destination":
        return xy[end]
    later = torch.rand(last.shape, generator=generator) * (end - last)
    return xy[torch.minimum(last + 1 + later.long(), end)]
