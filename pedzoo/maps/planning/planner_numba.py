"""The planner's loops, compiled by numba: lines of sight, and the way of one agent after the other."""

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.maps.constants import EPSILON, LED_ON, ON_LINE, SPACING
from pedzoo.maps.walls_numba import in_half_cells, quarter_at

_MARGIN = int(ON_LINE * 2**40)

ASKED = 5
"""Questions from a cell that cost as much as to find all corners in sight of it: then that is done."""


@jit
def _is_clear(leap, width, cells, x, y, to_x, to_y):
    """Return whether the line between two open cells is clear: see `Sight`, which has the table."""
    if to_x < x or (to_x == x and to_y < y):
        x, y, to_x, to_y = to_x, to_y, x, y  # a line is as clear as its reverse
    right, up = to_x - x, abs(to_y - y)
    vertical = width if to_y >= y else -width
    steps, across = max(right, up), min(right, up)
    # flat index = base + column * forward + floor(height) * sideways, columns counted along the line
    forward, sideways = (vertical, 1) if up > right else (1, vertical)
    base = y * width + x
    if across == 0:
        base += 2 * cells
    elif vertical < 0:
        base += cells - width  # squares are named by their smallest corner
    # heights are whole numbers of 2 ** -40 cells: several times faster than rounding
    slope = (across << 40) // max(steps, 1)
    column = 0
    while column < steps:
        begin = slope * column
        low = (begin + _MARGIN) >> 40
        at = base + column * forward
        room = leap[at + low * sideways]
        if room == 1:
            high = max((begin + slope - _MARGIN) >> 40, low)
            room += min(leap[at + high * sideways], 1)
        if room < 2:
            return False
        column += room - 1
    return True


@compiled("void(i2[:], i8, i8, i4[:,:], i4[:,:], b1[:])")
def clear_lines(leap, width, cells, origin, target, seen):
    """Write which lines (M,) from and to columns and rows of open cells (M, 2) are clear: see `Sight`."""
    for m in range(len(seen)):
        seen[m] = _is_clear(leap, width, cells, origin[m, 0], origin[m, 1], target[m, 0], target[m, 1])


@jit
def _bends(falls, rises, dx, dy):
    """Return whether a path that comes by ``dx, dy`` cells may bend at a corner: see `CornerGraph`."""
    slope = dx * dy
    return (dx != 0 or dy != 0) and ((falls and slope <= 0) or (rises and slope >= 0))


@jit
def _look_around(ways, memory, cell, number):
    """Remember at which corners paths from an open cell may bend first: they are the same for all goals."""
    width, first_cell, _, cells, begin, count = ways.begin[:, number]
    bend_x, bend_y, bends, leap, seen = ways.bend_x, ways.bend_y, ways.bends, ways.leap, memory.seen
    leap = leap[3 * first_cell :]
    if seen[0] + count + 2 > len(seen):
        memory.start[:] = 0
        seen[0] = 0
    at = seen[0] + 1
    end = at + 1
    x, y = ways.place[0, cell], ways.place[1, cell]
    for k in range(begin, begin + count):
        if _bends(bends[0, k], bends[1, k], bend_x[k] - x, bend_y[k] - y) and _is_clear(
            leap, width, cells, x, y, int(bend_x[k]), int(bend_y[k])
        ):
            seen[end] = k
            end += 1
    seen[0], seen[at], memory.start[cell] = end - 1, end, at


@jit
def _near(slots, goal, x, y):
    """Return in which of the memory's slots the square of 16 cells at a column and row is, and its number."""
    square = (goal << 26) + (((y >> 4) + 1) << 13) + (x >> 4) + 1  # beside the plan, too, it is not negative
    # bits that all of the number's have a part in: those of the goal are its highest
    return ((square * -7046029254386353131) >> 32) & (slots - 1), square


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
    if len(ways.first) > 1:
        return ways.first[ways.goal[3, goal + 1] + cell]
    x, y, to_x, to_y = ways.place[0, cell], ways.place[1, cell], ways.place[0, at], ways.place[1, at]
    _, first_cell, _, cells, begin, count = ways.begin[:, number]
    width, metre, offset = ways.begin[0, number], ways.metre[number], ways.goal[2, goal + 1]
    # names: looking an array up in the tuple costs more than a corner does
    bend_x, bend_y, bends, far, seen = ways.bend_x, ways.bend_y, ways.bends, ways.far, memory.seen
    leap = ways.leap[3 * first_cell :]
    if _is_clear(leap, width, cells, x, y, to_x, to_y):
        return -1
    found, length = -2, math.inf
    first = memory.start[cell]
    if first > 0:
        for i in range(first + 1, seen[first]):
            k = seen[i]
            dx, dy = bend_x[k] - x, bend_y[k] - y
            total = math.sqrt(dx * dx + dy * dy) * metre + far[offset + k]
            if total < length:
                found, length = k, total
        return found
    least, guess = 0.0, -1
    # what is known of a place nearby bounds the length, by the triangle inequality
    for aside, up in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        slot, square = _near(len(memory.square), goal, x + 16 * aside, y + 16 * up)
        if memory.square[slot] != square:
            continue
        if memory.cell[slot] == cell:
            return memory.bend[slot]
        near_x, near_y = ways.place[0, memory.cell[slot]], ways.place[1, memory.cell[slot]]
        if _is_clear(leap, width, cells, x, y, near_x, near_y):
            # goals lie up to 0.71 cells beside the centre of theirs
            away = metre * (math.hypot(float(near_x - x), float(near_y - y)) + 1.5)
            least, length = memory.length[slot] - away, memory.length[slot] + away
            guess = memory.bend[slot]
            break
    memory.start[cell] -= 1
    if memory.start[cell] == -ASKED:
        _look_around(ways, memory, cell, number)
    for i in range(-1, count):
        # the first corner of that place comes first
        k = begin + i if i >= 0 else guess
        if k < 0:
            continue
        # roots are taken of few
        dx, dy, rest = bend_x[k] - x, bend_y[k] - y, length - far[offset + k] + EPSILON
        if not rest > 0 or (dx * dx + dy * dy) * metre * metre > rest * rest:
            continue
        total = math.sqrt(dx * dx + dy * dy) * metre + far[offset + k]
        if total < least or not total <= length or total == math.inf or (total == length and k >= found):
            continue
        if _bends(bends[0, k], bends[1, k], dx, dy) and _is_clear(
            leap, width, cells, x, y, int(bend_x[k]), int(bend_y[k])
        ):
            found, length = k, total
    if found >= 0:
        slot, square = _near(len(memory.square), goal, x, y)
        memory.square[slot], memory.cell[slot] = square, cell
        memory.length[slot], memory.bend[slot] = length, found
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
    """Write every agent's short-term goal, desired velocity, waypoint and so on: see `Planner.guidance`.

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
            aim_x, aim_y = carrot_x, carrot_y
            if unit_x != 0 or unit_y != 0:
                to_x, to_y = carrot_x - home[0], carrot_y - home[1]
                lacking = ahead - math.sqrt(to_x * to_x + to_y * to_y)
                if lacking > 0:
                    to_x, to_y = to_x + LED_ON * unit_x, to_y + LED_ON * unit_y
                    lacking /= math.sqrt(to_x * to_x + to_y * to_y)
                    aim_x, aim_y = carrot_x + lacking * to_x, carrot_y + lacking * to_y
            for out, px, py, moved in (
                (guidance.goal, aim_x, aim_y, 1.0),
                (guidance.carrot, carrot_x, carrot_y, 1.0),
                (guidance.desired_velocity, unit_x * speed, unit_y * speed, 0.0),
                (guidance.waypoint, way_x, way_y, 1.0),
                (guidance.goal_point, goal_x, goal_y, 1.0),
            ):
                py = py * mirror
                out[b, a, 0] = cos * px - sin * py + moved * shift_x
                out[b, a, 1] = sin * px + cos * py + moved * shift_y
            guidance.distance[b, a] = length + onward
