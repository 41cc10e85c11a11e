"""People who come and go: values of slots become values of persons.

In a replay a slot has one person after the other, each scored without a gap until they leave. Run r of R is
the r-th such time of a slot (E, A, R). Where a slot has fewer, the last ones are empty.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics.contact_functions import begins


class ScoredSpans(NamedTuple):
    """When people are scored.

    Attributes:
        number: Which run each point is in (E, A, T) long, 0 for points that are in none, runs from 1 on.
        count: R.
    """

    number: Tensor
    count: int

    @classmethod
    def of(cls, scored: Tensor) -> ScoredSpans:
        """Find the runs of people who are ``scored`` (E, A, T) bool."""
        number = begins(scored).cumsum(2)
        return cls(number.where(scored, 0), int(number.max()) if number.numel() else 0)

    @property
    def there(self) -> Tensor:
        """Which runs there are (E, A, R) bool."""
        return self.sums(torch.ones_like(self.number)) > 0

    def sums(self, value: Tensor) -> Tensor:
        """Return the sums over each run's points (E, A, R) of values at every point (E, A, T)."""
        result = value.new_zeros(*value.shape[:2], self.count + 1)
        return result.scatter_add_(2, self.number, value)[..., 1:]

    def any(self, value: Tensor) -> Tensor:
        """Return in which runs (E, A, R) something is true at any point (E, A, T)."""
        return self.sums(value.long()) > 0

    def last(self, value: Tensor) -> Tensor:
        """Return the value (E, A, T) at the last point of each run (E, A, R)."""
        after = torch.cat((self.number[..., 1:], torch.zeros_like(self.number[..., :1])), dim=2)
        return self.sums(value.where(self.number != after, 0))
