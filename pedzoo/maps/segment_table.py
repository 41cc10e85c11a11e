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


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """All segments of R maps, and which of them can matter in each bucket; row -1 means "no map".

    Attributes:
        segments: In the maps' frames (12, S + 1): start, end, unit direction, directions of the segments
            before and after, and whether the corners at start and end are convex (1 or 0). The last one
            stands for none.
        candidates: Numbers of segments, bucket after bucket (C,) long.
        offset: Where each bucket's candidates begin (buckets + 1,) long.
        first: Number of each map's first bucket (R + 1,) long.
        low: Smallest x and y of each map's buckets (R + 1, 2), metres.
        size: How many buckets lie along x and y (R + 1, 2) long.
        reach: Metres up to which the candidates are complete.
    """

    segments: Tensor
    candidates: Tensor
    offset: Tensor
    first: Tensor
    low: Tensor
    size: Tensor
    reach: float

    @classmethod
    def build(cls, maps: Sequence[Floats], reach: float, most: int) -> SegmentTable:
        """Return the table of the segments of each map.

        Args:
            maps: For each map its segments (S, 12), in its frame.
            reach: Metres up to which people ask for segments.
            most: How many segments one person gets.
        """
        lists, counts, lows, sizes = [], [], [], []
        for own in maps:
            low = own[:, :2].min(0, initial=math.inf) - reach if len(own) else np.zeros(2)
            high = own[:, :2].max(0, initial=-math.inf) + reach if len(own) else np.zeros(2)
            size = np.ceil((high - low) / BUCKET).astype(np.int64)
            found, count = _bucket_lists(own, low, size, reach, most)
            lists.append(found + sum(map(len, maps[: len(lists)])))
            counts.append(count)
            lows.append(low)
            sizes.append(size)
        first = np.cumsum([0, *(len(count) for count in counts)])
        offset = np.cumsum(np.concatenate([[0], *counts]))
        return cls(
            segments=torch.as_tensor(np.concatenate([*maps, NOWHERE]).T.copy()),
            candidates=torch.as_tensor(np.concatenate([np.zeros(0, np.int64), *lists]), dtype=torch.long),
            offset=torch.as_tensor(offset, dtype=torch.long),
            first=torch.as_tensor(first),
            low=torch.as_tensor(np.array([*lows, np.zeros(2)])),
            size=torch.as_tensor(np.array([*sizes, np.zeros(2)]), dtype=torch.long),
            reach=reach,
        )

    @property
    def none(self) -> int:
        """Number of the segment that stands for none."""
        return self.segments.shape[1] - 1

    def to(self, device: torch.device, dtype: torch.dtype) -> SegmentTable:
        """Return the table for people on a device whose positions are of a dtype."""
        whole = {name: getattr(self, name).to(device) for name in ("candidates", "offset", "first", "size")}
        return replace(
            self, **whole, segments=self.segments.to(device, dtype), low=self.low.to(device, dtype)
        )

    def look(self, place: Tensor, row: Tensor, reach: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return pairs (M,) of people and segments that they are outside of and within reach of.

        Args:
            place: Positions in the maps' frames (N, 2), metres.
            row: Which map (N,) long, -1 for none.
            reach: Metres (N,), at most the table's.

        Returns:
            Numbers of people, ascending, of segments, and their squared distances.
        """
        cell = ((place - self.low[row]) / BUCKET).floor()
        size = self.size[row]
        inside = ((cell >= 0) & (cell < size)).all(1)
        x, y = cell.where(inside[:, None], 0).long().unbind(1)
        bucket = torch.where(inside, self.first[row] + y * size[:, 0] + x, 0)
        begin = self.offset[bucket]
        count = torch.where(inside, self.offset[bucket + 1] - begin, 0) if len(self.offset) > 1 else begin
        person = torch.arange(len(place), device=place.device).repeat_interleave(count)
        skipped = (begin - (count.cumsum(0) - count)).index_select(0, person)
        segment = self.candidates[torch.arange(len(person), device=place.device) + skipped]

        x, y = place.T.contiguous().index_select(1, person)
        start_x, start_y, end_x, end_y = self.segments[:4].index_select(1, segment)
        along_x, along_y = end_x - start_x, end_y - start_y
        from_x, from_y = x - start_x, y - start_y
        length2 = along_x * along_x + along_y * along_y
        t = ((from_x * along_x + from_y * along_y) / length2).clamp(0, 1)
        away_x, away_y = from_x - t * along_x, from_y - t * along_y
        distance2 = away_x * away_x + away_y * away_y
        outside = along_x * from_y - along_y * from_x < 0
        kept = (outside & (distance2 < (reach * reach).index_select(0, person))).nonzero()[:, 0]
        return person.index_select(0, kept), segment.index_select(0, kept), distance2.index_select(0, kept)


def edges(polygon: Floats) -> Floats:
    """Return the segments (V, 12) of a polygon as the table keeps them."""
    end = np.roll(polygon, -1, axis=0)
    direction = (end - polygon) / np.linalg.norm(end - polygon, axis=1, keepdims=True)
    before, after = np.roll(direction, 1, axis=0), np.roll(direction, -1, axis=0)
    convex = before[:, 0] * direction[:, 1] - before[:, 1] * direction[:, 0] >= 0
    return np.column_stack((polygon, end, direction, before, after, convex, np.roll(convex, -1)))


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
