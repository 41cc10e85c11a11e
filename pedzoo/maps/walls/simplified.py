"""Closed polygons with fewer corners, to the corner as OpenCV's ``approxPolyDP`` finds them.

Douglas and Peucker, "Algorithms for the reduction of the number of points", Cartographica 10, 1973. The order
of the search and the last pass are OpenCV's (``imgproc/src/approx.cpp``), so that plans keep their walls.
"""

import numpy as np
from numpy.typing import NDArray

_ROUNDS = 3
"""From corner to farthest corner so many times: the last two are where the search begins."""

Floats = NDArray[np.float64]


def simplified(polygon: Floats, tolerance: float) -> Floats:
    """Return the corners (V, 2) of a closed polygon from which it departs by ``tolerance`` at most.

    Args:
        polygon: Corners (N, 2), N > 0.
        tolerance: In the polygon's unit, > 0.
    """
    count, squared = len(polygon), tolerance**2
    first, far = 0, 0
    for _ in range(_ROUNDS):
        first = (first + far) % count
        gaps = np.square(np.roll(polygon, -first, axis=0) - polygon[first]).sum(1)
        far = int(gaps.argmax()) or far
        most = gaps.max()
    if most <= squared:
        return polygon[[first]]
    begun = np.roll(polygon, -first, axis=0)
    return _without_straight(_kept(np.concatenate((begun, begun[:1])), far, squared), squared)


def _kept(points: Floats, far: int, squared: float) -> Floats:
    """Return the corners that stay of a closed run (N + 1, 2) that is halved at number ``far``."""
    stays = np.zeros(len(points) - 1, dtype=bool)
    stays[[0, far]] = True
    low, high = np.array([0, far]), np.array([far, len(points) - 1])
    while len(low := low[(wide := high - low > 1)]):  # all parts at once
        high = high[wide]
        sizes = high - low - 1
        part = np.repeat(np.arange(len(low)), sizes)
        begin = np.cumsum(sizes) - sizes
        number = np.arange(len(part)) + (low + 1 - begin)[part]
        along = points[high] - points[low]
        scale = np.square(along).sum(1)
        away = _from_lines(points[number] - points[low][part], along[part], scale[part])
        most = np.maximum.reduceat(away, begin)
        farthest = (away == most[part]).nonzero()[0]
        _, at = np.unique(part[farthest], return_index=True)  # the first of equals
        split = number[farthest[at]]
        bent = most > squared * scale
        low, high, split = low[bent], high[bent], split[bent]
        stays[split] = True
        low, high = np.concatenate((low, split)), np.concatenate((split, high))
    return points[:-1][stays]


def _from_lines(points: Floats, along: Floats, scale: Floats) -> Floats:
    """Return squared distances (N,) of points from lines (N, 2) that begin at 0, times their ``scale``."""
    on = (points * along).sum(1)
    away = np.square(points[:, 1] * along[:, 0] - points[:, 0] * along[:, 1])
    away = np.where(on < 0, np.square(points).sum(1) * scale, away)
    return np.where(on > scale, np.square(points - along).sum(1) * scale, away)


def _without_straight(polygon: Floats, squared: float) -> Floats:
    """Return the corners without those that lie on an almost straight line between their neighbours."""
    corners = polygon.tolist()
    count = left = len(corners)
    result = [corner.copy() for corner in corners]
    start, here, reads, writes = corners[-1], corners[0], 1, 0
    turns = 0
    while turns < count and left > 2:
        end = result[reads % count]
        reads, turns = reads + 1, turns + 1
        x, y = end[0] - start[0], end[1] - start[1]
        to_x, to_y = here[0] - start[0], here[1] - start[1]
        forward = to_x * (end[0] - here[0]) + to_y * (end[1] - here[1])
        slanted = x != 0 and y != 0
        if slanted and forward >= 0 and (to_x * y - to_y * x) ** 2 <= 0.5 * squared * (x**2 + y**2):
            left, turns, start = left - 1, turns + 1, end
            result[writes % count] = end
            here = result[reads % count]
            reads += 1
        else:
            result[writes % count], start, here = here, here, end
        writes += 1
    return np.array(result[:left])
