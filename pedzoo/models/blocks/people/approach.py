"""Features of the others around a person: where they are, and how close and how soon they come."""

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core import geometry
from pedzoo.core.types import STEP_SECONDS
from pedzoo.models.blocks.people.crowd import Crowd

REACH, NEAR = 2.0, 4.0
"""Metres: the scales of distances of both poolings. Farther people look more and more alike."""

HORIZON = 4.0
"""Seconds: closest approaches farther ahead count as so far ahead."""


class ApproachPooling(nn.Module):
    """Max-pools an embedding of all others: where they are, how they move, how close they come.

    All features are in the frame of the observing person: neither turning the scene nor the order of people
    changes them. Closest approach is that of two people who both keep their velocities, as in Olivier et
    al., "Minimal predicted distance", Gait & Posture 2012. A person alone has features of zero.
    """

    pairs: ClassVar[int] = 8
    """Features of a pair of people."""

    def __init__(self, state_dim: int, dim: int, hidden_dim: int = 64) -> None:
        """Create the parameters: ``state_dim`` is the width of a person's state, ``dim`` of the result."""
        super().__init__()
        self.pair = nn.Linear(self.pairs, hidden_dim)
        self.other = nn.Linear(state_dim, hidden_dim, bias=False)
        self.output = nn.Linear(hidden_dim, dim)
        self.dim = dim

    def forward(
        self, position: Tensor, moved: Tensor, heading: Tensor, state: Tensor, crowd: Crowd
    ) -> Tensor:
        """Return the features (P, dim), never negative; arguments as of `RelativePooling`.

        ``state`` (P, state_dim) are features of the people seen.
        """
        other = self.other(state)

        def seen(me: Tensor, them: Tensor) -> Tensor:
            pair = _features(position[them] - position[me], moved[them] - moved[me], heading[me])
            inner = functional.relu(self.pair(pair) + other[them])
            return functional.relu(self.output(inner))

        return crowd.most_of_others(seen, position, self.dim)


class OwnFramePooling(ApproachPooling):
    """Social GAN's pooling (Gupta et al., CVPR 2018, eq. 2) for states that are in each person's own frame.

    Such states no longer say whither people walk: the relative displacement stands beside the relative
    position. What others say fades with their distance, as beyond training crowds differ in size. No feature
    can die: `softplus` has a slope everywhere. A person alone has features of zero.
    """

    pairs = 5

    def forward(
        self, position: Tensor, moved: Tensor, heading: Tensor, state: Tensor, crowd: Crowd
    ) -> Tensor:
        """Return the features (P, dim), above zero near others; arguments as of `ApproachPooling`."""
        other = self.other(state)

        def seen(me: Tensor, them: Tensor) -> Tensor:
            away = geometry.unrotate(position[them] - position[me], heading[me])
            relative = geometry.unrotate(moved[them] - moved[me], heading[me])
            near = REACH / (REACH + (away.square().sum(-1, keepdim=True) + 1e-6).sqrt())
            pair = torch.cat((near * away, near * relative / STEP_SECONDS, near), -1)
            inner = functional.relu(self.pair(pair) + other[them])
            return near * functional.softplus(self.output(inner))

        return crowd.most_of_others(seen, position, self.dim)


def _features(away: Tensor, moved: Tensor, heading: Tensor) -> Tensor:
    """Return features of pairs (..., 8) from relative positions and displacements (..., 2), metres.

    ``heading`` (..., 2) is that of the observing person.
    """
    velocity = moved / STEP_SECONDS
    distance = (away.square().sum(-1, keepdim=True) + 1e-6).sqrt()
    near = REACH / (REACH + distance)
    # standing still side by side is no approach: the small number keeps its time from mattering
    time = -(away * velocity).sum(-1, keepdim=True) / (velocity.square().sum(-1, keepdim=True) + 0.01)
    soon = time.clamp(0.0, HORIZON)
    closest = away + soon * velocity
    least = (closest.square().sum(-1, keepdim=True) + 1e-6).sqrt()
    urgent = near * REACH / (REACH + least) * torch.exp(-soon / 2)
    vectors = torch.stack((near * away / REACH, near * velocity, near * closest / REACH), -2)
    turned = geometry.unrotate(vectors, heading.unsqueeze(-2).expand_as(vectors))
    return torch.cat((turned.flatten(-2), near, urgent), -1)


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
            near = NEAR / (NEAR + distance)
            return self.net(torch.cat((near * away / NEAR, relative, near), -1))

        return crowd.most_of_others(seen, position, self.dim)
