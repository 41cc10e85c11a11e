"""Loops over walls and people, compiled by numba: distances, rays, the nearest segments and others."""

import math
from typing import Any, NamedTuple

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.maps.constants import BUCKET, CANDIDATES, INTO, ROUNDED, WALL


class WallArrays(NamedTuple):
    """How walls lie in B scenes, `MapBank.walls_of_scenes`, no rows without walls; and `Walls.arrays`."""

    frames: Any
    places: Any
    choice: Any
    option: Any
    least: Any
    limit: Any


@jit
def in_half_cells(x, y, frame):
    """Return where a scene position is in half cells."""
    return frame[4] + frame[0] * x + frame[2] * y, frame[5] + frame[1] * x + frame[3] * y


@jit
def quarter_at(cell_x, cell_y, place):
    """Return the number of the quarter of a cell that a place in half cells lies in."""
    # the order of the arguments makes the first number of what is not a number
    column = int(min(max(0.0, cell_x), place[0] - 1.0))
    row = int(min(max(0.0, cell_y), place[1] - 1.0))
    return place[2] + row * place[0] + column


@jit
def quarter(x, y, frame, place):
    """Return where a scene position is in half cells, and the number of its quarter of a cell."""
    cell_x, cell_y = in_half_cells(x, y, frame)
    return cell_x, cell_y, quarter_at(cell_x, cell_y, place)


@jit
def wall_gap(x, y, frame, place, choice, option, limit):
    """Return the distance to the nearest wall and the direction in which it grows (gap, x, y)."""
    cell_x, cell_y, index = quarter(x, y, frame, place)
    chosen = choice[index]
    sign = 1.0
    if chosen < 0:
        sign, chosen = -1.0, -1 - chosen
    best, off_x, off_y = 1e300, 0.0, 0.0
    for k in range(CANDIDATES):
        dx = cell_x - min(max(cell_x, option[chosen, k]), option[chosen, 2 * CANDIDATES + k])
        dy = cell_y - min(max(cell_y, option[chosen, CANDIDATES + k]), option[chosen, 3 * CANDIDATES + k])
        squared = dx * dx + dy * dy
        if squared < best:
            best, off_x, off_y = squared, dx, dy
    depth, side = math.sqrt(best), frame[6]
    distance = depth * side
    if distance >= limit:
        return limit * sign, 0.0, 0.0
    if depth < 1e-9:
        return distance * sign, 0.0, 0.0
    scale = sign * side / depth
    off_x, off_y = off_x * scale, off_y * scale
    return distance * sign, frame[0] * off_x + frame[1] * off_y, frame[2] * off_x + frame[3] * off_y


@compiled("i8(f4[:,:], i8[:], f4[:], f4[:,:], i4[:], i4[:], f4[:,:], i4[:,:], i8[:,:], f4[:,:])")
def nearest(place, row, reach, segments, candidates, offset, corner, buckets, number, squared):
    """Write the numbers of the nearest segments (K, N) and squared distances: see `SegmentTable.nearest`.

    Returns how many the point with the most of them has.
    """
    most, used = number.shape[0], 0
    distance2 = np.empty(1, np.float32)
    bits = distance2.view(np.int32)
    for i in range(len(row)):
        x, y, r = place[0, i], place[1, i], row[i]
        column, line = (x - corner[0, r]) / BUCKET, (y - corner[1, r]) / BUCKET
        if not (0 <= column < buckets[1, r] and 0 <= line < buckets[2, r]):
            continue
        bucket = buckets[0, r] + int(line) * buckets[1, r] + int(column)
        count = 0
        for c in range(offset[bucket], offset[bucket + 1]):
            s = candidates[c]
            from_x, from_y = x - segments[0, s], y - segments[1, s]
            along = from_x * segments[2, s] + from_y * segments[3, s]
            line_distance = from_x * segments[3, s] - from_y * segments[2, s]
            if not line_distance > 0:
                continue
            beyond = along - max(min(along, segments[4, s]), np.float32(0))
            distance2[0] = beyond * beyond + line_distance * line_distance
            bits[0] &= ROUNDED
            if not distance2[0] < reach[i] * reach[i]:
                continue
            at = count
            while at > 0 and (
                squared[at - 1, i] > distance2[0]
                or (squared[at - 1, i] == distance2[0] and number[at - 1, i] > s)
            ):
                at -= 1
            if at == most:
                continue
            count = min(count + 1, most)
            for k in range(count - 1, at, -1):
                number[k, i], squared[k, i] = number[k - 1, i], squared[k - 1, i]
            number[at, i], squared[at, i] = s, distance2[0]
        used = max(used, count)
    return used


@compiled("void(f4[:,:,:,:], f4[:,:], f4[:,:,:], i4[:,:,:], i4[:], f4[:,:], f4[:], f8, f4[:,:,:,:])")
def look(points, within, frames, places, choice, option, least, limit, result):
    """Write distances to walls and half-planes (4, K, B, A): see `LocalWalls.half_planes`."""
    frame, place = np.empty(7), np.empty(3, np.int64)
    for b in range(points.shape[2]):
        frame[:], place[:] = frames[:, b, 0], places[:, b, 0]
        for k in range(points.shape[1]):
            for a in range(points.shape[3]):
                x, y = points[0, k, b, a], points[1, k, b, a]
                _, _, index = quarter(x, y, frame, place)
                gap, away_x, away_y = float(least[index]), 0.0, 0.0
                if not gap > within[b, a]:
                    gap, away_x, away_y = wall_gap(x, y, frame, place, choice, option, limit)
                result[0, k, b, a], result[1, k, b, a] = gap, x * away_x + y * away_y - gap
                result[2, k, b, a], result[3, k, b, a] = away_x, away_y


@compiled("void(f8[:,:,:], f8[:,:,:], f4[:], i4[:,:], f8[:], f8, f8[:,:])")
def cast(origin, direction, least, place, side, reach, length):
    """Write how far rays go (R, B), metres: see `LocalWalls.cast`; they are given in half cells."""
    for b in range(length.shape[1]):
        width, height, first = place[0, b], place[1, b], place[2, b]
        for i in range(length.shape[0]):
            x, y, dx, dy = origin[0, i, b], origin[1, i, b], direction[0, i, b], direction[1, i, b]
            to_low_x, to_high_x, to_low_y, to_high_y = -x / dx, (width - x) / dx, -y / dy, (height - y) / dy
            t = max(min(to_low_x, to_high_x), min(to_low_y, to_high_y), 0.0)
            end = min(max(to_low_x, to_high_x), max(to_low_y, to_high_y), reach)
            length[i, b] = reach
            while t < end:
                into = t + INTO * side[b]
                column = min(max(math.floor(x + dx * into), 0), width - 1)
                row = min(max(math.floor(y + dy * into), 0), height - 1)
                free = least[first + row * width + column]
                if free < WALL * side[b]:
                    entry = max((column + (dx < 0) - x) / dx, (row + (dy < 0) - y) / dy)
                    length[i, b] = max(entry, 0.0)
                    break
                leaving = min((column + (dx > 0) - x) / dx, (row + (dy > 0) - y) / dy)
                t = max(leaving, into, t + free)


@jit
def meet_bodies(position, radius, present, origin, direction, length):
    """Shorten rays (B, R) to where they meet a body (B, A); those that begin inside of it do not see it."""
    for b in range(length.shape[0]):
        for a in range(radius.shape[1]):
            if not present[b, a]:
                continue
            x, y, square = position[b, a, 0], position[b, a, 1], radius[b, a] * radius[b, a]
            for i in range(length.shape[1]):
                off_x, off_y = origin[b, i, 0] - x, origin[b, i, 1] - y
                along = off_x * direction[b, i, 0] + off_y * direction[b, i, 1]
                outside = off_x * off_x + off_y * off_y - square
                # |origin + t direction - position| = radius; a root below zero lies behind the ray
                root = along * along - outside
                if along < 0 and outside > 0 and root > 0:
                    length[b, i] = min(length[b, i], -along - np.sqrt(root))


@jit
def nearest_others(position, mask, asked, reach, limit, order, squared, other):
    """Write the nearest others (N, K) of people and their squared distances, nearest first.

    Returns how many there are within ``reach``, whose square in their precision is ``limit``, of each (N,).
    Agents (B, A) are looked at in the ``order`` of their x, written with their ranks (2, B, A) where K is 0.
    """
    agents, most = mask.shape[1], other.shape[1]
    count, along, (order, rank) = np.zeros(len(asked), np.int64), np.empty(agents), order
    for b in range(0 if most else len(mask)):
        for a in range(agents):
            x = position[b, a, 0]
            along[a] = x if mask[b, a] and x == x else np.inf
        order[b] = np.argsort(along)
        for k in range(agents):
            rank[b, order[b, k]] = k
    for n in range(len(asked)):
        b, a = asked[n] // agents, asked[n] % agents
        if not mask[b, a]:
            continue
        x, y, kept = position[b, a, 0], position[b, a, 1], 0
        for step in (-1, 1):
            k = rank[b, a] + step
            while 0 <= k < agents and abs(position[b, order[b, k], 0] - x) <= reach * (1 + 1e-6):
                o = order[b, k]
                k += step
                if not mask[b, o]:
                    break
                dx, dy = position[b, o, 0] - x, position[b, o, 1] - y
                exact = dx * dx + dy * dy
                if not exact < limit:
                    continue
                count[n] += 1
                near, at = np.float32(exact), kept
                while at > 0 and (
                    squared[n, at - 1] > near
                    or (squared[n, at - 1] == near and other[n, at - 1] > b * agents + o)
                ):
                    at -= 1
                if at == most:
                    continue
                kept = min(kept + 1, most)
                for i in range(kept - 1, at, -1):
                    squared[n, i], other[n, i] = squared[n, i - 1], other[n, i - 1]
                squared[n, at], other[n, at] = near, b * agents + o
    return count
