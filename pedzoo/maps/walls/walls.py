"""Exact distances to walls made of square cells, for all agents on all floor plans in one call.

The field behind `MapBank.signed_distance` is read between cell centres: smooth, and off by up to a fifth of a
cell. Contacts and sliding along walls need the walls as they are, the union of the occupied squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.walls.nearest_boxes import CANDIDATES, nearest_boxes
from pedzoo.maps.walls.segment_table import Outlines, SegmentTable

_ROUNDING = 1e-4
"""Cells that single precision may err by."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Boxes of wall and of free space of R maps, and for each quarter of a cell those that may be nearest.

    Each map is padded by ``max_distance`` and cut into quarters of cells. Which boxes contend in a
    quarter says `pedzoo.maps.walls.nearest_boxes`. The contending boxes of a position's quarter are compared.

    Attributes:
        option: Sets of contending boxes in columns (4 * CANDIDATES + 1, O) float32: all their x0, then all
            their y0, x1 and y1, in half cells from the padded map's outer corner; last, plus one where they
            are walls and minus one where they are free space.
        choice: Which set contends in each quarter, row by row, one map after another (Q,) int32.
        least: What any position in a quarter is away from the nearest wall, at least (Q,) float32, metres.
        affine: Map frame in metres to half cells of the padded map: column by column a matrix's two rows and
            two shifts (6, R + 1) float64; row -1 means "no map".
        place: Columns and rows of quarters of each padded map, and where they begin (3, R + 1) int32.
        side: Of half a cell in metres (R + 1,) float64.
        limit: Distances are clipped to plus and minus this, metres.
        outlines: The same walls as line segments, on the CPU.
    """

    option: Tensor
    choice: Tensor
    least: Tensor
    affine: Tensor
    place: Tensor
    side: Tensor
    limit: float
    outlines: Outlines

    @classmethod
    def of(cls, grids: Sequence[OccupancyGrid], unknown: Unknown, max_distance: float) -> Walls:
        """Return the walls of ``grids``, with unknown cells counted as walls or as free."""
        # People farther out than the padding have no wall within max_distance. "No map" is a last map of
        # one free cell that every position falls on: index -1 finds it.
        pads = [math.ceil(max_distance / grid.resolution) for grid in grids]
        plans = [np.pad(grid.occupied(unknown), pad) for grid, pad in zip(grids, pads, strict=True)]
        plans.append(np.zeros((1, 1), dtype=bool))
        sides = [*(grid.resolution for grid in grids), 1.0]
        option, choice, least, options = [], [], [], 0
        for cells, side in zip(plans, sides, strict=True):
            nearest = nearest_boxes(cells)
            sets = np.concatenate(
                (np.repeat(np.arange(len(nearest.box))[:, None], CANDIDATES, 1), nearest.sets)
            )
            boxes = (2 * nearest.box)[sets].transpose(2, 1, 0).reshape(4 * CANDIDATES, -1)
            option.append(np.concatenate((boxes, nearest.sign[sets[:, 0]][None])).astype(np.float32))
            choice.append((nearest.choice + options).astype(np.int32).ravel())
            bound = (nearest.least - _ROUNDING) * side
            least.append(np.minimum(bound, max_distance).astype(np.float32).ravel())
            options += len(sets)
        begin = np.cumsum([0, *(4 * cells.size for cells in plans[:-1])])
        height, width = (2 * np.array([cells.shape for cells in plans])).T

        affine = np.zeros((6, len(plans)))
        for row, (grid, pad) in enumerate(zip(grids, pads, strict=True)):
            to_cell = grid.map_to_cell()
            affine[:, row] = 2 * np.array([*to_cell[0, :2], *to_cell[1, :2], *(to_cell[:, 2] + pad + 0.5)])
        return cls(
            option=torch.from_numpy(np.concatenate(option, axis=1)),
            choice=torch.from_numpy(np.concatenate(choice)),
            least=torch.from_numpy(np.concatenate(least)),
            affine=torch.from_numpy(affine),
            place=torch.from_numpy(np.stack((width, height, begin)).astype(np.int32)),
            side=torch.tensor(sides, dtype=torch.float64) / 2,
            limit=max_distance,
            outlines=Outlines(grids, unknown),
        )

    def to(self, device: torch.device | str) -> Walls:
        """Return the walls on a device: themselves where they are there already."""
        if self.choice.device == torch.device(device):
            return self
        tensors = ("option", "choice", "least", "affine", "place", "side")
        return replace(self, **{name: getattr(self, name).to(device) for name in tensors})

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """What compiled loops ask for distances: choices, options, lower bounds, and where distances end.

        Options lie in rows here: one agent's stand together in memory.
        """
        return self.choice.numpy(), self.option.t().contiguous().numpy(), self.least.numpy(), self.limit

    @cached_property
    def map_arrays(self) -> tuple[Any, ...]:
        """What the compiled planner reads: how the maps lie, and where a body has room.

        The latter has a bit for every quarter, and so is in the processor's cache.
        """
        clear = np.packbits(self.least.numpy() >= BODY_RADIUS, bitorder="little")
        return self.affine.numpy(), self.place.numpy(), self.side.numpy(), clear

    def segments(
        self,
        reach: float,
        most: int | None = None,
        hollows: bool = True,
        dtype: torch.dtype = torch.float32,
    ) -> SegmentTable:
        """Return the walls' outlines as segments in buckets, on the device of the walls, made once.

        Args:
            reach: Metres up to which segments are asked for.
            most: How many segments one position gets; None for all.
            hollows: Whether hollows that no body fits in have outlines, too.
            dtype: Of the positions.
        """
        return self.outlines.table(reach, most, hollows, self.choice.device, dtype)
