"""Pooled states of the others around a person, relative to that person and in their frame."""

import torch
from torch import Tensor, nn

from pedzoo.core import geometry
from pedzoo.models.blocks.people.crowd import Crowd

REACH = 4.0
"""Metres: the scale of distances. Farther people look more and more alike."""


class RelativePooling(nn.Module):
    """Max-pools an embedding of all others' relative position and velocity.

    The order of people and the pose of the scene do not matter. A person alone has features of zero.
    """

    def __init__(self, hidden_dim: int, dim: int) -> None:
        """Create the parameters: ``hidden_dim`` wide inside, ``dim`` features per person."""
        super().__init__()
        self.net = nn.Sequential(nn.Linear(5, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, dim), nn.ReLU())
        self.dim = dim

    def forward(self, position: Tensor, moved: Tensor, heading: Tensor, crowd: Crowd) -> Tensor:
        """Return the features (P, dim), never negative.

        Positions and last displacements (P, 2), metres; ``heading`` (P, 2) are unit vectors.
        """

        def seen(me: Tensor, them: Tensor) -> Tensor:
            away = geometry.unrotate(position[them] - position[me], heading[me])
            relative = geometry.unrotate(moved[them] - moved[me], heading[me])
            distance = (away.square().sum(-1, keepdim=True) + 1e-8).sqrt()
            near = REACH / (REACH + distance)
            return self.net(torch.cat((near * away / REACH, relative, near), -1))

        return crowd.most_of_others(seen, position, position.new_zeros(position.shape[0], self.dim))
