"""Borders of walls as line segments, and the few of them that matter to each person."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.constants import BUCKET, HALF
from pedzoo.maps.grid import OccupancyGrid, Unknown

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # right, up, left, down: a left turn adds one


def borders(occupied: NDArray[np.bool_]) -> list[Numbers]:
    """Return the borders between occupied and free cells (H, W): corners between straight runs (V, 2).

    They are columns and rows in whole cells. Walls lie to the left: solids run counter-clockwise, free spaces
    inside them clockwise. The world outside the map is free, so walls that touch its border are closed there.
    Solids that touch at a corner only are polygons of their own: OpenCV's contours would join them.
    """
    solid = np.pad(occupied, 1).astype(np.int8)
    up, right = np.diff(solid, axis=0)[:, 1:-1], np.diff(solid, axis=1)[1:-1]
    width = occupied.shape[1] + 1

    # The edge that leaves each lattice point (row, column) in each direction, with the wall on its left.
    leaves = np.zeros((occupied.shape[0] + 1, width, 4), dtype=bool)
    leaves[:, :-1, 0] = up == 1
    leaves[:, 1:, 2] = up == -1
    leaves[:-1, :, 1] = right == -1
    leaves[1:, :, 3] = right == 1
    leaves = leaves.reshape(-1, 4)
    point, heading = np.nonzero(leaves)
    number = np.full(leaves.shape, -1)
    number[leaves] = np.arange(len(point))

    # Left first where two edges go on: solids that touch at a corner stay apart.
    end = point + _STEPS[heading, 0] + width * _STEPS[heading, 1]
    options = np.stack([number[end, (heading + turn) % 4] for turn in (1, 0, -1)])
    following = np.take_along_axis(options, (options >= 0).argmax(0)[None], axis=0)[0]
    corner = np.empty(len(end), dtype=bool)  # does an edge start where the border turns?
    corner[following] = heading[following] != heading

    places = np.column_stack((point % width, point // width))
    polygons, seen, successors = [], np.zeros(len(point), dtype=bool), following.tolist()
    for first in corner.nonzero()[0].tolist():
        if seen[first]:
            continue
        cycle, edge = [first], successors[first]
        while edge != first:
            cycle.append(edge)
            edge = successors[edge]
        seen[cycle] = True
        polygons.append(places[[edge for edge in cycle if corner[edge]]])
    return polygons


def outlines(occupied: NDArray[np.bool_], tolerance: float = 0.5) -> list[Floats]:
    """Return the `borders` (V, 2), simplified by ``tolerance`` cells at most (Douglas and Peucker, 1973).

    Walls that would lose their area, or turn inside out, stay exact.
    """
    import cv2

    result = []
    for border in borders(occupied):
        exact = short = border.astype(np.float64)
        if tolerance > 0:
            corners = exact.astype(np.float32)[:, None]
            short = np.asarray(cv2.approxPolyDP(corners, tolerance, closed=True), dtype=np.float64)[:, 0]
        result.append(short if len(short) > 2 and signed_area(short) * signed_area(exact) > 0 else exact)
    return result


def signed_area(polygon: Floats) -> float:
    """Return the area inside a polygon (V, 2), positive if it runs counter-clockwise."""
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def without_hollows(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.bool_]:
    """Return the walls (H, W) of a floor plan, filled up where no body fits between walls.

    Scanned walls are often two thin lines with nothing between; the far one would push through the near one.
    """
    from scipy.ndimage import label, maximum

    # the world around the map is free and wide
    distance = np.pad(grid.signed_distance(unknown), 1, constant_values=np.inf)
    parts, count = cast("tuple[NDArray[np.int32], int]", label(distance > 0))
    widest = np.asarray(maximum(distance, parts, np.arange(count + 1)))
    return grid.occupied(unknown) | (widest < BODY_RADIUS)[parts][1:-1, 1:-1]


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


_NO_SEGMENT = np.array([[0.0, 0, 1, 0, 1, -1, 0, -1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1]])  # sums stay finite


def edges(corner: Floats, convex_from: float = 0.0, *neighbors: Numbers) -> Floats:
    """Return the segments (V, 18) that begin at the corners (V, 2) of an outline, in the map's frame, metres.

    Of each: start (2), unit direction (2) and length. In its own frame, x along it and y to its left, where
    the wall is: unit directions of the segment before, backwards, and of the one after (2 each). Their x is
    turned round: both lead away from it to the left. Whether its corners are convex, 1 or 0 (2). In the map's
    frame again: end (2), unit directions of the segments before and after (2 each), length of the one before.

    Args:
        corner: Of a closed polygon, walls to the left.
        convex_from: Sine of the turn from which on a corner is convex.
        neighbors: Which corners follow and precede (V,); none for those of one polygon.
    """
    number = np.arange(len(corner))
    following, previous = neighbors or (np.roll(number, -1), np.roll(number, 1))
    end = corner[following]
    length = np.linalg.norm(end - corner, axis=1)
    way = (end - corner) / length[:, None]
    before, after = way[previous], way[following]
    convex = before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0] >= convex_from
    left = np.column_stack((-way[:, 1], way[:, 0]))
    legs = [-(before * way).sum(1), -(before * left).sum(1), -(after * way).sum(1), (after * left).sum(1)]
    columns = corner, way, length, *legs, convex, convex[following], end, before, after, length[previous]
    return np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """All segments of R maps, and which of them can matter in each bucket; row -1 means "no map".

    Attributes:
        segments: Columns of `edges` in rows (18, S + 1). The last one stands for none.
        lookup: Arrays that compiled loops read: the segments in single precision; the numbers of candidates,
            bucket after bucket, those nearest to its middle first (C,) int32; where each bucket's begin
            (buckets + 1,) int32; smallest x and y of each map's buckets (2, R + 1) float32, metres; number of
            each map's first bucket, and how many lie along x and y (3, R + 1) int32.
        reach: Metres up to which the candidates are complete.
        most: How many segments a position gets at most.
    """

    segments: Tensor
    lookup: tuple[NDArray[Any], ...]
    reach: float
    most: int

    @classmethod
    def build(cls, maps: Sequence[Floats], reach: float, most: int | None) -> SegmentTable:
        """Return the table of the segments (S, 18) of each map; see `edges` and `Walls.segments`."""
        segments = np.concatenate([*maps, _NO_SEGMENT]).T.copy()
        lists, counts, lows, sizes, before = [np.zeros(0, np.int32)], [np.zeros(0, np.int64)], [], [], 0
        for own in maps:
            low = own[:, :2].min(0) - reach if len(own) else np.zeros(2)
            high = own[:, :2].max(0) + reach if len(own) else np.zeros(2)
            size = np.ceil((high - low) / BUCKET).astype(np.int64)
            numbers, count = _bucket_lists(segments[:5, before : before + len(own)], low, size, reach, most)
            lists.append(numbers + np.int32(before))
            before += len(own)
            counts.append(count)
            lows.append(low)
            sizes.append(size)
        count = np.concatenate(counts)
        width = int(count.max(initial=0))
        first = np.cumsum([0, *map(len, counts[1:])])
        lookup = (
            segments.astype(np.float32),
            np.concatenate(lists),
            np.cumsum(np.append(0, count)).astype(np.int32),
            np.array([*lows, np.zeros(2)], dtype=np.float32).T.copy(),
            np.column_stack((first, [*sizes, np.zeros(2)])).astype(np.int32).T.copy(),
        )
        return cls(torch.from_numpy(segments), lookup, reach, width if most is None else min(most, width))

    def to(self, device: torch.device, dtype: torch.dtype) -> SegmentTable:
        """Return the table for positions of a dtype on a device; the look-up stays on the host."""
        return replace(self, segments=self.segments.to(device, dtype))

    def near(self, points: Tensor, row: Tensor, pose: Tensor, reach: Tensor) -> Segments:
        """Return the `nearest` segments of scene positions (N, 2) on maps ``row``, in poses (N, 4)."""
        cos, sin, mirror, shift = pose[:, 0].cos(), pose[:, 0].sin(), pose[:, 1], pose[:, 2:]
        x, y = (points - shift).unbind(1)
        place = torch.stack((cos * x + sin * y, (cos * y - sin * x) * mirror))
        number, valid = self.nearest(place, row, reach)
        parts = self.segments[:11].index_select(1, number.flatten()).unflatten(1, number.shape)
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

    @torch.no_grad()
    def nearest(self, place: Tensor, row: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
        """Return the nearest segments (K, N) long that positions (2, N) are outside of and within reach.

        The nearest are first; others stand for none, and the second answer says which of the K there are (K,
        N), 1 or 0. ``reach`` (N,) is at most the table's, metres. They are looked up by compiled loops, on
        the host and in single precision.
        """
        from pedzoo.maps.walls_numba import nearest

        number = torch.full((self.most, len(row)), self.segments.shape[1] - 1)
        squared = torch.full((self.most, len(row)), math.inf)
        asked = (part.cpu().numpy() for part in (place.detach().float(), row, reach.detach().float()))
        used = nearest(*asked, *self.lookup, number.numpy(), squared.numpy())
        there = torch.lt(squared[:used], math.inf, out=torch.empty(0))
        return number[:used].to(place.device), there.to(place)


def _bucket_lists(
    segments: Floats, low: Floats, size: Numbers, reach: float, most: int | None
) -> tuple[NDArray[np.int32], Numbers]:
    """Return which segments (5, S) matter in each bucket, nearest to its middle first, and how many (M,).

    ``low`` are the smallest x and y of the buckets, metres, and ``size`` says how many lie along x and y.
    """
    start, way, length = segments[:2], segments[2:4], segments[4]
    ends, low = np.sort((start, start + way * length), axis=0), low[:, None]
    first = np.maximum(((ends[0] - reach - low) / BUCKET).astype(np.int64), 0)
    last = np.minimum(((ends[1] + reach - low) / BUCKET).astype(np.int64) + 1, size[:, None])
    wide, high = np.maximum(last - first, 0)
    parts, area = [], wide * high
    for some in np.array_split(np.arange(len(length)), len(length) // 500 + 1):
        s = np.repeat(some, area[some])
        at = np.arange(len(s)) - np.repeat(np.cumsum(area[some]) - area[some], area[some])
        at = np.stack((at % wide[s], at // wide[s])) + first[:, s]
        x, y = low + (at + 0.5) * BUCKET - start[:, s]
        along, left = x * way[0, s] + y * way[1, s], way[0, s] * y - way[1, s] * x
        gap = np.hypot(along - along.clip(0, length[s]), left)
        keep = (gap <= reach + HALF) & (left < HALF)
        parts.append((at[0, keep] + size[0] * at[1, keep], gap[keep], left[keep], s[keep]))
    bucket, gap, left, number = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.lexsort((gap, bucket))
    bucket, gap, number = bucket[order], gap[order], number[order]
    count = np.bincount(bucket, minlength=size[0] * size[1])
    if most is not None:
        # every point of a bucket has so many segments outside of it, none farther than the last of them
        sure = np.append(0, np.cumsum(left[order] < -HALF))
        enough = np.flatnonzero(sure[1:] - np.repeat(sure[np.cumsum(count) - count], count) >= most)
        limit, (full, at) = np.full(len(count), np.inf), np.unique(bucket[enough], return_index=True)
        limit[full] = gap[enough[at]] + 2 * HALF
        keep = gap <= limit[bucket]
        number, count = number[keep], np.bincount(bucket[keep], minlength=len(count))
    return number.astype(np.int32), count
