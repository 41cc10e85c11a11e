"""The backward pass of `clearance_loops`, from its records: gradients of the safety layer.

They are those of the torch path: parts of a way, shares of steps and directions of walls count as constants.
"""

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.policies.safety_layer.clearance_parts import (
    closest,
    correction,
    limited,
    meetings,
    place_on,
    walk,
    way_back,
    weight_of,
)


@jit
def limited_slope(x, y, longest, of_x, of_y):
    """Return the gradient by (x, y) of what `limited` makes of it, for that of the result."""
    size2 = x * x + y * y
    share = longest / math.sqrt(max(size2, 1e-12))
    if share >= 1:
        return of_x, of_y
    along = (of_x * x + of_y * y) / size2 if size2 > 1e-12 else 0.0
    return share * (of_x - along * x), share * (of_y - along * y)


@jit
def place_slope(n, beyond, of_x, of_y, out):
    """Write the gradient by a walk, out (6,), for that of its place ``n``: see `place_on`."""
    out[:] = 0.0
    if n == 9:
        out[4], out[5] = beyond * of_x, beyond * of_y
    elif n <= 2:
        out[0], out[1] = 0.5 * n * of_x, 0.5 * n * of_y
    else:
        at, part = (0, 0.25 * (n - 2)) if n <= 6 else (2, 0.5 * (n - 6))
        out[at], out[at + 1] = (1 - part) * of_x, (1 - part) * of_y
        out[at + 2], out[at + 3] = part * of_x, part * of_y


@jit
def walk_slope(x, y, before_x, before_y, longest, blends, of_path, out):
    """Write gradients by the step and by the velocity before, out (4,), for that of the path (6,)."""
    begin_x, begin_y, middle_x, middle_y, end_x, end_y = of_path
    if not blends:
        out[0] = 0.25 * begin_x + 0.75 * middle_x + end_x
        out[1] = 0.25 * begin_y + 0.75 * middle_y + end_y
        out[2], out[3] = 0.0, 0.0
        return
    command_x, command_y = 0.25 * x, 0.25 * y
    half_x, half_y = 0.5 * (before_x - command_x), 0.5 * (before_y - command_y)
    size = math.sqrt(half_x * half_x + half_y * half_y + 1e-12)
    commanded = math.sqrt(command_x * command_x + command_y * command_y + 1e-12)
    ratio, most = commanded / size, 0.25 * longest
    share = min(ratio, 1.0)
    middle_x, middle_y = middle_x + end_x, middle_y + end_y
    first_x, first_y = limited_slope(
        command_x + share * half_x, command_y + share * half_y, most, begin_x + middle_x, begin_y + middle_y
    )
    next_x, next_y = limited_slope(
        command_x - 0.5 * share * half_x, command_y - 0.5 * share * half_y, most, 2 * middle_x, 2 * middle_y
    )
    of_command_x, of_command_y = end_x + first_x + next_x, end_y + first_y + next_y
    blend_x, blend_y = first_x - 0.5 * next_x, first_y - 0.5 * next_y
    of_half_x, of_half_y = share * blend_x, share * blend_y
    if ratio < 1:
        of_share = (blend_x * half_x + blend_y * half_y) / size
        of_half_x -= of_share * ratio * half_x / size
        of_half_y -= of_share * ratio * half_y / size
        of_command_x += of_share * command_x / commanded
        of_command_y += of_share * command_y / commanded
    out[0], out[1] = 0.25 * (of_command_x - 0.5 * of_half_x), 0.25 * (of_command_y - 0.5 * of_half_y)
    out[2], out[3] = 0.5 * of_half_x, 0.5 * of_half_y


@jit
def correction_slope(x, y, apart, room, firm, rest, mine, theirs, blends, first, beyond, of_x, of_y, out):
    """Write gradients by the place (x, y) and by the relative walk (6,), out (8,), for a correction's."""
    out[:] = 0.0
    lack, part, along, at_x, at_y, gap = closest(x, y, mine, theirs, room, firm, rest, blends, first, beyond)
    line_x, line_y = x / apart, y / apart
    back, demand = way_back(line_x, line_y, apart, room, firm, rest, mine, theirs, blends, first, beyond)
    weight = max(weight_of(part, along, first, beyond), 1e-3)
    aside, of_apart = lack / weight, 0.0
    if aside < back and gap == 1e-3:
        return  # exactly head-on: constants
    if aside < back:
        share, unit = min(aside, 1e3) / gap, (of_x * at_x + of_y * at_y) / gap
        of_lack = unit / weight if aside < 1e3 else 0.0
        of_gap = -share * unit - of_lack
        go_x, go_y = share * of_x + of_gap * at_x / gap, share * of_y + of_gap * at_y / gap
        out[0], out[1] = go_x, go_y
        if part == 1 or part == 2:
            of_first = along if part == 1 else 1 - along
            out[2], out[3] = of_first * go_x, of_first * go_y
        if part == 2:
            out[4], out[5] = along * go_x, along * go_y
        elif part != 1:
            of_end = along if part == 0 else beyond
            out[6], out[7] = of_end * go_x, of_end * go_y
        if (room if part == 0 else rest if part == 3 else firm) == apart:
            of_apart = of_lack
    elif back > 0:
        of_back = of_x * line_x + of_y * line_y
        of_line_x, of_line_y = back * of_x, back * of_y
        to, weight = (2, first) if demand == 1 else (6, 1.0)
        out[to], out[to + 1] = -of_back * line_x / weight, -of_back * line_y / weight
        point = to - 2
        of_line_x -= of_back / weight * (mine[point] - theirs[point])
        of_line_y -= of_back / weight * (mine[point + 1] - theirs[point + 1])
        # rooms that are the distance itself move with it
        if (room if demand == 0 else rest if demand == 2 else firm) != apart:
            of_apart = -of_back / (beyond if demand == 2 else weight)
        of_apart -= (of_line_x * line_x + of_line_y * line_y) / apart
        out[0], out[1] = of_line_x / apart, of_line_y / apart
    out[0], out[1] = out[0] + of_apart * line_x, out[1] + of_apart * line_y


@compiled(
    "void(f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:], b1[:,:], b1[:,:], b1[:,:], f4[:,:], b1[:,:], f4[:,:], b1,"
    " UniTuple(f8, 6), f8, f8, f8, f8, f8, b1[:,:], f4[:,:,:], f4[:,:], i8[:], f8[:,:,:,:], b1[:,:],"
    " f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:,:])"
)
def keep_clear_slope(
    position, asked, velocity, longest, present, moved, waits, radius, robot, rank, blends,
    order, margin, shoulders, first, beyond, rounding, narrow, slope, shares, used, record, stands, gradient,
    of_position, of_step, of_velocity,
):  # fmt: skip
    """Write gradients (B, A, 2) by positions, steps asked for and velocities, for ``gradient`` of the result.

    The other args are those of `keep_clear`, and its results.
    """
    scenes, agents = moved.shape
    step, path, of_path = np.zeros((agents, 2)), np.zeros((agents, 6)), np.zeros((agents, 6))
    grown, place, asking = np.zeros((agents, 2)), np.zeros((agents, 2)), np.zeros(agents)
    before, pair, out = np.zeros((agents, 2)), np.zeros(8), np.zeros(4)
    members, number = np.zeros((agents * agents, 2), np.int64), np.zeros((9, agents * agents))
    stood = np.zeros(agents, np.bool_)
    from_x, from_y, apart, wanted, firm, _, mine, theirs, rest = number
    for b in range(scenes):
        place[:], before[:] = 0.0, 0.0
        for a in range(agents):
            grown[a, 0], grown[a, 1] = shares[b, a] * gradient[b, a, 0], shares[b, a] * gradient[b, a, 1]
        pairs = 0
        if used[b] > 0:
            for a in range(agents):
                step[a, 0], step[a, 1] = asked[b, a, 0], asked[b, a, 1]
                if moved[b, a]:
                    step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], longest[b, a])
            pairs = meetings(
                position[b], step, velocity[b], longest[b], present[b], moved[b], waits[b], radius[b],
                robot[b], rank[b], narrow[b], margin, shoulders, order, beyond, members, number, stood,
            )  # fmt: skip
        for r in range(used[b] - 1, -1, -1):
            steps = record[b, r]
            asking[:] = 0.0
            for a in range(agents):
                walk(
                    steps[a, 0], steps[a, 1], velocity[b, a, 0], velocity[b, a, 1], longest[b, a],
                    blends and moved[b, a], path[a],
                )  # fmt: skip
            for k in range(pairs):
                a, o = members[k]
                lacks, _, _ = correction(
                    from_x[k], from_y[k], apart[k], wanted[k], firm[k], rest[k], path[a], path[o],
                    blends, first, beyond, rounding,
                )  # fmt: skip
                if lacks:
                    asking[a] += 1
                    asking[o] += 1
            for a in range(agents):
                worst = int(steps[a, 6])
                if not moved[b, a] or (asking[a] == 0 and worst == 0):
                    continue
                grown[a, 0], grown[a, 1] = limited_slope(
                    steps[a, 4], steps[a, 5], longest[b, a], grown[a, 0], grown[a, 1]
                )
                if worst > 0:
                    x, y = steps[a, 4] - steps[a, 2], steps[a, 5] - steps[a, 3]
                    _, _, weight = place_on(path[a], worst, first, beyond)
                    size2 = max(x * x + y * y, 1e-24)
                    along = -(grown[a, 0] * x + grown[a, 1] * y) / (math.sqrt(size2) * weight)
                    x, y = along * x / math.sqrt(size2), along * y / math.sqrt(size2)
                    place[a, 0] += x - along * slope[b, a, 0]
                    place[a, 1] += y - along * slope[b, a, 1]
                    place_slope(worst, beyond, x, y, of_path[a])
                    walk_slope(
                        steps[a, 2], steps[a, 3], velocity[b, a, 0], velocity[b, a, 1], longest[b, a],
                        blends, of_path[a], out,
                    )  # fmt: skip
                    grown[a, 0], grown[a, 1] = grown[a, 0] + out[0], grown[a, 1] + out[1]
                    before[a, 0], before[a, 1] = before[a, 0] + out[2], before[a, 1] + out[3]
            of_path[:] = 0.0
            for k in range(pairs):
                a, o = members[k]
                if asking[a] == 0 or asking[o] == 0:
                    continue
                lacks, _, _ = correction(
                    from_x[k], from_y[k], apart[k], wanted[k], firm[k], rest[k], path[a], path[o],
                    blends, first, beyond, rounding,
                )  # fmt: skip
                if not lacks:
                    continue
                mine_part, their_part = mine[k] / math.sqrt(asking[a]), theirs[k] / math.sqrt(asking[o])
                correction_slope(
                    from_x[k], from_y[k], apart[k], wanted[k], firm[k], rest[k], path[a], path[o],
                    blends, first, beyond, mine_part * grown[a, 0] - their_part * grown[o, 0],
                    mine_part * grown[a, 1] - their_part * grown[o, 1], pair,
                )  # fmt: skip
                for i in range(2):
                    place[a, i] += pair[i]
                    place[o, i] -= pair[i]
                for i in range(6):
                    of_path[a, i] += pair[2 + i]
                    of_path[o, i] -= pair[2 + i]
            for a in range(agents):
                walk_slope(
                    steps[a, 0], steps[a, 1], velocity[b, a, 0], velocity[b, a, 1], longest[b, a],
                    blends and moved[b, a], of_path[a], out,
                )  # fmt: skip
                grown[a, 0], grown[a, 1] = grown[a, 0] + out[0], grown[a, 1] + out[1]
                before[a, 0], before[a, 1] = before[a, 0] + out[2], before[a, 1] + out[3]
        for a in range(agents):
            x, y = grown[a, 0], grown[a, 1]
            if stands[b, a]:
                x, y = 0.0, 0.0
            elif moved[b, a]:
                x, y = limited_slope(asked[b, a, 0], asked[b, a, 1], longest[b, a], x, y)
            of_step[b, a, 0], of_step[b, a, 1] = x, y
            of_position[b, a, 0], of_position[b, a, 1] = place[a, 0], place[a, 1]
            of_velocity[b, a, 0], of_velocity[b, a, 1] = before[a, 0], before[a, 1]
