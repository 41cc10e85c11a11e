"""Wall segments of several maps in coarse buckets, so that everybody looks at a few of them only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

BUCKET = 0.5
"""Metres: the side of a bucket."""

TILE = 8
"""Buckets along the side of a tile; the segments of a tile are found first, then those of its buckets."""

Floats = NDArray[np.float64]

NOWHERE = np.array([[0.0, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 1]])
"""Stands for no segment; it could be one, so that whoever computes with it gets numbers."""


_PLACE = (1 << 31) - 1
"""The bits of a key that tell which candidate it is of."""

_ROUNDED = -1 << 7
"""The bits of a distance that count."""

_AT_ONCE = 1 << 21
"""Candidates, of all people together, that are looked at at once: about 100 MB."""

_FAR = 1e30
"""Squared metres: nobody comes so far."""


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """All segments of R maps, and which of them can matter in each bucket; row -1 means "no map".

    What is seen from a segment is in its own frame: x along it, y to its left, where the wall is.

    Attributes:
        segments: Of each (11, S + 1): start and unit direction in the map's frame; length; unit direction of
            the segment before, backwards, and of the one after, their x turned round so that both lead away
            from it to the left; whether its corners are convex (1 or 0). The last one stands for none.
        candidates: Numbers of segments, bucket after bucket, and as many more as a bucket has at most.
        offset: Where each bucket's candidates begin (buckets + 2,) long; the last bucket is empty.
        corner: Smallest x and y of each map's buckets (2, R + 1), metres.
        buckets: Number of each map's first bucket, and how many lie along x and y (3, R + 1) long.
        reach: Metres up to which the candidates are complete.
    """

    segments: Tensor
    candidates: Tensor
    offset: Tensor
    corner: Tensor
    buckets: Tensor
    reach: float

    @classmethod
    def build(cls, maps: Sequence[Floats], reach: float, most: int) -> SegmentTable:
        """Return the table of the segments of each map.

        Args:
            maps: For each map its segments (S, 12), in its frame: start, end, unit direction, directions of
                the segments before and after, whether the corners at start and end are convex.
            reach: Metres up to which people ask for segments.
            most: How many segments one person gets.
        """
        lists, counts, lows, sizes = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [], []
        for number, own in enumerate(maps):
            low = own[:, :2].min(0, initial=math.inf) - reach if len(own) else np.zeros(2)
            high = own[:, :2].max(0, initial=-math.inf) + reach if len(own) else np.zeros(2)
            size = np.ceil((high - low) / BUCKET).astype(np.int64)
            found, count = _bucket_lists(own, low, size, reach, most)
            lists.append(found + sum(map(len, maps[:number])))
            counts.append(count)
            lows.append(low)
            sizes.append(size)
        count = np.concatenate(counts)
        segments = _seen_from_themselves(np.concatenate([*maps, NOWHERE]))
        spare = np.full(count.max(initial=0), segments.shape[1] - 1)
        first = np.cumsum([0, *(len(count) for count in counts[1:])])
        return cls(
            segments=torch.as_tensor(segments),
            candidates=torch.as_tensor(np.concatenate([*lists, spare]), dtype=torch.long),
            offset=torch.as_tensor(np.cumsum(np.concatenate([[0], count, [0]])), dtype=torch.long),
            corner=torch.as_tensor(np.array([*lows, np.zeros(2)]).T.copy()),
            buckets=torch.as_tensor(np.column_stack((first, [*sizes, np.zeros(2)])).T.copy()).long(),
            reach=reach,
        )

    def to(self, device: torch.device, dtype: torch.dtype) -> SegmentTable:
        """Return the table for people on a device whose positions are of a dtype."""
        whole = {name: getattr(self, name).to(device) for name in ("candidates", "offset", "buckets")}
        return replace(
            self, **whole, segments=self.segments.to(device, dtype), corner=self.corner.to(device, dtype)
        )

    def nearest(self, place: Tensor, row: Tensor, reach: Tensor, most: int) -> tuple[Tensor, Tensor]:
        """Return the nearest segments that people are outside of and within reach of, nearest first.

        Args:
            place: Positions in the maps' frames (2, N), metres.
            row: Which map (N,) long, -1 for none.
            reach: Metres (N,), at most the table's.
            most: So many at most.

        Returns:
            The segments (11, K, N), and which of the K there are (K, N), 1 or 0; the others are any.
        """
        begin, count = self._bucket(place, row)
        candidates = int(count.max()) if len(row) else 0
        if not candidates:
            return self.segments.new_zeros(len(self.segments), 0, len(row)), place.new_zeros(0, len(row))
        chunk = max(1, _AT_ONCE // candidates)
        parts = zip(place.split(chunk, 1), begin.split(chunk), count.split(chunk), strict=True)
        keys = [self._keys(*part, candidates)[:most] for part in parts]
        key = torch.cat(keys, dim=1)
        distance2 = (key >> 31).int().view(torch.float32)
        valid = torch.lt(distance2, (reach * reach).float(), out=place.new_empty(0))
        used = int(valid.amax(1).sum())
        chosen = self.candidates.index_select(0, (begin + (key[:used] & _PLACE)).flatten())
        return self.segments.index_select(1, chosen).view(len(self.segments), used, len(row)), valid[:used]

    def _keys(self, place: Tensor, begin: Tensor, count: Tensor, candidates: int) -> Tensor:
        """Return numbers (C, N) in the order of the distances of people's candidates, ascending.

        The lower bits tell the candidate's place in the bucket, the upper ones the squared distance: floats
        that are not negative are ordered as their bits are. The last of these are left out, so that rounding
        does not choose between two segments of which the common corner is nearest.
        """
        number = torch.arange(candidates, device=place.device)[:, None]
        distance2 = self._distance2(place, (begin + number).flatten()).view(-1, len(count)).float()
        distance2 = distance2.add_(torch.ge(number, count, out=torch.empty_like(distance2)), alpha=_FAR)
        bits = distance2.view(torch.int32).bitwise_and_(_ROUNDED)
        return (bits.long().bitwise_left_shift_(31).add_(number)).T.contiguous().sort(dim=1)[0].T

    def _bucket(self, place: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        """Return where the candidates of people's buckets begin, and how many there are, both (N,)."""
        first, columns, rows = self.buckets[:, row]
        cell = ((place - self.corner[:, row]) / BUCKET).floor()
        x, y = cell
        inside = (x >= 0) & (y >= 0) & (x < columns) & (y < rows)
        x, y = torch.where(inside, cell, 0).long()
        bucket = torch.where(inside, first + y * columns + x, len(self.offset) - 2)
        begin = self.offset.index_select(0, bucket)
        return begin, self.offset.index_select(0, bucket + 1) - begin

    def _distance2(self, place: Tensor, candidate: Tensor) -> Tensor:
        """Return squared distances (C, N) of C candidates each to people; far where they are not outside."""
        segment = self.candidates.index_select(0, candidate)
        x, y, dx, dy, length = self.segments[:5].index_select(1, segment).view(5, -1, place.shape[1])
        from_x, from_y = place[0] - x, place[1] - y
        along, apart = from_x * dx + from_y * dy, from_x * dy - from_y * dx
        beyond = along - along.minimum(length).clamp_min_(0)
        inside = torch.le(apart, 0, out=torch.empty_like(apart))
        return (beyond * beyond + apart * apart).add_(inside, alpha=_FAR)


def edges(polygon: Floats) -> Floats:
    """Return the segments (V, 12) of a polygon as `SegmentTable.build` takes them."""
    end = np.roll(polygon, -1, axis=0)
    direction = (end - polygon) / np.linalg.norm(end - polygon, axis=1, keepdims=True)
    before, after = np.roll(direction, 1, axis=0), np.roll(direction, -1, axis=0)
    convex = before[:, 0] * direction[:, 1] - before[:, 1] * direction[:, 0] >= 0
    return np.column_stack((polygon, end, direction, before, after, convex, np.roll(convex, -1)))


def _seen_from_themselves(segments: Floats) -> Floats:
    """Return segments (S, 12) in the form of the table (11, S)."""
    start, end, direction, before, after = (segments[:, at : at + 2] for at in range(0, 10, 2))
    left = np.column_stack((-direction[:, 1], direction[:, 0]))
    legs = [(way * axis).sum(1) for way in (before, after) for axis in (direction, left)]
    back_x, back_y, ahead_x, ahead_y = legs
    length = np.linalg.norm(end - start, axis=1)
    columns = (start, direction, length, -back_x, -back_y, -ahead_x, ahead_y, segments[:, 10:])
    return np.column_stack(columns).T.copy()


def _bucket_lists(
    segments: Floats, low: Floats, size: NDArray[np.int64], reach: float, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the candidates of a map's buckets, one bucket after the other, and how many each has."""
    lists: list[NDArray[np.int64]] = [np.zeros(0, np.int64)] * int(size.prod())
    columns, rows = np.meshgrid(np.arange(TILE), np.arange(TILE))
    cells = np.column_stack((columns.ravel(), rows.ravel()))
    half = BUCKET * math.sqrt(0.5) * (1 + 1e-6)  # rounding must not lose a candidate
    for corner in np.ndindex(*(-(-size // TILE))):
        tile = np.array(corner) * TILE
        inside = cells[((tile + cells) < size).all(1)] + tile
        distance, _ = _distances(segments, low + (tile + TILE / 2)[None] * BUCKET)
        near = (distance[0] <= reach + TILE * half).nonzero()[0]
        if not len(near):
            continue
        distance, left = _distances(segments[near], low + (inside + 0.5) * BUCKET)
        wanted = (distance <= reach + half) & (left < half)
        # For every point of the bucket, `most` segments are nearer than this and have it outside.
        surely = np.where(left < -half, distance, np.inf)
        if 0 < most < len(near):
            wanted &= distance <= np.partition(surely, most - 1, axis=1)[:, most - 1 : most] + 2 * half
        for (x, y), chosen in zip(inside, wanted, strict=True):
            lists[y * size[0] + x] = near[chosen]
    return np.concatenate([np.zeros(0, np.int64), *lists]), np.array([len(one) for one in lists], np.int64)


def _distances(segments: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the distances (N, S) of points (N, 2) to segments, and how far left of their lines they are."""
    (x, y), (start_x, start_y, end_x, end_y, dx, dy) = points.T[:, :, None], segments.T[:6]
    along = (x - start_x) * dx + (y - start_y) * dy
    left = dx * (y - start_y) - dy * (x - start_x)
    length = np.hypot(end_x - start_x, end_y - start_y)
    beyond = along - along.clip(0, length)
    return np.hypot(beyond, left), left
