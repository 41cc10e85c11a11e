"""The interface of everything that turns the floor plan around a person into features."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from pedzoo.errors import UserError
from pedzoo.maps.bank import MapBank


class MapEncoder(nn.Module, ABC):
    """Encodes the floor plan at each person's place.

    Floor plans are no part of a model: it is bound to the `MapBank` of whoever makes its batches (a
    datamodule, an environment, a controller), and no checkpoint holds a map.

    Attributes:
        dim: Features per person.
    """

    dim: int

    def __init__(self, dim: int) -> None:
        """Encode into ``dim`` features; nothing is bound yet."""
        super().__init__()
        self.dim = dim
        self._bank: MapBank | None = None

    def bind(self, bank: MapBank) -> None:
        """Read the floor plans of ``bank`` from now on, instead of any earlier one."""
        self._bank = bank

    def bank(self, device: torch.device) -> MapBank:
        """Return the bound bank on ``device``.

        Raises:
            UserError: Nothing is bound.
        """
        if self._bank is None:
            raise UserError(
                f"{type(self).__name__} has no floor plans yet: call bind(bank) with the MapBank that the "
                "batches come from; an empty one, MapBank(), serves scenes without maps"
            )
        self._bank = self._bank.to(device)
        return self._bank

    def distances_at(
        self, offsets: Tensor, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return distances to walls (P, N), metres, at N places around each person.

        Args:
            offsets: Places (2, N), metres ahead and to the left.
            position: As in `forward`, like all others.
            heading: Where is ahead.
            map_id: Floor plans.
            pose: Poses.
        """
        with torch.autocast(position.device.type, enabled=False):
            ahead = heading.float()
            left = torch.stack((-ahead[:, 1], ahead[:, 0]), dim=-1)
            axes = torch.stack((ahead, left), dim=-1)
            offsets = offsets.expand(position.shape[0], 2, -1)
            points = torch.baddbmm(position.float().unsqueeze(2), axes, offsets).transpose(1, 2)
            return self.bank(position.device).signed_distance(points, map_id, pose)

    @abstractmethod
    def forward(self, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor) -> Tensor:
        """Return the features (P, dim).

        Args:
            position: Scene positions (P, 2), metres.
            heading: Unit vectors (P, 2) in the scene's frame: where each person is going.
            map_id: Floor plan of each person's scene (P,) long, -1 for none.
            pose: Pose of each person's scene (P, 4).
        """
