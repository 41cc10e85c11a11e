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


_NUMBER = (1 << 31) - 1
"""The bits of a key that tell which segment it is of."""

_HALF = BUCKET * math.sqrt(0.5) * (1 + 1e-4)
"""Metres from the middle of a bucket to its corners, and some for rounding: it must not lose a candidate."""

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
        candidates: Numbers of segments, bucket after bucket, those nearest to its middle first, and as many
            more as a bucket has at most.
        least: Their distances from the middles of the buckets, metres.
        offset: Where each bucket's candidates begin (buckets + 2,) long; the last bucket is empty.
        corner: Smallest x and y of each map's buckets (2, R + 1), metres.
        buckets: Number of each map's first bucket, and how many lie along x and y (3, R + 1) long.
        reach: Metres up to which the candidates are complete.
    """

    segments: Tensor
    candidates: Tensor
    least: Tensor
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
        lists, counts, lows, sizes = [np.zeros((2, 0))], [np.zeros(0, np.int64)], [], []
        for number, own in enumerate(maps):
            low = own[:, :2].min(0, initial=math.inf) - reach if len(own) else np.zeros(2)
            high = own[:, :2].max(0, initial=-math.inf) + reach if len(own) else np.zeros(2)
            size = np.ceil((high - low) / BUCKET).astype(np.int64)
            found, count = _bucket_lists(own, low, size, reach, most)
            found[0] += sum(map(len, maps[:number]))
            lists.append(found)
            counts.append(count)
            lows.append(low)
            sizes.append(size)
        count = np.concatenate(counts)
        segments = _seen_from_themselves(np.concatenate([*maps, NOWHERE]))
        spare = np.full((2, count.max(initial=0)), segments.shape[1] - 1)
        candidates, least = np.concatenate([*lists, spare], axis=1)
        first = np.cumsum([0, *(len(count) for count in counts[1:])])
        return cls(
            segments=torch.as_tensor(segments),
            candidates=torch.as_tensor(candidates).long(),
            least=torch.as_tensor(least),
            offset=torch.as_tensor(np.cumsum(np.concatenate([[0], count, [0]])), dtype=torch.long),
            corner=torch.as_tensor(np.array([*lows, np.zeros(2)]).T.copy()),
            buckets=torch.as_tensor(np.column_stack((first, [*sizes, np.zeros(2)])).T.copy()).long(),
            reach=reach,
        )

    def to(self, device: torch.device, dtype: torch.dtype) -> SegmentTable:
        """Return the table for people on a device whose positions are of a dtype."""
        whole = {name: getattr(self, name).to(device) for name in ("candidates", "offset", "buckets")}
        floats = {name: getattr(self, name).to(device, dtype) for name in ("segments", "least", "corner")}
        return replace(self, **whole, **floats)

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
        columns = min(candidates, 2 * most)
        key = self._keys(place, begin, count, columns)[:most]
        # those beyond can only matter to people who have not found as many as near as the next can be
        while 0 < columns < candidates:
            enough = _distance2_of(key[-1]).sqrt().minimum(reach) + _HALF
            rows = ((count > columns) & (self.least.index_select(0, begin + columns) < enough)).nonzero()[
                :, 0
            ]
            columns = min(2 * columns, candidates)
            key[:, rows] = self._keys(place[:, rows], begin[rows], count[rows], columns)[:most]
        valid = torch.lt(_distance2_of(key), (reach * reach).float(), out=place.new_empty(0))
        used = int(valid.amax(1).sum()) if valid.numel() else 0
        chosen = (key[:used] & _NUMBER).flatten()
        return self.segments.index_select(1, chosen).view(len(self.segments), used, len(row)), valid[:used]

    def _keys(self, place: Tensor, begin: Tensor, count: Tensor, columns: int) -> Tensor:
        """Return numbers (C, N) in the order of the distances of people's first C candidates, ascending.

        The lower bits tell the segment, the upper ones the squared distance: floats that are not negative are
        ordered as their bits are. The last of these are left out, so that rounding does not choose between
        two segments of which the common corner is nearest.
        """
        chunk = max(1, _AT_ONCE // max(1, columns))
        if len(count) > chunk:
            people = zip(place.split(chunk, 1), begin.split(chunk), count.split(chunk), strict=True)
            return torch.cat([self._keys(*some, columns) for some in people], dim=1)
        number = torch.arange(columns, device=place.device)[:, None]
        segment = self.candidates.index_select(0, (begin + number).flatten())
        distance2 = self._distance2(place, segment).view(columns, len(count)).float()
        distance2 = distance2.add_(torch.ge(number, count, out=torch.empty_like(distance2)), alpha=_FAR)
        bits = distance2.view(torch.int32).bitwise_and_(_ROUNDED).long().bitwise_left_shift_(31)
        return (bits + segment.view(bits.shape)).T.contiguous().sort(dim=1)[0].T.contiguous()

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

    def _distance2(self, place: Tensor, segment: Tensor) -> Tensor:
        """Return squared distances (C, N) of C segments each to people; far where they are not outside."""
        shape = 5, len(segment) // max(1, place.shape[1]), place.shape[1]
        x, y, dx, dy, length = self.segments[:5].index_select(1, segment).view(shape)
        from_x, from_y = place[0] - x, place[1] - y
        along, apart = from_x * dx + from_y * dy, from_x * dy - from_y * dx
        beyond = along - along.minimum(length).clamp_min_(0)
        inside = torch.le(apart, 0, out=torch.empty_like(apart))
        return (beyond * beyond + apart * apart).add_(inside, alpha=_FAR)


def _distance2_of(key: Tensor) -> Tensor:
    """Return the squared distances (...) that keys tell, single precision."""
    return (key >> 31).int().view(torch.float32)


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
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the candidates of a map's buckets and their distances (2, C), and how many each bucket has."""
    lists: list[Floats] = [np.zeros((2, 0))] * int(size.prod())
    columns, rows = np.meshgrid(np.arange(TILE), np.arange(TILE))
    cells = np.column_stack((columns.ravel(), rows.ravel()))
    for corner in np.ndindex(*(-(-size // TILE))):
        tile = np.array(corner) * TILE
        inside = cells[((tile + cells) < size).all(1)] + tile
        distance, _ = _distances(segments, low + (tile + TILE / 2)[None] * BUCKET)
        near = (distance[0] <= reach + TILE * _HALF).nonzero()[0]
        if not len(near):
            continue
        distance, left = _distances(segments[near], low + (inside + 0.5) * BUCKET)
        wanted = (distance <= reach + _HALF) & (left < _HALF)
        # For every point of the bucket, `most` segments are nearer than this and have it outside.
        surely = np.where(left < -_HALF, distance, np.inf)
        if 0 < most < len(near):
            wanted &= distance <= np.partition(surely, most - 1, axis=1)[:, most - 1 : most] + 2 * _HALF
        for (x, y), gap, chosen in zip(inside, distance, wanted, strict=True):
            order = chosen.nonzero()[0]
            order = order[gap[order].argsort(kind="stable")]
            lists[y * size[0] + x] = np.stack((near[order], gap[order]))
    return np.concatenate([np.zeros((2, 0)), *lists], axis=1), np.array(
        [one.shape[1] for one in lists], np.int64
    )


def _distances(segments: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the distances (N, S) of points (N, 2) to segments, and how far left of their lines they are."""
    (x, y), (start_x, start_y, end_x, end_y, dx, dy) = points.T[:, :, None], segments.T[:6]
    along = (x - start_x) * dx + (y - start_y) * dy
    left = dx * (y - start_y) - dy * (x - start_x)
    length = np.hypot(end_x - start_x, end_y - start_y)
    beyond = along - along.clip(0, length)
    return np.hypot(beyond, left), left
