"""Robots near people: distances, intrusions, forces. See `pedzoo.metrics.robots` for E, N, R, T.

Positions are (E, R, T, 2) and (E, N, T, 2), metres. ``there`` (E, R, T): the robot is on its way; ``present``
(E, N, T): the person is there. ``reach`` (E, R, N) are sums of radii, ``distance`` (E, R, N, T) is between
centres, metres.
"""

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS

SPACES = {"intimate": (-torch.inf, 0.45), "personal": (0.45, 1.2), "social": (1.2, 3.6)}
"""Spaces of proxemics (Hall 1966), metres, as in HuNav."""

DISCOMFORT = 0.2
"""Metres between bodies within which people feel uncomfortable (CrowdNav's)."""

FUTURE_STEPS, FUTURE_SECONDS = 5, 0.25
"""How far ahead people's ways are that robots should keep clear of (CrowdNav++'s)."""

SOCIAL_FACTOR, LAMBDA, GAMMA, ANGULAR, VELOCITY = 2.1, 2.0, 0.35, 2.0, 3.0
"""Parameters of the social force (HuNav's): its factor, lambda, gamma, n and n'."""


def distances(robots: Tensor, people: Tensor, there: Tensor, present: Tensor) -> Tensor:
    """Return distances between centres (E, R, N, T), metres; infinite where either is not there."""
    apart = (robots.unsqueeze(2) - people.unsqueeze(1)).norm(dim=-1)
    return apart.masked_fill(~(there.unsqueeze(2) & present.unsqueeze(1)), torch.inf)


def in_space(distance: Tensor, radius: Tensor, space: str) -> Tensor:
    """Return when the nearest person is in a space, one of `SPACES`, of the robot (E, R, T) bool (HuNav).

    The share of a robot's points is HuNav's intrusion: distances from the robot's body to people's centres.
    """
    low, high = SPACES[space]
    away = distance.amin(2) - radius.unsqueeze(-1)
    return (away >= low) & (away < high)


def intrusions(robots: Tensor, people: Tensor, present: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Return when robots are where people are about to go (E, R, T) bool, and how near (E, R, T), metres.

    At point t a robot intrudes whose body touches a person's body of 0.25, 0.5, ... 1.25 s later. The share
    of an episode's points, mean over episodes, is CrowdNav++'s intrusion ratio. The distance is the least one
    between centres of those that touch, infinite for none; its mean over intrusions is CrowdNav++'s, too.
    There people's future is simulated ahead; here it is what they really did until the episode's end.
    """
    points = people.shape[2]
    least = torch.full(robots.shape[:3], torch.inf)
    for step in range(1, FUTURE_STEPS + 1):
        ahead = step * FUTURE_SECONDS / TRACE_SECONDS
        first, share = int(ahead), ahead - int(ahead)
        last = first + (share > 0)
        if last >= points:
            break
        later = people[:, :, first : points - last + first]
        later = torch.lerp(later, people[:, :, last:], share)
        apart = (robots[:, :, : points - last].unsqueeze(2) - later.unsqueeze(1)).norm(dim=-1)
        there = present[:, :, last:].unsqueeze(1) & (apart < reach.unsqueeze(-1))
        nearest = apart.masked_fill(~there, torch.inf).amin(2)
        least[..., : points - last] = torch.minimum(least[..., : points - last], nearest)
    return least.isfinite(), least


def social_force(apart: Tensor, velocity: Tensor) -> Tensor:
    """Return the amounts of the social force between pairs (...), m/s^2: of either on the other.

    The model of Moussaid et al. (Proc. R. Soc. B 276, 2009) with the parameters of HuNav, which sums it over
    people and steps for ``social_force_on_robot`` and ``social_force_on_agents``. ``d`` is the distance,
    ``e`` the direction, ``D = 2 v + e``, ``B = 0.35 |D|``, ``a`` the angle from e to D. Then the force is
    ``2.1 sqrt(exp(-d/B - (3 B a)^2)^2 + exp(-d/B - (2 B a)^2)^2)``, without the second term where a is 0.

    Args:
        apart: From one to the other (..., 2), metres.
        velocity: Of the one less that of the other (..., 2), m/s.
    """
    distance = apart.norm(dim=-1)
    toward = torch.nn.functional.normalize(apart, dim=-1)
    interaction = LAMBDA * velocity + toward
    reach = GAMMA * interaction.norm(dim=-1)
    cross = toward[..., 0] * interaction[..., 1] - toward[..., 1] * interaction[..., 0]
    angle = torch.atan2(cross, (toward * interaction).sum(-1))
    decay = -distance / reach.clamp_min(1e-9)
    ahead = (decay - (VELOCITY * reach * angle) ** 2).exp()
    aside = (decay - (ANGULAR * reach * angle) ** 2).exp().where(angle != 0, 0.0)
    return SOCIAL_FACTOR * torch.hypot(ahead, aside)


def drives_into(apart: Tensor, robot: Tensor, person: Tensor) -> Tensor:
    """Return where it is the robot that drives into the person (...) bool: it moves faster towards them.

    After SEAN 2.0's "robot on person collision" (Tsoi et al., RA-L 2022), which HuNav has, too. ``apart`` is
    from the robot to the person, metres.
    """
    return (robot * apart).sum(-1) >= -(person * apart).sum(-1)
