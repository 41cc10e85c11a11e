"""Numbers of numpy's legacy generator for many cases at once: what CrowdNav draws one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.geometry import direction_of

LENGTH = 8192
"""Numbers kept of each case: CrowdNav++ takes about 600 of them in 50 s."""


@dataclass
class Draws:
    """A stream of uniform numbers for each of B cases.

    Attributes:
        numbers: From 0 to 1 (B, L) float64.
        taken: How many of them are used up (B,) long.
    """

    numbers: Tensor
    taken: Tensor

    @classmethod
    def of_seeds(cls, seeds: Sequence[int]) -> Draws:
        """Return the streams that ``np.random.seed(seed)`` begins."""
        streams = [np.random.RandomState(seed).random_sample(LENGTH) for seed in seeds]
        numbers = torch.from_numpy(np.stack(streams)) if streams else torch.zeros(0, LENGTH).double()
        return cls(numbers, torch.zeros(len(numbers), dtype=torch.long))

    def take(self, rows: Tensor, count: int) -> Tensor:
        """Return the next numbers (R, count) of some cases ``rows`` (R,) long.

        Raises:
            RuntimeError: A case needs more than `LENGTH`: it has no place for one more person.
        """
        begin = self.taken.index_select(0, rows)
        if len(rows) and int(begin.max()) + count > self.numbers.shape[1]:
            raise RuntimeError(f"a case drew {LENGTH} numbers and found no place for another person")
        self.taken.index_add_(0, rows, torch.full_like(rows, count))
        place = begin[:, None] + torch.arange(count, device=rows.device)
        return self.numbers[rows[:, None], place]


def on_circle(radius: float, numbers: Tensor, least: float, most: float) -> Tensor:
    """Return points (..., 2) on a circle around 0, shifted along x and y.

    Args:
        radius: Of the circle, metres.
        numbers: For the angle, the shift along x and that along y (..., 3), from 0 to 1.
        least: Least shift, metres.
        most: Most shift, metres.
    """
    angle = numbers[..., 0] * (2 * math.pi)
    shift = least + (most - least) * numbers[..., 1:]
    return radius * direction_of(angle) + shift
