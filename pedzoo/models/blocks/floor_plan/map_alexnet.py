"""Map encoder: AlexNet's features of whole floor plans, computed once and read at each person's place."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from pedzoo.maps.bank import Atlas, MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.blocks.floor_plan import alexnet
from pedzoo.models.blocks.floor_plan.map_encoder import MapEncoder

T = TypeVar("T")

MOST = 4
"""Banks of which something is kept: a policy meets a training set, an environment and little else."""


class PerBank(Generic[T]):
    """Values by bank and device; the least recently used ones are dropped. Copies begin empty."""

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._kept: OrderedDict[tuple[MapBank, torch.device], T] = OrderedDict()

    def of(self, bank: MapBank, make: Callable[[MapBank], T]) -> T:
        """Return the value of a bank on its device, made by ``make(bank)`` where it is not kept."""
        key = bank, bank.device
        if key not in self._kept:
            with torch.inference_mode(False):  # the next use may ask for gradients
                self._kept[key] = make(bank)
            while len(self._kept) > MOST:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def __reduce__(self) -> tuple[type[PerBank[Any]], tuple[()]]:
        return PerBank, ()


_MARGIN = alexnet.STRIDE
"""Pixels repeated around a plan, so that feature cells are centred up to its very border and a bit beyond."""


class AlexNetEncoder(MapEncoder):
    """Frozen AlexNet convolutions over every floor plan, then a trained linear layer per person.

    The plan is a picture from above: free is white, walls are black, and unknown cells are either, as the
    bank counts them. Features are computed in the map's own frame when a bank is bound. They are not turned
    to a person's heading (nor to a scene's rotation or mirroring: only the place is moved). The convolutions
    and the features are no parameters or buffers: checkpoints hold the linear layer only.

    Attributes:
        weights: File with AlexNet's weights, None for the usual place.
        cell: Metres that one feature cell covers at most.
    """

    def __init__(self, dim: int = 32, weights: str | None = None, cell: float = 0.4) -> None:
        """Encode conv5 features.

        Args:
            dim: Features per person.
            weights: File with AlexNet's weights, see `pedzoo.models.blocks.floor_plan.alexnet.load`.
            cell: Metres that one feature cell covers at most; the plan is rescaled for it.
        """
        super().__init__(dim)
        self.head = nn.Sequential(nn.Linear(alexnet.CHANNELS, dim), nn.ReLU())
        self.weights, self.cell = weights, cell
        self._encoded: dict[tuple[int, str], Tensor] = {}
        self._atlases: PerBank[Atlas] = PerBank()

    def atlas(self, bank: MapBank) -> Atlas:
        """Return the features of every floor plan of ``bank``, about a second for each that is new."""
        return self._atlases.of(bank, self._encode)

    def _encode(self, bank: MapBank) -> Atlas:
        known, needed = self._encoded, {(grid.map_id, bank.unknown): grid for grid in bank.grids}
        new = {key: grid for key, grid in needed.items() if key not in known}
        weights = alexnet.load(self.weights) if new else {}
        for key, grid in new.items():
            known[key] = encode(grid, bank, weights, self.cell)
        nowhere = torch.zeros(alexnet.CHANNELS)
        to_pixel = [map_to_feature(grid, self.cell) for grid in bank.grids]
        return Atlas.stack([known[key] for key in needed], to_pixel, nowhere).to(bank.device)

    def features(self, bank: MapBank, position: Tensor, map_id: Tensor, pose: Tensor) -> Tensor:
        """Return AlexNet's features (P, 256) at each person's place; zeros without a map."""
        return self.atlas(bank).sample(position, bank.index(map_id), pose)

    def forward(
        self, bank: MapBank, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return the features (P, dim); arguments as in `MapEncoder.forward`."""
        return self.head(self.features(bank, position, map_id, pose))


@torch.no_grad()
def encode(grid: OccupancyGrid, bank: MapBank, weights: dict[str, Tensor], cell: float) -> Tensor:
    """Return AlexNet's features (256, h, w) of a floor plan, row 0 at the smallest y like the plan's."""
    free = torch.from_numpy(~grid.occupied(bank.unknown)).float()[None, None]
    size = _picture_size(grid, cell)
    picture = F.interpolate(free, size=size, mode="bilinear", antialias=True)
    # Repeating the border, and not zeros: black would be a wall around every plan.
    height, width = (alexnet.input_length(_feature_cells(length)) - length - _MARGIN for length in size)
    picture = F.pad(picture, (_MARGIN, width, _MARGIN, height), mode="replicate")
    return alexnet.features(picture.expand(-1, 3, -1, -1), weights)[0]


def map_to_feature(grid: OccupancyGrid, cell: float) -> NDArray[np.float64]:
    """Return the affine (2, 3) from positions in the map's frame to (column, row) of its features."""
    affine = grid.map_to_cell()
    affine[:, 2] += 0.5  # from the outer corner, in cells
    height, width = _picture_size(grid, cell)
    affine *= np.array([[width / grid.cells.shape[1]], [height / grid.cells.shape[0]]])  # in pixels
    affine[:, 2] += _MARGIN - 0.5 - alexnet.FIRST  # from the centre of the first feature cell
    return affine / alexnet.STRIDE


def _picture_size(grid: OccupancyGrid, cell: float) -> tuple[int, int]:
    pixels_per_cell = grid.resolution * alexnet.STRIDE / cell
    # 440 cells of 0.05 m are 880 pixels, and not 881 because 0.05 has no exact binary form.
    height, width = (math.ceil(side * pixels_per_cell - 1e-6) for side in grid.cells.shape)
    return height, width


def _feature_cells(length: int) -> int:
    return math.ceil(length / alexnet.STRIDE) + 1
