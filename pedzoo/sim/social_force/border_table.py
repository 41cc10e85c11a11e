"""Wall segments of several maps in coarse buckets: everybody looks at those that can be within reach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.sim.orca.vectors import cross, dot

BUCKET = 0.5
"""Metres: the side of a bucket."""

_AT_ONCE = 1_000_000
"""Pairs of segments and buckets that are compared together: bounds the memory that building takes."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BorderTable:
    """All segments of R maps, and which of them are within reach of each bucket; row -1 means "no map".

    Walls lie to the left of a segment.

    Attributes:
        segments: In the maps' frames (12, S): start, end, unit direction, unit directions of the segments
            before and after, the length of the segment before, and whether the corner at the start is concave
            (1 or 0).
        candidates: Numbers of segments, bucket after bucket (C,) long.
        offset: Where each bucket's candidates begin (buckets + 2,) long; the last bucket is empty.
        low: Smallest x and y of each map's buckets (2, R + 1), metres.
        buckets: Number of each map's first bucket, and how many lie along x and y (3, R + 1) long.
        reach: Metres up to which the candidates are complete.
    """

    segments: Tensor
    candidates: Tensor
    offset: Tensor
    low: Tensor
    buckets: Tensor
    reach: float

    @classmethod
    def build(cls, maps: Sequence[Sequence[Floats]], reach: float) -> BorderTable:
        """Return the table of the outlines (V, 2) of each map, in its frame."""
        segments, candidates, counts = [np.zeros((0, 12))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        lows, sizes = [], []
        for polygons in maps:
            own = np.concatenate([np.zeros((0, 12)), *map(_segments, polygons)])
            low = own[:, :2].min(0, initial=math.inf) - reach if len(own) else np.zeros(2)
            high = own[:, :2].max(0, initial=-math.inf) + reach if len(own) else np.zeros(2)
            size = np.ceil((high - low) / BUCKET).astype(np.int64)
            found, count = _candidates(own, low, size, reach)
            candidates.append(found + sum(map(len, segments)))
            segments.append(own)
            counts.append(count)
            lows.append(low)
            sizes.append(size)
        first = np.cumsum([len(count) for count in counts])
        return cls(
            segments=torch.as_tensor(np.concatenate(segments).T.copy()),
            candidates=torch.as_tensor(np.concatenate(candidates)),
            offset=torch.as_tensor(np.cumsum(np.concatenate([[0], *counts, [0]]))).long(),
            low=torch.as_tensor(np.array([*lows, np.zeros(2)]).T.copy()),
            buckets=torch.as_tensor(np.column_stack((first, [*sizes, np.zeros(2)])).T.copy()).long(),
            reach=reach,
        )

    def to(self, device: torch.device, dtype: torch.dtype) -> BorderTable:
        """Return the table for people on a device whose positions are of a dtype."""
        whole = {name: getattr(self, name).to(device) for name in ("candidates", "offset", "buckets")}
        exact = {name: getattr(self, name).to(device, dtype) for name in ("segments", "low")}
        return replace(self, **whole, **exact)

    @torch.no_grad()
    def look(self, place: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        """Return pairs (M,) of people and segments that they are outside of and within reach of.

        Args:
            place: Positions in the maps' frames (2, N), metres.
            row: Which map (N,) long, -1 for none.

        Returns:
            Numbers of people, ascending, and of segments.
        """
        first, columns, rows = self.buckets[:, row]
        cell = ((place - self.low[:, row]) / BUCKET).floor()
        inside = (cell[0] >= 0) & (cell[1] >= 0) & (cell[0] < columns) & (cell[1] < rows)
        x, y = torch.where(inside, cell, 0).long()
        bucket = torch.where(inside, first + y * columns + x, len(self.offset) - 2)
        begin = self.offset.index_select(0, bucket)
        count = self.offset.index_select(0, bucket + 1) - begin
        person = torch.arange(len(row), device=row.device).repeat_interleave(count)
        skipped = (begin - (count.cumsum(0) - count)).index_select(0, person)
        number = torch.arange(len(person), device=row.device) + skipped
        segment = self.candidates.index_select(0, number)

        start, end, along = self.segments[:6].index_select(1, segment).split(2)
        off = place.index_select(1, person) - start
        t = dot(off, along)
        beyond = t - t.clamp_min(0).minimum(dot(end - start, along))
        left = cross(along, off)
        near = (beyond * beyond + left * left < self.reach * self.reach) & (left < 0)
        kept = near.nonzero()[:, 0]
        return person.index_select(0, kept), segment.index_select(0, kept)


def _segments(polygon: Floats) -> Floats:
    """Return the segments (V, 12) of an outline (V, 2) as the table keeps them."""
    way = np.roll(polygon, -1, axis=0) - polygon
    length = np.hypot(*way.T)
    along = way / length[:, None]
    before, after = np.roll(along, 1, axis=0), np.roll(along, -1, axis=0)
    concave = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0] < 0
    return np.column_stack(
        (polygon, np.roll(polygon, -1, axis=0), along, before, after, np.roll(length, 1), concave)
    )


def _candidates(
    segments: Floats, low: Floats, size: NDArray[np.int64], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of a map's segments, one bucket after the other, and how many each bucket has."""
    half = BUCKET * math.sqrt(0.5) * (1 + 1e-6)  # rounding must not lose a candidate
    least, most = np.minimum(segments[:, :2], segments[:, 2:4]), np.maximum(segments[:, :2], segments[:, 2:4])
    first = np.clip(np.floor((least - reach - low) / BUCKET), 0, size - 1).astype(np.int64)
    last = np.clip(np.floor((most + reach - low) / BUCKET), 0, size - 1).astype(np.int64)
    wide, high = (last - first + 1).T
    count = wide * high
    # all buckets of all segments' bounding boxes, some segments after the other
    groups = np.cumsum(count) // _AT_ONCE
    buckets, numbers = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for group in np.unique(groups):
        some = np.flatnonzero(groups == group)
        one = some.repeat(count[some])
        place = np.arange(len(one)) - (np.cumsum(count[some]) - count[some]).repeat(count[some])
        x, y = first[one, 0] + place % wide[one], first[one, 1] + place // wide[one]
        start, end, along = np.split(segments[one, :6], 3, axis=1)
        off = low + (np.column_stack((x, y)) + 0.5) * BUCKET - start
        t = (off * along).sum(1)
        beyond = t - np.clip(t, 0, ((end - start) * along).sum(1))
        left = along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]
        near = (np.hypot(beyond, left) <= reach + half) & (left < half)
        buckets.append((y * size[0] + x)[near])
        numbers.append(one[near])
    bucket, number = np.concatenate(buckets), np.concatenate(numbers)
    order = np.argsort(bucket, kind="stable")
    return number[order], np.bincount(bucket, minlength=int(size.prod()))
