"""Encoders of the floor plan around a person: rings, a patch, or AlexNet's features of the whole plan.

Floor plans are no part of a model: every batch brings the `MapBank` that its ``map_id`` speaks of, and no
checkpoint holds a map.
"""

import math
from collections import OrderedDict
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional as F

from pedzoo.core.batch import maps_of
from pedzoo.core.errors import UserError
from pedzoo.maps.bank import Atlas, MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.blocks import alexnet
from pedzoo.models.blocks.mlp import mlp

RADII, RAYS = (0.3, 0.6, 1.0, 1.6), 12
"""Radii of rings, metres: doors are a little wider than a person, and a step is half a metre. And the points
on each; the first one is straight ahead.
"""

CLIP = 1.5  # metres: farther walls are all alike


class Viewpoints(NamedTuple):
    """Where P people stand, and on which floor plans."""

    bank: MapBank  # the floor plans, on the device of the positions
    position: Tensor  # scene positions (P, 2), metres
    heading: Tensor  # unit vectors (P, 2) in the scene's frame: where each person is going
    map_id: Tensor  # floor plan of each person's scene (P,) long, -1 for none
    pose: Tensor  # pose of each person's scene (P, 4)

    @classmethod
    def of(cls, batch: TensorDict, scene: Tensor, position: Tensor, heading: Tensor) -> Self:
        """Return the viewpoints of people in the scenes ``scene`` (P,) long of a batch."""
        return cls(maps_of(batch), position, heading, batch["map_id"][scene, 0], batch["scene_pose"][scene])

    def points(self, offsets: Tensor) -> Tensor:
        """Return scene positions (P, N, 2) at offsets (2, N), metres, ahead of and left of each person."""
        with torch.autocast(self.position.device.type, enabled=False):
            ahead = self.heading.float()
            left = torch.stack((-ahead[:, 1], ahead[:, 0]), dim=-1)
            axes = torch.stack((ahead, left), dim=-1)
            offsets = offsets.expand(self.position.shape[0], 2, -1)
            return torch.baddbmm(self.position.float().unsqueeze(2), axes, offsets).transpose(1, 2)

    def distances(self, offsets: Tensor) -> Tensor:
        """Return distances to walls (P, N), metres, at offsets (2, N) ahead of and left of each person."""
        return self.bank.signed_distance(self.points(offsets), self.map_id, self.pose)


def rings(radii: tuple[float, ...], rays: int) -> Tensor:
    """Return offsets (2, 1 + R x rays), metres: here, then on rings, anticlockwise from straight ahead."""
    angle = torch.arange(rays) * (2 * math.pi / rays)
    ring = torch.stack((angle.cos(), angle.sin()))
    return torch.cat([torch.zeros(2, 1), *(radius * ring for radius in radii)], 1)


class RingEncoder(nn.Module):
    """Walls near by, finely, and at an eighth of the reads of a patch: for training in the loop."""

    def __init__(self, dim: int = 32, hidden_dim: int = 64) -> None:
        """Encode into ``dim`` features, with a layer of ``hidden_dim`` inside."""
        super().__init__()
        offsets = rings(RADII, RAYS)
        self.register_buffer("offsets", offsets, persistent=False)
        self.net = mlp(offsets.shape[1], hidden_dim, dim)

    def distances(self, at: Viewpoints) -> Tensor:
        """Return distances to walls (P, 49), metres, at most ``CLIP``: here, then rings, anticlockwise."""
        return at.distances(self.get_buffer("offsets")).clamp(-CLIP, CLIP)

    def forward(self, at: Viewpoints) -> Tensor:
        """Return the features (P, dim)."""
        return self.net(self.distances(at))


class PatchEncoder(nn.Module):
    """A few thousand weights, trained from scratch; turning the whole world changes nothing."""

    def __init__(self, size: float = 6.0, cells: int = 16, dim: int = 32) -> None:
        """Encode a square of ``size`` metres, ``cells`` a side. Raises UserError: it is too small."""
        if cells < 4 or size <= 0:
            raise UserError(
                f"a patch of {cells} x {cells} cells and {size} m: expected at least 4 cells, above 0 m"
            )
        super().__init__()
        steps = (torch.arange(cells, dtype=torch.float32) + 0.5) * (size / cells) - size / 2
        left, ahead = torch.meshgrid(steps, steps, indexing="ij")
        self._cells = cells
        self.register_buffer("offsets", torch.stack((ahead, left)).flatten(1), persistent=False)
        # the first without overlap: a third of the time of a padded 3 x 3 at stride 2
        layers = nn.Conv2d(1, 8, 4, stride=4), *(nn.Conv2d(n, 2 * n, 3, 2, padding=1) for n in (8, 16))
        convolutions = nn.Sequential(*(one for layer in layers for one in (layer, nn.ReLU())), nn.Flatten())
        width = convolutions(torch.zeros(1, 1, cells, cells)).shape[1]
        self.net = nn.Sequential(convolutions, nn.Linear(width, dim))

    def patch(self, at: Viewpoints) -> Tensor:
        """Return distances to walls (P, 1, cells, cells) in units of ``CLIP``, negative inside walls.

        Columns go ahead (the last one is in front of the person), rows go left (the last one is to the left).
        """
        distance = at.distances(self.get_buffer("offsets"))
        return (distance.clamp(-CLIP, CLIP) / CLIP).reshape(-1, 1, self._cells, self._cells)

    def forward(self, at: Viewpoints) -> Tensor:
        """Return the features (P, dim)."""
        return self.net(self.patch(at))


_AROUND = 0.4
"""Metres, two feature cells: how far around a person AlexNet's features are read."""

_MARGIN = alexnet.STRIDE
"""Pixels repeated around a plan, so that feature cells are centred up to its very border and a bit beyond."""


class AlexNetEncoder(nn.Module):
    """Frozen AlexNet convolutions over every floor plan, then a trained linear layer per person.

    The plan is a picture from above: free is white, walls are black. Features are computed in the map's own
    frame. The linear layer reads them at the person's place and at four around it, turned to the heading: so
    it knows on which side a wall is. Checkpoints hold the linear layer only.
    """

    def __init__(self, dim: int = 32, weights: str | None = None, cell: float = 0.2) -> None:
        """Encode conv5 features into ``dim`` features per person.

        Args:
            dim: Features per person.
            weights: File with AlexNet's weights, see `pedzoo.models.blocks.alexnet.load`; None for the usual.
            cell: Metres that one feature cell covers at most; the plan is rescaled for it.
        """
        super().__init__()
        offsets = torch.cat((torch.zeros(2, 1), rings((_AROUND,), 4)[:, 1:]), 1)
        self.register_buffer("offsets", offsets, persistent=False)
        self.head = nn.Linear(alexnet.CHANNELS * offsets.shape[1], dim)
        self.weights, self.cell = weights, cell

    def features(self, at: Viewpoints) -> Tensor:
        """Return AlexNet's features (P, 5, 256) at each person's place and around; zeros without a map."""
        atlas = atlas_of(at.bank, at.bank.device, self.weights, self.cell)
        return atlas.sample(at.points(self.get_buffer("offsets")), at.bank.index(at.map_id), at.pose)

    def forward(self, at: Viewpoints) -> Tensor:
        """Return the features (P, dim)."""
        return self.head(self.features(at).flatten(1))


ENCODERS: dict[str, type[RingEncoder | PatchEncoder | AlexNetEncoder]] = {
    "patch": PatchEncoder, "alexnet": AlexNetEncoder, "rings": RingEncoder
}  # fmt: skip
"""By the names that settings of models give them."""


_ENCODED: OrderedDict[tuple[str, str, str | None, float], Tensor] = OrderedDict()
_NUMBERS = 100_000_000
"""Features of floor plans that were encoded last, and how many numbers of them are kept."""


@lru_cache(8)  # a policy meets a training set, an environment and little else
def atlas_of(bank: MapBank, device: torch.device, weights: str | None, cell: float) -> Atlas:
    """Return AlexNet's features of every floor plan of a bank, on a device; some seconds for each plan."""
    keys = [(grid.digest, bank.unknown, weights, cell) for grid in bank.grids]
    tensors = {} if _ENCODED.keys() >= set(keys) else alexnet.load(weights)
    with torch.inference_mode(False):  # the next use may ask for gradients
        features = []
        for grid, key in zip(bank.grids, keys, strict=True):  # scenarios draw the same doors again and again
            if key not in _ENCODED:
                _ENCODED[key] = encode(grid, bank, tensors, cell)
            _ENCODED.move_to_end(key)
            features.append(_ENCODED[key])
        while sum(map(torch.Tensor.numel, _ENCODED.values())) > _NUMBERS and len(_ENCODED) > 1:
            _ENCODED.popitem(last=False)
        to_pixel = [map_to_feature(grid, cell) for grid in bank.grids]
        return Atlas.stack(features, to_pixel, nowhere=torch.zeros(alexnet.CHANNELS)).to(device)


@torch.no_grad()
def encode(grid: OccupancyGrid, bank: MapBank, weights: dict[str, Tensor], cell: float) -> Tensor:
    """Return AlexNet's features (256, h, w) of a floor plan, row 0 at the smallest y like the plan's."""
    free = torch.from_numpy(~grid.occupied(bank.unknown)).float()[None, None]
    size = _picture_size(grid, cell)
    picture = F.interpolate(free, size=size, mode="bilinear", antialias=True)
    height, width = (
        alexnet.input_length(math.ceil(length / alexnet.STRIDE) + 1) - length - _MARGIN for length in size
    )
    # Repeating the border, and not zeros: black would be a wall around every plan.
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
    # 440 cells of 0.05 m are 880 pixels, and not 881 because 0.05 has no exact binary form
    height, width = (
        math.ceil(side * grid.resolution * alexnet.STRIDE / cell - 1e-6) for side in grid.cells.shape
    )
    return height, width
