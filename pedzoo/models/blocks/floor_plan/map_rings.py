"""Map encoder: distances to walls on rings around each person, turned to the heading, and a small network."""

from torch import Tensor, nn

from pedzoo.maps.bank import MapBank
from pedzoo.models.blocks.floor_plan.map_encoder import MapEncoder, rings

RADII = (0.3, 0.6, 1.0, 1.6)
"""Metres: doors are a little wider than a person, and a step at walking speed is half a metre."""

RAYS = 12
"""Points on a ring; the first one is straight ahead."""

CLIP = 1.5
"""Metres: farther walls are all alike."""


class RingEncoder(MapEncoder):
    """Walls near by, finely, and at an eighth of the reads of a patch: for training in the loop."""

    def __init__(self, dim: int = 32, hidden_dim: int = 64) -> None:
        """Encode into ``dim`` features, with a layer of ``hidden_dim`` inside."""
        super().__init__(dim)
        offsets = rings(RADII, RAYS)
        self.register_buffer("offsets", offsets, persistent=False)
        self.net = nn.Sequential(
            nn.Linear(offsets.shape[1], hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, dim), nn.ReLU()
        )

    def distances(
        self, bank: MapBank, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return distances to walls (P, 49), metres, at most ``CLIP``: here, then rings, anticlockwise.

        Arguments as in `MapEncoder.forward`.
        """
        distance = self.distances_at(bank, self.get_buffer("offsets"), position, heading, map_id, pose)
        return distance.clamp(-CLIP, CLIP)

    def forward(
        self, bank: MapBank, position: Tensor, heading: Tensor, map_id: Tensor, pose: Tensor
    ) -> Tensor:
        """Return the features (P, dim); arguments as in `MapEncoder.forward`."""
        return self.net(self.distances(bank, position, heading, map_id, pose))
