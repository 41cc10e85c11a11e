"""Which points of the walls push a person.

The paper lets every border act with its nearest point (eq. 5), and leaves open what one border is. On a floor
plan that is no matter of course: one wall is many cells, a room is one outline, and the nearest point of a
doorway's outline flips from jamb to jamb. Here every *local minimum* of the distance along the outlines acts:
a straight wall once, into however many pieces it is cut, a convex corner once, both jambs of a doorway, both
sides of a corridor, both walls of a room's corner.

Where an outline bends a little towards the person there are two minima in almost the same place, and one of
them vanishes as the person walks on, in the corner between them, which is a local *maximum*. So that the
force neither doubles nor jumps there, the maximum acts, too, with the opposite sign: where it swallows a
minimum both have the same distance and direction. It counts in full while the nearest points of its two
segments lie within 60 degrees of each other, as seen by the person, and not at all from 90 degrees on: the
two walls of a room's corner are two borders.

Borders do not hide each other, and two obstacles are two however narrow the gap between them.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.outlines import outlines
from pedzoo.sim.orca.vectors import cross, dot
from pedzoo.sim.social_force.border_table import BorderTable
from pedzoo.sim.social_force.forces import direction
from pedzoo.types import BODY_RADIUS


class WallPoints(NamedTuple):
    """M points of walls that act on people.

    Attributes:
        person: Whom each acts on (M,) long.
        offset: From the point to the person (2, M), metres, in the frame of the floor plan.
        weight: 1 for minima of the distance, down to -1 for maxima (M,).
    """

    person: Tensor
    offset: Tensor
    weight: Tensor


class Borders:
    """The walls of a bank's floor plans: outlines that are simplified by half a cell at most.

    Attributes:
        bank: The floor plans; their unknown cells count as it says.
        reach: Metres within which walls act.
    """

    def __init__(self, bank: MapBank, reach: float) -> None:
        """Take the floor plans; nothing is computed before the first look-up."""
        self.bank = bank
        self.reach = reach
        self._known: dict[tuple[torch.device, torch.dtype], tuple[MapBank, BorderTable]] = {}

    def near(self, place: Tensor, map_id: Tensor) -> WallPoints:
        """Return the points of walls that act on people; none without a map.

        Args:
            place: Where people are on their floor plans (2, N), metres; differentiable.
            map_id: Floor plan of each (N,) long, -1 for none.

        Raises:
            UserError: A ``map_id`` is of another bank.
        """
        bank, table = self._look_up(place)
        person, segment = table.look(place, bank.index(map_id))
        wall = table.segments.index_select(1, segment)
        start, end, along, before, after = wall[:10].split(2)
        at = place.index_select(1, person)
        off, off_end = at - start, at - end
        t, t_end, past = dot(off, along), dot(off_end, along), dot(off, before)
        offset = off - along * t.clamp_min(0).minimum(dot(end - start, along))

        # A foot inside the segment; or its start, where the segment before has no foot either. A pointed end
        # may be seen from one side only: then it is the start of no segment that the person is outside of.
        foot, first = (t > 0) & (t_end < 0), (t <= 0) & (past >= 0)
        last = (t_end >= 0) & (dot(off_end, after) <= 0) & (cross(after, off_end) >= 0)
        kept = (foot | first | last).nonzero()[:, 0]
        points = WallPoints(
            person.index_select(0, kept), offset.index_select(1, kept), torch.ones_like(t[: len(kept)])
        )

        hollow = ((wall[11] > 0) & (t > 0) & (past < 0) & (cross(before, off) < 0)).nonzero()[:, 0]
        if not len(hollow):
            return points
        off, before, nearest = (part.index_select(1, hollow) for part in (off, before, offset))
        length = wall[10].index_select(0, hollow)
        nearest_before = off + before * (-dot(off, before)).minimum(length)
        likeness = dot(direction(nearest), direction(nearest_before))
        return WallPoints(
            torch.cat((points.person, person.index_select(0, hollow))),
            torch.cat((points.offset, off), dim=1),
            torch.cat((points.weight, -(2 * likeness).clamp(0, 1))),
        )

    def _look_up(self, place: Tensor) -> tuple[MapBank, BorderTable]:
        """Return bank and segments for people like these."""
        key = place.device, place.dtype
        if key not in self._known:
            outlined = [_polygons(grid, self.bank.unknown) for grid in self.bank.grids]
            table = BorderTable.build(outlined, self.reach).to(*key)
            self._known[key] = self.bank.to(place.device), table
        return self._known[key]


def _polygons(grid: OccupancyGrid, unknown: Unknown) -> list[NDArray[np.float64]]:
    """Return the outlines (V, 2) of walls in the map's frame, without hollows in which nobody could stand.

    Scanned walls are often two thin lines with nothing between; the far one would push through the near one.
    """
    from scipy.ndimage import label, maximum

    # the world around the map is free and wide
    distance = np.pad(grid.signed_distance(unknown), 1, constant_values=np.inf)
    parts, count = cast("tuple[NDArray[np.int32], int]", label(distance > 0))
    widest = np.asarray(maximum(distance, parts, np.arange(count + 1)))
    hollow = (widest < BODY_RADIUS)[parts][1:-1, 1:-1]
    return [grid.cells_to_map(polygon - 0.5) for polygon in outlines(grid.occupied(unknown) | hollow)]
