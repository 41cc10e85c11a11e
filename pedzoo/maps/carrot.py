"""The carrot: the point ahead on people's ways that they are told to walk to."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.maps.local_walls import LocalWalls
from pedzoo.maps.planar import columns

BODY_CLEARANCE = 0.15
"""Metres that the line to the carrot keeps from walls: a body's radius."""

_SPACING = 0.3
"""Metres between the points looked at: with the clearance around each, no wall fits between two of them."""

_PARTS = (1.0, 0.5, 0.25)
"""How much of the way beyond the waypoint is tried."""

_ROUGH = torch.tensor([1 / 8, 3 / 8, 5 / 8, 7 / 8])
"""Points of a line; no other one is farther than an eighth of it from the nearest of these."""


def seen_beyond(walls: LocalWalls, home: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor) -> Tensor:
    """Return how far beyond the waypoint people see their carrot (P,): ``rest``, a half, a quarter, or not.

    It is seen if points of the straight line to it, 0.3 m apart, keep a body's radius from walls; on coarse
    floor plans up to 0.71 cells more.

    Args:
        walls: As people see them from their positions on the map.
        home: Where people are, in the map's frame (2, P), metres.
        waypoint: Their next waypoints (2, P), which they see.
        beyond: Unit vectors of where the way goes from there (2, P).
        rest: Metres that the carrot is beyond the waypoint (P,), not negative.
    """
    who = (rest > 0).nonzero()[:, 0]
    if not len(who):
        return rest
    rest, walls = rest.clone(), walls.rows(who)
    begin, corner = (of.index_select(1, who) for of in (home, waypoint))
    end = corner + beyond.index_select(1, who) * rest.index_select(0, who)
    # points are a fixed way apart, however far others look: an answer is the same whoever else asks
    length = torch.hypot(*(end - begin))
    spacing = _SPACING / length.clamp_min(_SPACING)
    line = walls.cells(torch.stack((begin, corner, end), dim=1))
    quarters = walls.quarters
    # where there is much room a few points answer
    rough = torch.addcmul(line[:, :1], _ROUGH.to(line).unsqueeze(1), line[:, 2:] - line[:, :1])
    narrow = (quarters.least(rough).amin(0) < length / (2 * len(_ROUGH)) + BODY_CLEARANCE).nonzero()[:, 0]
    who, spacing, quarters, line = who[narrow], spacing[narrow], quarters.rows(narrow), columns(line, narrow)
    for part in _PARTS:
        if not len(who):
            return rest
        samples = int((1 / spacing.min()).ceil())
        steps = torch.arange(1, samples + 1, device=who.device).unsqueeze(1) * spacing
        begin, corner, end = line.split(1, dim=1)
        points = torch.addcmul(begin, steps.clamp_max_(1), corner + part * (end - corner) - begin)
        hidden = quarters.least(points).amin(0) < BODY_CLEARANCE
        if part < 1:
            seen = who[~hidden]
            rest[seen] = rest[seen] * part
        still = hidden.nonzero()[:, 0]
        who, spacing, quarters = who[still], spacing[still], quarters.rows(still)
        line = columns(line, still)
    rest[who] = 0
    return rest
