"""When people who stand set out again."""

import torch
from torch import Tensor

from pedzoo.models.blocks.people.step_features import Situation

STANDING = 4.5
"""Of the gate that changes velocities: before training people who stand set out in 7 % of steps."""

AT_ONCE = 20.0
"""Of the gate: they set out now."""

LONG = 40.0
"""Seconds after their patience within which people who walked at first set out in any case."""


def setting_out(now: Situation, too_late: Tensor, again: bool) -> Tensor:
    """Return what is added to the gates of people who stand (B, A).

    They set out at once if they get another goal.

    Args:
        now: The situation.
        too_late: By how much they are later than their patience lasts (B, A), seconds.
        again: Whether people whom others stopped set out at once, too, and those who stopped by themselves
            in the end: else a jam lasts as long as its people hold still.
    """
    goes = now.called
    if again:
        goes = torch.maximum(goes, now.hindered)
        goes = torch.maximum(goes, (1 - now.stood) * (too_late / LONG).clamp(0, 1))
    return AT_ONCE * goes - STANDING
