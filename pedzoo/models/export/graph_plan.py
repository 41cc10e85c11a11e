"""Floor plans as inputs of a graph: an image, and where on it positions are."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.maps.bank import MAX_DISTANCE, MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.floor_plan import alexnet
from pedzoo.models.blocks.floor_plan.map_alexnet import AlexNetEncoder, encode, map_to_feature
from pedzoo.models.blocks.floor_plan.map_encoder import MapEncoder


def plan_inputs(model: nn.Module, bank: MapBank, grid: OccupancyGrid) -> dict[str, NDArray[np.float32]]:
    """Return the inputs ``map_image`` (C, rows, columns) and ``map_affine`` (2, 3) of a floor plan.

    The model says which maps it reads, the bank what unknown cells mean.

    Raises:
        UserError: AlexNet's weights are missing.
    """
    if encoder := alexnet_of(model):
        image = encode(grid, bank, alexnet.load(encoder.weights), encoder.cell).numpy()
        affine = map_to_feature(grid, encoder.cell)
    else:
        image = grid.signed_distance(bank.unknown)[None].clip(-MAX_DISTANCE, MAX_DISTANCE)
        affine = grid.map_to_cell()
    return {"map_image": image, "map_affine": affine.astype(np.float32)}


def alexnet_of(model: nn.Module) -> AlexNetEncoder | None:
    """Return the encoder with which a model sees AlexNet's features; None where it does not."""
    return next((part for part in model.modules() if isinstance(part, AlexNetEncoder)), None)


def reading_from_plan(model: Forecaster) -> Forecaster:
    """Return ``model``, changed so that it reads a `PlanInput`."""
    for name, part in list(model.named_modules()):
        if isinstance(part, AlexNetEncoder):
            model.set_submodule(name, _FeatureReader(part))
    return model


class PlanInput(MapBank):
    """A bank whose only floor plan is an input of the graph, for every ``map_id`` of scenes.

    Scenes lie on it as they are: their pose is the identity.
    """

    def __init__(self, image: Tensor, affine: Tensor) -> None:
        """Take ``map_image`` and ``map_affine`` of `plan_inputs`."""
        super().__init__()
        self._image, self._affine = image, affine

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def to(self, device: torch.device | str) -> MapBank:
        """Return the bank itself."""
        return self

    def signed_distance(self, points: Tensor, map_id: Tensor, pose: Tensor) -> Tensor:
        """Return the distances (N, ...), as `MapBank.signed_distance`."""
        return self.read(points)[..., 0]

    def read(self, points: Tensor) -> Tensor:
        """Return the image's values (N, n, C) at positions (N, n, 2), as `pedzoo.maps.bank.Atlas` does."""
        pixel = points @ self._affine[:, :2].t() + self._affine[:, 2]
        rows, columns = self._image.shape[1:]
        where = torch.stack((2 * pixel[..., 0] / (columns - 1), 2 * pixel[..., 1] / (rows - 1)), -1) - 1
        result = functional.grid_sample(self._image[None], where[None], "bilinear", "border", True)
        return result[0].permute(1, 2, 0)


class _FeatureReader(MapEncoder):
    """An `AlexNetEncoder` whose features are the image of a `PlanInput`."""

    def __init__(self, encoder: AlexNetEncoder) -> None:
        super().__init__(encoder.dim)
        self.head = encoder.head

    def forward(
        self, bank: MapBank, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        assert isinstance(bank, PlanInput)
        return self.head(bank.read(position.unsqueeze(1))[:, 0])
