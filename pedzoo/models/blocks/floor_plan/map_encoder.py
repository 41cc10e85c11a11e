"""The interface of everything that turns the floor plan around a person into features."""

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from pedzoo.maps.bank import MapBank


def rings(radii: tuple[float, ...], rays: int) -> Tensor:
    """Return offsets (2, 1 + R x rays), metres: here, then on rings, anticlockwise from straight ahead."""
    angle = torch.arange(rays) * (2 * math.pi / rays)
    ring = torch.stack((angle.cos(), angle.sin()))
    return torch.cat([torch.zeros(2, 1), *(radius * ring for radius in radii)], 1)


def distances_at(
    bank: MapBank, offsets: Tensor, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
) -> Tensor:
    """Return distances to walls (P, N), metres, at offsets (2, N) ahead of and left of each person.

    Other arguments as of `MapEncoder.forward`.
    """
    with torch.autocast(position.device.type, enabled=False):
        ahead = heading.float()
        left = torch.stack((-ahead[:, 1], ahead[:, 0]), dim=-1)
        axes = torch.stack((ahead, left), dim=-1)
        offsets = offsets.expand(position.shape[0], 2, -1)
        points = torch.baddbmm(position.float().unsqueeze(2), axes, offsets).transpose(1, 2)
        return bank.signed_distance(points, map_id, pose)


class MapEncoder(nn.Module, ABC):
    """Encodes the floor plan at each person's place.

    Floor plans are no part of a model: every batch brings the `MapBank` that its ``map_id`` speaks of, and no
    checkpoint holds a map.

    Attributes:
        dim: Features per person.
    """

    dim: int

    def __init__(self, dim: int) -> None:
        """Encode into ``dim`` features."""
        super().__init__()
        self.dim = dim

    def distances_at(
        self, bank: MapBank, offsets: Tensor, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return distances to walls (P, N) as `distances_at` does."""
        return distances_at(bank, offsets, position, heading, map_id, pose)

    @abstractmethod
    def forward(
        self, bank: MapBank, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return the features (P, dim).

        Args:
            bank: The floor plans, on the device of the positions.
            position: Scene positions (P, 2), metres.
            heading: Unit vectors (P, 2) in the scene's frame: where each person is going.
            map_id: Floor plan of each person's scene (P,) long, -1 for none.
            pose: Pose of each person's scene (P, 4).
        """
