"""Lines of sight that keep their distance from walls, for many pairs of points at once."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

_LEAPS = 8
"""Steps as long as the room allows before what is left of a line is sampled densely."""

_DENSE = 0.5
"""Cells between the samples of a dense line: distances change by less than that in between."""


class Sight:
    """Who sees whom on one floor plan without coming nearer to a wall than a clearance.

    Between cell centres the distance is read bilinearly, so that a step to one of the eight neighbours is
    always in sight if the cells around it are open. Sampled lines may miss a dip below the clearance of a
    quarter of a cell.
    """

    def __init__(self, distance: NDArray[np.float32], resolution: float, clearance: float) -> None:
        """Take the distances to the nearest wall (H, W) in metres, the cells' side and the clearance."""
        height, width = distance.shape
        spare = (distance - clearance) / resolution + 1e-4
        reach = float(height + width)  # a map without walls is infinitely far from them
        self._spare = torch.from_numpy(np.clip(spare, -reach, reach))[None, None]
        self._scale = torch.tensor([2 / max(width - 1, 1), 2 / max(height - 1, 1)])

    def clear(self, origin: Tensor, target: Tensor) -> Tensor:
        """Return which lines (M,) keep the clearance.

        Args:
            origin: Their first points (M, 2): column and row, whole at cell centres, float32.
            target: Their last points (M, 2).
        """
        seen = torch.ones(len(origin), dtype=torch.bool)
        way = target - origin
        length = way.norm(dim=1)
        way = way / length.clamp_min(1e-9)[:, None]
        done = torch.zeros(len(origin))
        who = torch.arange(len(origin))
        # Spheres: where the nearest wall is far, the next sample may be as far.
        for _ in range(_LEAPS):
            spare = self._read(torch.addcmul(origin, way, done[:, None]))
            seen[who[spare < 0]] = False
            done = done + spare.clamp_min(_DENSE)
            rest = (spare >= 0) & (done < length)
            who, origin, way, done, length = who[rest], origin[rest], way[rest], done[rest], length[rest]
            if not len(who):
                return seen
        # Lines along a wall never have far to leap: all their samples at once.
        count = ((length - done) / _DENSE).long() + 1
        line = torch.repeat_interleave(torch.arange(len(who)), count)
        first = count.cumsum(0) - count
        along = done[line] + (torch.arange(len(line)) - first[line]) * _DENSE
        spare = self._read(torch.addcmul(origin[line], way[line], along[:, None]))
        seen[who[line[spare < 0]]] = False
        return seen

    def _read(self, cells: Tensor) -> Tensor:
        where = cells * self._scale - 1
        return F.grid_sample(self._spare, where[None, None], padding_mode="border", align_corners=True)[
            0, 0, 0
        ]
