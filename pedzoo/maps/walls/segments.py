"""Walls as line segments, and the few of them that matter to each person."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

if TYPE_CHECKING:
    from pedzoo.maps.bank import MapBank


FASTEST = 4.0
"""m/s: walls are looked up as far as they matter to agents of this speed, so that no tensor has to say it."""


class Segments(NamedTuple):
    """Up to K segments of walls near each of N people, nearest first, seen from the person.

    Each has a frame of its own around the person: x along the segment, y towards the wall, so that both
    corners are at y = ``line_distance``. Values of corners come twice. The left corner is at x = -``along``.
    The right one has x turned round, at x = ``along`` - ``length``, so that both are treated alike.

    Attributes:
        along: How far the person is past the left corner (K, N), metres.
        line_distance: How far the person is from the segment's line (K, N), more than 0.
        length: Of the segment (K, N).
        direction: Unit vector from the left to the right corner, in the scene (2, K, N).
        side: 1 where the wall is to the left of ``direction``, -1 in mirrored scenes (1, N).
        neighbor: Unit vectors along the neighbouring segments, away from each corner (x and y, corner, K, N).
        convex: Whether the corners are convex, 1 or 0 (corner, K, N).
        valid: Which of the K there are (K, N), 1 or 0; the others hold any segment.
    """

    along: Tensor
    line_distance: Tensor
    length: Tensor
    direction: Tensor
    side: Tensor
    neighbor: Tensor
    convex: Tensor
    valid: Tensor

    def select(self, people: Tensor) -> Segments:
        """Return those of some people (M,) long."""
        return Segments(*(part.index_select(-1, people) for part in self))

    def nearest(self, most: int) -> Segments:
        """Return at most so many of each person."""
        return Segments(*(part[..., :most, :] for part in self))


class WallSegments:
    """The segments of a bank's walls that matter to each person; made at no cost, the bank keeps the tables.

    Attributes:
        bank: The floor plans; their unknown cells count as it says.
        most: Segments that are returned for one person at most.
        reach: Metres up to which segments are found.
    """

    def __init__(self, bank: MapBank, most: int = 16, reach: float = 2 * FASTEST) -> None:
        """Take the floor plans; nothing is computed before the first look-up."""
        self.bank, self.most, self.reach = bank, most, reach

    def near(self, points: Tensor, map_id: Tensor, pose: Tensor, reach: Tensor | float) -> Segments:
        """Return the nearest segments of each person that they are outside of, nearest first.

        Without a map there are none.

        Args:
            points: Scene positions (N, 2), metres.
            map_id: Floor plan of each (N,) long, -1 for none.
            pose: Scene poses (N, 4).
            reach: Metres (N,) or one number within which a segment has to come; at most that of the look-up.

        Raises:
            UserError: A ``map_id`` is of another bank.
        """
        reach = torch.as_tensor(reach, dtype=points.dtype, device=points.device).expand(len(points))
        bank = self.bank.to(points.device)
        table = bank.walls.segments(self.reach, self.most, dtype=points.dtype)
        cos, sin, mirror, shift = pose[:, 0].cos(), pose[:, 0].sin(), pose[:, 1], pose[:, 2:]
        x, y = (points - shift).unbind(1)
        place = torch.stack((cos * x + sin * y, (cos * y - sin * x) * mirror))
        number, valid = table.nearest(place, bank.index(map_id), reach)
        parts = table.segments[:11].index_select(1, number.flatten()).unflatten(1, number.shape)
        start, along, length, legs, convex = parts.split((2, 2, 1, 4, 2))
        from_x, from_y = place[:, None] - start
        x, y = along[0], along[1] * mirror
        return Segments(
            along=from_x * along[0] + from_y * along[1],
            line_distance=from_x * along[1] - from_y * along[0],
            length=length[0],
            direction=torch.stack((cos * x - sin * y, sin * x + cos * y)),
            side=mirror[None],
            neighbor=legs.unflatten(0, (2, 2)).transpose(0, 1),
            convex=convex,
            valid=valid,
        )
