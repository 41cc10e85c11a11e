"""The carrot: the point ahead on agents' paths that they walk to."""

import math

import torch
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.walls.local_walls import LocalWalls

_SPACING = 0.3
"""Metres between the points looked at: with the clearance around each, no wall fits between two of them."""

_PARTS = 3
"""How many parts of the path beyond the waypoint are tried: all of it, a half and a quarter."""


def seen_beyond(
    walls: LocalWalls, home: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor, farthest: float
) -> Tensor:
    """Return how far beyond the waypoint agents see their carrot (*E): ``rest``, a half, a quarter, or not.

    It is seen if points of the straight line to it, 0.3 m apart, keep a body's radius from walls; on coarse
    floor plans up to 0.71 cells more. Places ``home`` and ``waypoint`` (2, *E) are in the map's frame, and
    ``beyond`` (2, *E) is where the path goes from the waypoint. No line is longer than ``farthest``, metres.
    """
    end = waypoint + beyond * rest
    spacing = _SPACING / torch.hypot(*(end - home)).clamp_min(_SPACING)
    begin, corner, end = walls.cells(torch.stack((home, waypoint, end), dim=1)).unbind(1)
    # made on the device: a list of numbers would be copied there at every step
    parts = 0.5 ** torch.arange(_PARTS, device=rest.device).view(-1, *[1] * rest.dim())
    number = torch.arange(1, math.ceil(farthest / _SPACING) + 1, device=rest.device)
    share = (number.view(-1, *[1] * rest.dim()) * spacing).clamp_max(1)
    to = corner.unsqueeze(1) + parts * (end - corner).unsqueeze(1) - begin.unsqueeze(1)
    points = begin[:, None, None] + share.unsqueeze(0).unsqueeze(1) * to.unsqueeze(2)
    least = walls.least_at(points.flatten(1, 2)).unflatten(0, (_PARTS, -1)).amin(1)
    seen = least >= BODY_RADIUS
    return rest * (parts * seen).amax(0)
