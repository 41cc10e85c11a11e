"""Which points of the walls push a person.

The paper lets every border act with its nearest point (eq. 5), and leaves open what one border is. On a
floor plan one wall is many cells, a room is one outline, and the nearest point of a doorway flips from jamb
to jamb. Here every *local minimum* of the distance along the outlines acts: a straight wall once, in however
many pieces, a convex corner once, both jambs of a doorway, both sides of a corridor, both walls of a room's
corner.

Where an outline bends a little towards the person there are two minima in almost the same place. One of them
vanishes as the person walks on, in the corner between them, a local *maximum*. The maximum acts with the
opposite sign, so that the force neither doubles nor jumps there: both have the same distance and direction
when they vanish. It counts in full while the nearest points of its two segments lie within 60 degrees of
each other, as seen by the person, and not at all from 90 degrees on: the two walls of a room's corner are
two borders.

Borders do not hide each other, and two obstacles are two for every gap between them.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.maps.walls.segment_table import SegmentTable
from pedzoo.policies.orca.vectors import cross, dot
from pedzoo.policies.social_force.forces import direction


class WallPoints(NamedTuple):
    """M points of walls for each of N people.

    Attributes:
        offset: From the point to the person (2, M, N), metres, in the frame of the floor plan.
        weight: 1 for minima of the distance, down to -1 for maxima, 0 for points that do not act (M, N).
    """

    offset: Tensor
    weight: Tensor


def wall_points(table: SegmentTable, place: Tensor, row: Tensor) -> WallPoints:
    """Return the points of walls, within the table's reach, that act on people at ``place`` (2, N), metres.

    Differentiable with respect to ``place``. Without a map, row -1, there are none.
    """
    number, valid = table.nearest(place, row, place.new_full(row.shape, table.reach))
    wall = table.segments.index_select(1, number.flatten()).unflatten(1, number.shape)
    start, along, own, end, before, after, length_before = wall.split((2, 2, 7, 2, 2, 2, 1))
    length, convex = own[0], own[5]
    seen = valid > 0
    off, off_end = (torch.where(seen, place.unsqueeze(1) - corner, 0) for corner in (start, end))
    # the end of a segment is the start of the next, to the last bit: so are these of both
    t, t_end, past = dot(off, along), dot(off_end, along), dot(off, before)
    offset = off - along * t.clamp_min(0).minimum(length)
    near = seen & (dot(offset, offset) < table.reach**2)

    # A foot inside the segment; or its start, where the segment before has no foot either. A pointed end
    # may be seen from one side only: then it is the start of no segment that the person is outside of.
    foot, first = (t > 0) & (t_end < 0), (t <= 0) & (past >= 0)
    last = (t_end >= 0) & (dot(off_end, after) <= 0) & (cross(after, off_end) >= 0)
    acts = near & (foot | first | last)

    hollow = near & (convex == 0) & (t > 0) & (past < 0) & (cross(before, off) < 0)
    nearest_before = off + before * (-past).minimum(length_before[0])
    likeness = dot(*(direction(torch.where(hollow, part, 0)) for part in (offset, nearest_before)))
    weight = torch.where(hollow, -(2 * likeness).clamp(0, 1), 0)
    return WallPoints(torch.cat((offset, off), dim=1), torch.cat((acts.to(weight.dtype), weight)))
