"""The carrot: the point ahead on people's ways that they are told to walk to."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from pedzoo.maps.atlas import Atlas
from pedzoo.maps.planar import pairs

BODY_CLEARANCE = 0.15
"""Metres that the line to the carrot keeps from walls: a body's radius."""

_SPACING = 0.3
"""Metres between the points looked at: with the clearance around each, no wall fits between two of them."""

_PARTS = (1.0, 0.5, 0.25)
"""How much of the way beyond the waypoint is tried."""


def seen_beyond(
    distance: Atlas, row: Tensor, home: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor
) -> Tensor:
    """Return how far beyond the waypoint people see their carrot (P,): ``rest``, a half, a quarter, or not.

    It is seen if the straight line to it keeps a body's radius from walls. Beyond a map's border its
    outermost cells go on, and the line is followed to the border's nearest point.

    Args:
        distance: Distances to the nearest wall.
        row: Everybody's map in it (P,), -1 for none.
        home: Where people are, in the map's frame (2, P), metres.
        waypoint: Their next waypoints (2, P), which they see.
        beyond: Unit vectors of where the way goes from there (2, P).
        rest: Metres that the carrot is beyond the waypoint (P,), not negative.
    """
    rest = rest.clone()
    who = torch.nonzero((rest > 0) & (row >= 0))[:, 0]
    if not len(who):
        return rest
    number = row.index_select(0, who)
    a, b, c, d = distance.linear.view(-1, 4).index_select(0, number).unbind(1)
    (right, up), low, high = (
        of.index_select(0, number).t() for of in (distance.shift, distance.low, distance.high)
    )
    begin, corner, way, ahead = (of.index_select(-1, who) for of in (home, waypoint, beyond, rest))
    end = corner + way * ahead
    # points are a fixed way apart, however far others look: an answer is the same whoever else asks
    spacing = _SPACING / (end - begin).square().sum(0).sqrt().clamp_min(_SPACING)
    x, y = torch.stack((begin, corner, end), dim=1)
    begin, corner, end = torch.stack((a * x + b * y + right, c * x + d * y + up)).unbind(1)
    for part in _PARTS:
        way = (corner + part * (end - corner)).clamp(low, high) - begin
        samples = int((1 / spacing.min()).ceil())
        steps = torch.arange(1, samples + 1, device=who.device)[:, None] * spacing
        x, y = torch.addcmul(begin.unsqueeze(1), steps.clamp_max_(1), way.unsqueeze(1))
        lowest = F.grid_sample(distance.image, pairs(x, y)[None], align_corners=True)[0, 0].amin(dim=0)
        hidden = lowest < BODY_CLEARANCE
        if part < 1:
            seen = who[~hidden]
            rest[seen] = rest[seen] * part
        still = torch.nonzero(hidden)[:, 0]
        if not len(still):
            return rest
        who, spacing = who.index_select(0, still), spacing.index_select(0, still)
        begin, corner, end, low, high = (of.index_select(1, still) for of in (begin, corner, end, low, high))
    rest[who] = 0
    return rest
