"""What people tried: a policy remembers whether they walked when they wished to, or were asked to."""

from typing import NamedTuple, Self

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS

_WALKS = 0.1
"""m/s: slower people stand."""


class Attempts(NamedTuple):
    """What B scenes of A people tried.

    Attributes:
        tried: Whether they have wished to walk since they walked last (B, A) bool.
        asked: Whether the policy asked them to walk at the last decision (B, A) bool.
        pressing: For how many decisions, one after the other, they were asked to walk and stood (B, A).
    """

    tried: Tensor
    asked: Tensor
    pressing: Tensor

    @classmethod
    def none(cls, people: Tensor) -> Self:
        """Return those of people who tried nothing yet: zeros like ``people`` (B, A), of a float type."""
        never = people.new_zeros(people.shape)
        return cls(never > 0, never > 0, never)

    def seen(self, stands: Tensor) -> Self:
        """Return the attempts of people of whom these stand (B, A) bool; others begin anew."""
        in_vain = stands & self.asked
        pressing = (self.pressing + 1).where(in_vain, 0.0)
        return type(self)(stands & self.tried, torch.zeros_like(in_vain), pressing)

    def trying(self, wish: Tensor, step: Tensor) -> Self:
        """Return attempts with the steps (B, A, 2), metres, that people wish for, and are asked for."""
        return self._replace(tried=self.tried | walks(wish.detach()), asked=walks(step.detach()))


def walks(step: Tensor) -> Tensor:
    """Return whether people walk (...,) bool, by their steps (..., 2), metres."""
    return step.square().sum(-1) >= (_WALKS * STEP_SECONDS) ** 2
