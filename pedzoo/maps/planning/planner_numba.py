"""The planner's loops, compiled by numba: lines of sight, and the way of one agent after the other."""

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.maps.constants import EPSILON, ON_LINE, SPACING
from pedzoo.maps.walls_numba import in_half_cells, quarter_at


@jit
def _is_clear(leap, width, cells, x, y, to_x, to_y):
    """Return whether the line between two open cells is clear: see `Sight`, which has the table."""
    x_way, y_way = to_x - x, to_y - y
    steep = abs(y_way) > abs(x_way)
    along, across = (y_way, x_way) if steep else (x_way, y_way)
    steps = abs(along)
    slope = across / max(steps, 1)
    # flat index = base + column * forward + floor(height) * sideways, columns counted along the line
    forward, sideways = (width, 1) if steep else (1, width)
    base = y * width + x + (cells if across == 0 else 0)
    if along < 0:
        base -= forward  # squares are named by their smallest corner
        forward = -forward
    column = 0
    while column < steps:
        begin = slope * column
        end = begin + slope
        low = math.floor(min(begin, end) + ON_LINE)
        high = max(math.ceil(max(begin, end) - ON_LINE) - 1, low)
        at = base + column * forward
        room = min(leap[at + low * sideways], leap[at + high * sideways])
        if room == 0:
            return False
        column += room
    return True


@compiled("void(i2[:], i8, i8, i4[:,:], i4[:,:], b1[:])")
def clear_lines(leap, width, cells, origin, target, seen):
    """Write which lines (M,) from and to columns and rows of open cells (M, 2) are clear: see `Sight`."""
    for m in range(len(seen)):
        seen[m] = _is_clear(leap, width, cells, origin[m, 0], origin[m, 1], target[m, 0], target[m, 1])


@jit
def _slot(key, slots):
    # bits that all of the key's have a part in: those of the goal are its highest
    return ((key * -7046029254386353131) >> 32) & (slots - 1)


@jit
def _square(goal, x, y, right, up):
    """Return the number of a goal and of the square of 16 cells at, or beside, a column and row."""
    return (goal << 26) + (((y >> 4) + up + 1) << 13) + (x >> 4) + right + 1


@jit
def _first_corner(ways, memory, cell, goal, on_map):
    """Return the corner where the path from an open cell to a goal bends first.

    It is -1 where the path is straight, and -2 where none leads there, as from row ``on_map`` of another map.
    """
    number, at = ways.goal[0, goal + 1], ways.goal[1, goal + 1]
    if number == 0:
        return -1
    if number != on_map:
        return -2
    key = goal * len(ways.x) + cell
    slot = _slot(key, len(memory.key))
    if memory.key[slot] == key:
        return memory.corner[slot]
    x, y, to_x, to_y = ways.place[0, cell], ways.place[1, cell], ways.place[0, at], ways.place[1, at]
    _, first_cell, _, cells, begin, count = ways.begin[:, number]
    width, metre, offset = ways.begin[0, number], ways.metre[number], ways.goal[2, goal + 1]
    leap = ways.leap[2 * first_cell :]
    found, least, length, guess = -2, 0.0, math.inf, -1
    if _is_clear(leap, width, cells, x, y, to_x, to_y):
        found, length, count = -1, metre * math.hypot(float(to_x - x), float(to_y - y)), 0
    # what is known of a place nearby bounds the length, by the triangle inequality
    for right, up in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        if count == 0:
            break
        square = _square(goal, x, y, right, up)
        tile = _slot(square, len(memory.tile))
        if memory.tile[tile] != square:
            continue
        near_x, near_y = ways.place[0, memory.cell[tile]], ways.place[1, memory.cell[tile]]
        if _is_clear(leap, width, cells, x, y, near_x, near_y):
            # goals lie up to 0.71 cells beside the centre of theirs
            away = metre * (math.hypot(float(near_x - x), float(near_y - y)) + 1.5)
            least, length = memory.length[tile] - away, memory.length[tile] + away
            guess = memory.bend[tile]
            break
    for i in range(-1, count):
        # the first corner of that place comes first
        k = begin + i if i >= 0 else guess
        if k < 0:
            continue
        dx, dy = ways.bend_x[k] - x, ways.bend_y[k] - y
        total = math.sqrt(dx * dx + dy * dy) * metre + ways.far[offset + k]
        if total < least or not total <= length or total == math.inf or (total == length and k >= found):
            continue
        slope = dx * dy
        falls, rises = ways.bends[0, k] and slope <= 0, ways.bends[1, k] and slope >= 0
        if (dx == 0 and dy == 0) or not (falls or rises):
            continue
        if _is_clear(leap, width, cells, x, y, int(ways.bend_x[k]), int(ways.bend_y[k])):
            found, length = k, total
    memory.key[slot], memory.corner[slot] = key, found
    if found > -2:
        square = _square(goal, x, y, 0, 0)
        tile = _slot(square, len(memory.tile))
        memory.tile[tile], memory.cell[tile] = square, cell
        memory.length[tile], memory.bend[tile] = length, found
    return found


@jit
def first_corners(ways, memory, cells, goals, found):
    """Write the first corners of the ways from open cells (P,) to goals (P,): see `_first_corner`."""
    for i in range(len(cells)):
        found[i] = _first_corner(ways, memory, cells[i], goals[i], ways.goal[0, goals[i] + 1])


@jit
def _sees(home, corner, end, part, frame, place, clear):
    """Return whether points 0.3 m apart of the line to a carrot keep a body's radius from walls."""
    full = math.sqrt((end[0] - home[0]) ** 2 + (end[1] - home[1]) ** 2)
    spacing = SPACING / max(full, SPACING)
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
def guide(points, goals, rows, poses, speeds, seconds, ways, memory, walls, guidance):
    """Write every agent's carrot, desired velocity, waypoint, goal and way: see `Planner.guidance`.

    Args are the arrays of agents (B, A, ...), `Ways`, `Memory`, `Walls.map_arrays`, and a `Guidance` of
    arrays.
    """
    affine, quarters, side, clear = walls
    frame, quarter = np.empty(7), np.empty(3, np.int64)
    home, corner, end = np.empty(2), np.empty(2), np.empty(2)
    for b in range(goals.shape[0]):
        number = rows[b] + 1
        row = rows[b] if rows[b] >= 0 else affine.shape[1] - 1
        frame[0], frame[2], frame[4] = affine[0, row], affine[1, row], affine[4, row]
        frame[1], frame[3], frame[5] = affine[2, row], affine[3, row], affine[5, row]
        frame[6] = side[row]
        quarter[0], quarter[1], quarter[2] = quarters[0, row], quarters[1, row], quarters[2, row]
        cos, sin, mirror = math.cos(poses[b, 0]), math.sin(poses[b, 0]), poses[b, 1]
        shift_x, shift_y = poses[b, 2], poses[b, 3]
        to_cell, begin = ways.to_cell[:, number], ways.begin[:, number]
        for a in range(goals.shape[1]):
            goal, speed = goals[b, a], speeds[b, a]
            x, y = points[b, a, 0] - shift_x, points[b, a, 1] - shift_y
            x, y = cos * x + sin * y, (cos * y - sin * x) * mirror
            home[0], home[1] = x, y
            # half cells belong to the smaller one, as in OpenGraph.locate
            column = math.ceil(to_cell[0] * x + to_cell[1] * y + to_cell[2] - 0.5)
            line = math.ceil(to_cell[3] * x + to_cell[4] * y + to_cell[5] - 0.5)
            column = min(max(column, 0.0), to_cell[6])
            line = min(max(line, 0.0), to_cell[7])
            cell = ways.nearest[begin[1] + int(line) * begin[0] + int(column)] + begin[2]
            goal_x, goal_y = ways.end[0, goal + 1], ways.end[1, goal + 1]
            way_x, way_y, after_x, after_y = goal_x, goal_y, goal_x, goal_y
            first, is_last, onward = -1, True, 0.0
            if goal >= 0:
                first = _first_corner(ways, memory, cell, goal, number)
            if first >= 0:
                at = ways.goal[2, goal + 1] + first
                onward, second = ways.far[at], ways.onward[at]
                way_x, way_y = ways.x[ways.corner[first]], ways.y[ways.corner[first]]
                is_last = second < 0
                if not is_last:
                    after_x, after_y = ways.x[ways.corner[second]], ways.y[ways.corner[second]]
            near_x, near_y = ways.x[cell], ways.y[cell]
            outside = (home[0] - near_x) ** 2 + (home[1] - near_y) ** 2 > to_cell[8]
            if ways.goal[0, goal + 1] > 0 and outside:
                onward = onward + math.hypot(way_x - near_x, way_y - near_y)
                is_last = first < 0
                after_x, after_y, way_x, way_y = way_x, way_y, near_x, near_y
            if goal < 0:
                goal_x, goal_y = home[0], home[1]
            if first == -2:
                onward = math.inf
            if goal < 0 or first == -2:
                way_x, way_y, after_x, after_y, is_last = home[0], home[1], home[0], home[1], True
            to_x, to_y = way_x - home[0], way_y - home[1]
            length = math.sqrt(to_x * to_x + to_y * to_y)
            next_x, next_y = after_x - way_x, after_y - way_y
            second_length = math.sqrt(next_x * next_x + next_y * next_y)
            if second_length < EPSILON:
                beyond_x, beyond_y = to_x / max(length, EPSILON), to_y / max(length, EPSILON)
            else:
                beyond_x, beyond_y = next_x / second_length, next_y / second_length
            ahead = speed * seconds
            rest = max(ahead - length, 0.0)
            if not is_last:
                rest = min(rest, second_length)
            if rest > 0:
                corner[0], corner[1] = way_x, way_y
                end[0], end[1] = way_x + beyond_x * rest, way_y + beyond_y * rest
                if not _sees(home, corner, end, 1.0, frame, quarter, clear):
                    if _sees(home, corner, end, 0.5, frame, quarter, clear):
                        rest *= 0.5
                    elif _sees(home, corner, end, 0.25, frame, quarter, clear):
                        rest *= 0.25
                    else:
                        rest = 0.0
            if length < EPSILON:
                unit_x, unit_y = beyond_x, beyond_y
            else:
                unit_x, unit_y = to_x / length, to_y / length
            if length >= ahead:
                carrot_x, carrot_y = home[0] + unit_x * ahead, home[1] + unit_y * ahead
            else:
                carrot_x, carrot_y = way_x + beyond_x * rest, way_y + beyond_y * rest
            for out, px, py, moved in (
                (guidance.goal, carrot_x, carrot_y, 1.0),
                (guidance.desired_velocity, unit_x * speed, unit_y * speed, 0.0),
                (guidance.waypoint, way_x, way_y, 1.0),
                (guidance.goal_point, goal_x, goal_y, 1.0),
            ):
                py = py * mirror
                out[b, a, 0] = cos * px - sin * py + moved * shift_x
                out[b, a, 1] = sin * px + cos * py + moved * shift_y
            guidance.distance[b, a] = length + onward
