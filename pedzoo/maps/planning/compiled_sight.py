"""Lines of sight between open cells, compiled by numba: one line after the other, in leaps."""

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.maps.constants import EPSILON as _EPSILON
from pedzoo.maps.constants import SPACING as _SPACING
from pedzoo.maps.walls_numba import in_half_cells, quarter_at

ROUNDING = 1e-6
"""Cells: lines between centres miss other centres by far more, unless they meet them."""


@compiled("void(i2[:], i8, i8, i4[:,:], i4[:,:], b1[:])")
def clear_lines(leap, width, cells, origin, target, seen):
    """Write which lines (M,) from and to columns and rows of open cells (M, 2) are clear: see `Sight`."""
    for m in range(len(seen)):
        x, y = target[m, 0] - origin[m, 0], target[m, 1] - origin[m, 1]
        steep = abs(y) > abs(x)
        along, across = (y, x) if steep else (x, y)
        steps = abs(along)
        slope = across / max(steps, 1)
        # flat index = base + column * forward + floor(height) * sideways, columns counted along the line
        forward, sideways = (width, 1) if steep else (1, width)
        base = origin[m, 1] * width + origin[m, 0] + (cells if across == 0 else 0)
        if along < 0:
            base -= forward  # squares are named by their smallest corner
            forward = -forward
        column = 0
        while column < steps:
            begin = slope * column
            end = begin + slope
            low = math.floor(min(begin, end) + ROUNDING)
            high = max(math.ceil(max(begin, end) - ROUNDING) - 1, low)
            at = base + column * forward
            room = min(leap[at + low * sideways], leap[at + high * sideways])
            if room == 0:
                break
            column += room
        seen[m] = column >= steps


@jit
def _sees(home, corner, end, part, frame, place, clear):
    """Return whether points 0.3 m apart of the line to a carrot keep a body's radius from walls."""
    full = math.sqrt((end[0] - home[0]) ** 2 + (end[1] - home[1]) ** 2)
    spacing = _SPACING / max(full, _SPACING)
    to_x = corner[0] + part * (end[0] - corner[0]) - home[0]
    to_y = corner[1] + part * (end[1] - corner[1]) - home[1]
    steps = math.ceil(1 / spacing - 1e-6)
    cell_x, cell_y = in_half_cells(home[0], home[1], frame)
    over, up = frame[0] * to_x + frame[2] * to_y, frame[1] * to_x + frame[3] * to_y
    hidden = False
    for i in range(1, steps + 1):
        t = min(i * spacing, 1.0)
        # a look that depends on the one before would wait for memory
        number = quarter_at(cell_x + t * over, cell_y + t * up, place)
        hidden |= not (clear[number >> 3] >> (number & 7)) & 1
    return not hidden


@jit
def _entry(keys, number):
    """Return where the entry of a number is in a `WaypointTable`."""
    low, high = 0, len(keys) - 1
    if high < 0:
        return number
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < number:
            low = middle + 1
        else:
            high = middle
    return low


@compiled(
    "void(f4[:,:,:], i8[:,:], i8[:], f4[:,:], f4[:,:], f8,"
    " f4[:,:], i8[:,:], i4[:], f4[:], f4[:], i8[:,:], f4[:,:], i8[:], i4[:], f4[:],"
    " f8[:,:], i4[:,:], f8[:], u1[:],"
    " f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:])"
)
def guidance_loop(
    points, goals, rows, poses, speeds, seconds,
    to_cell, begin, nearest, xs, ys, goal_table, ends, keys, waypoints, lengths,
    affine, place, side, clear,
    carrot, desired, waypoint_out, goal_out, distance_out,
):  # fmt: skip
    """Write every agent's carrot, desired velocity, waypoint, goal and way: see `Planner.guidance`.

    Args are the arrays of the agents (B, A, ...), of `WaypointTable`, of `Walls`, and the results.
    """
    scenes, agents = goals.shape
    frame, quarters = np.empty(7), np.empty(3, np.int64)
    corner, end = np.empty(2), np.empty(2)
    homes, entries = np.empty((scenes, agents, 2)), np.empty((3, scenes, agents), np.int64)
    onwards = np.empty((scenes, agents), np.float32)
    # one look-up after the other waits for memory: each is made for all agents before the next
    for b in range(scenes):
        number = rows[b] + 1
        cos, sin, mirror = math.cos(poses[b, 0]), math.sin(poses[b, 0]), poses[b, 1]
        for a in range(agents):
            x, y = points[b, a, 0] - poses[b, 2], points[b, a, 1] - poses[b, 3]
            x, y = cos * x + sin * y, (cos * y - sin * x) * mirror
            homes[b, a, 0], homes[b, a, 1] = x, y
            column = math.ceil(to_cell[0, number] * x + to_cell[1, number] * y + to_cell[2, number] - 0.5)
            line = math.ceil(to_cell[3, number] * x + to_cell[4, number] * y + to_cell[5, number] - 0.5)
            column = min(max(column, 0.0), to_cell[6, number])
            line = min(max(line, 0.0), to_cell[7, number])
            entries[0, b, a] = nearest[begin[1, number] + int(line) * begin[0, number] + int(column)]
    for b in range(scenes):
        for a in range(agents):
            goal = goals[b, a]
            entry = goal_table[0, goal + 1] + (entries[0, b, a] if goal >= 0 else 0)
            entries[1, b, a] = waypoints[_entry(keys, entry)]
    for b in range(scenes):
        for a in range(agents):
            entry = _entry(keys, goal_table[0, goals[b, a] + 1] + entries[1, b, a])
            entries[2, b, a], onwards[b, a] = waypoints[entry], lengths[entry]
    for b in range(scenes):
        row = rows[b]
        number = row + 1
        wall_row = row if row >= 0 else affine.shape[1] - 1
        frame[0], frame[2], frame[4] = affine[0, wall_row], affine[1, wall_row], affine[4, wall_row]
        frame[1], frame[3], frame[5] = affine[2, wall_row], affine[3, wall_row], affine[5, wall_row]
        frame[6] = side[wall_row]
        quarters[0], quarters[1], quarters[2] = place[0, wall_row], place[1, wall_row], place[2, wall_row]
        cos, sin, mirror = math.cos(poses[b, 0]), math.sin(poses[b, 0]), poses[b, 1]
        shift_x, shift_y = poses[b, 2], poses[b, 3]
        for a in range(agents):
            home, onward = homes[b, a], onwards[b, a]
            cell, first, second = entries[0, b, a], entries[1, b, a], entries[2, b, a]
            goal = goals[b, a]
            count, of_map = goal_table[1, goal + 1], goal_table[2, goal + 1]
            opens = begin[2, number]
            is_last = second == count
            goal_x, goal_y = ends[0, goal + 1], ends[1, goal + 1]
            way_x, way_y, after_x, after_y = goal_x, goal_y, goal_x, goal_y
            if first != count:
                way_x, way_y = xs[first + opens], ys[first + opens]
            if not is_last:
                after_x, after_y = xs[second + opens], ys[second + opens]
            near_x, near_y = xs[cell + opens], ys[cell + opens]
            if of_map > 0 and (home[0] - near_x) ** 2 + (home[1] - near_y) ** 2 > to_cell[8, number]:
                onward = onward + math.hypot(way_x - near_x, way_y - near_y)
                is_last = first == count
                after_x, after_y, way_x, way_y = way_x, way_y, near_x, near_y
            if goal < 0:
                goal_x, goal_y = home[0], home[1]
            if goal < 0 or math.isinf(onward):
                way_x, way_y, after_x, after_y, is_last = home[0], home[1], home[0], home[1], True
            to_x, to_y = way_x - home[0], way_y - home[1]
            length = math.sqrt(to_x * to_x + to_y * to_y)
            next_x, next_y = after_x - way_x, after_y - way_y
            second_length = math.sqrt(next_x * next_x + next_y * next_y)
            if second_length < _EPSILON:
                beyond_x, beyond_y = to_x / max(length, _EPSILON), to_y / max(length, _EPSILON)
            else:
                beyond_x, beyond_y = next_x / second_length, next_y / second_length
            ahead = speeds[b, a] * seconds
            rest = max(ahead - length, 0.0)
            if not is_last:
                rest = min(rest, second_length)
            if rest > 0:
                corner[0], corner[1] = way_x, way_y
                end[0], end[1] = way_x + beyond_x * rest, way_y + beyond_y * rest
                if not _sees(home, corner, end, 1.0, frame, quarters, clear):
                    if _sees(home, corner, end, 0.5, frame, quarters, clear):
                        rest *= 0.5
                    elif _sees(home, corner, end, 0.25, frame, quarters, clear):
                        rest *= 0.25
                    else:
                        rest = 0.0
            if length < _EPSILON:
                unit_x, unit_y = beyond_x, beyond_y
            else:
                unit_x, unit_y = to_x / length, to_y / length
            if length >= ahead:
                carrot_x, carrot_y = home[0] + unit_x * ahead, home[1] + unit_y * ahead
            else:
                carrot_x, carrot_y = way_x + beyond_x * rest, way_y + beyond_y * rest
            speed = speeds[b, a]
            for out, px, py, moved in (
                (carrot, carrot_x, carrot_y, 1.0),
                (desired, unit_x * speed, unit_y * speed, 0.0),
                (waypoint_out, way_x, way_y, 1.0),
                (goal_out, goal_x, goal_y, 1.0),
            ):
                py = py * mirror
                out[b, a, 0] = cos * px - sin * py + moved * shift_x
                out[b, a, 1] = sin * px + cos * py + moved * shift_y
            distance_out[b, a] = length + onward
