"""Parts of the safety layer's compiled loops: walks, pairs and walls, as in `clearance`.

Constants are arguments: numba's cache does not notice when they change in another file. For the same reason
delete ``__pycache__/clearance_*.nbi`` after a change here.
"""

import math

import numpy as np

from pedzoo.core.compiled import jit
from pedzoo.maps.walls.compiled import quarter, wall_gap


@jit
def length(x, y):
    """Return the length of (x, y), with a slope at zero."""
    return math.sqrt(x * x + y * y + 1e-9)


@jit
def limited(x, y, longest):
    """Return (x, y) shortened to at most ``longest``."""
    share = min(longest / math.sqrt(max(x * x + y * y, 1e-12)), 1.0)
    return x * share, y * share


@jit
def walk(x, y, before_x, before_y, longest, blends, path):
    """Write where a step (x, y) is after its first, third and last quarter, path (6,).

    See `ProposedSteps.integrate`.
    """
    if not blends:
        path[0], path[1], path[2], path[3], path[4], path[5] = 0.25 * x, 0.25 * y, 0.75 * x, 0.75 * y, x, y
        return
    command_x, command_y = 0.25 * x, 0.25 * y
    half_x, half_y = 0.5 * (before_x - command_x), 0.5 * (before_y - command_y)
    size = math.sqrt(half_x * half_x + half_y * half_y + 1e-12)
    share = min(math.sqrt(command_x * command_x + command_y * command_y + 1e-12) / size, 1.0)
    half_x, half_y = half_x * share, half_y * share
    most = 0.25 * longest
    path[0], path[1] = limited(command_x + half_x, command_y + half_y, most)
    next_x, next_y = limited(command_x - 0.5 * half_x, command_y - 0.5 * half_y, most)
    path[2], path[3] = path[0] + 2 * next_x, path[1] + 2 * next_y
    path[4], path[5] = path[2] + command_x, path[3] + command_y


@jit
def nearest(x, y, to_x, to_y):
    """Return at which part of a move from (x, y) zero is nearest, that place and its distance."""
    part = -(x * to_x + y * to_y) / max(to_x * to_x + to_y * to_y, 1e-9)
    part = min(max(part, 0.0), 1.0)
    x, y = x + part * to_x, y + part * to_y
    return part, x, y, length(x, y)


@jit
def closest(x, y, mine, theirs, room, firm, rest, blends, first, beyond):
    """Return how much room two lack where they lack most, and where that is.

    That is one of four straight parts, how much of it is walked, the relative place (x, y) and the distance.
    """
    along, at_x, at_y, gap = nearest(x, y, mine[4] - theirs[4], mine[5] - theirs[5])
    lack, part = room - gap, 0
    if blends:
        to_x, to_y = mine[0] - theirs[0], mine[1] - theirs[1]
        share, near_x, near_y, near = nearest(x, y, to_x, to_y)
        if firm - near > lack:
            lack, part, along, at_x, at_y, gap = firm - near, 1, share, near_x, near_y, near
        share, near_x, near_y, near = nearest(
            x + to_x, y + to_y, mine[2] - theirs[2] - to_x, mine[3] - theirs[3] - to_y
        )
        if firm - near > lack:
            lack, part, along, at_x, at_y, gap = firm - near, 2, share, near_x, near_y, near
    if beyond > 1:
        near_x, near_y = x + beyond * (mine[4] - theirs[4]), y + beyond * (mine[5] - theirs[5])
        near = length(near_x, near_y)
        if rest - near > lack:
            lack, part, along, at_x, at_y, gap = rest - near, 3, 1.0, near_x, near_y, near
    if gap < 1e-3:  # exactly head-on: both keep to the right
        apart = length(x, y)
        lack, at_x, at_y, gap = lack + gap - 1e-3, -1e-3 * y / apart, 1e-3 * x / apart, 1e-3
    return lack, part, along, at_x, at_y, gap


@jit
def weight_of(part, along, first, beyond):
    """Return how much the place on a straight part moves with the step."""
    if part == 0:
        return along
    if part == 1:
        return along * first
    if part == 2:
        return first + along * (0.75 - first)
    return beyond


@jit
def way_back(line_x, line_y, apart, room, firm, rest, mine, theirs, blends, first, beyond):
    """Return by how much a step lacks room along the line between two, and which demand is the greatest."""
    full = line_x * (mine[4] - theirs[4]) + line_y * (mine[5] - theirs[5])
    back, demand = room - apart - full, 0
    if blends:
        along = line_x * (mine[0] - theirs[0]) + line_y * (mine[1] - theirs[1])
        if (firm - apart - along) / first > back:
            back, demand = (firm - apart - along) / first, 1
        if (rest - apart) / beyond - full > back:
            back, demand = (rest - apart) / beyond - full, 2
    return max(back, 0.0), demand


@jit
def place_on(path, n, first, beyond):
    """Return the place after ``n`` eighths of a walk, the ninth being beyond its end, and its weight."""
    if n == 9:
        return beyond * path[4], beyond * path[5], beyond
    if n <= 2:
        return 0.5 * n * path[0], 0.5 * n * path[1], 0.5 * n * first
    if n <= 6:
        part = 0.25 * (n - 2)
        x, y = path[0] + part * (path[2] - path[0]), path[1] + part * (path[3] - path[1])
        return x, y, first + part * (0.75 - first)
    part = 0.5 * (n - 6)
    x, y = path[2] + part * (path[4] - path[2]), path[3] + part * (path[5] - path[3])
    return x, y, 0.75 + 0.25 * part


@jit
def push(x, y, path, room, first, beyond, frame, place, choice, option, bound, limit):
    """Return the change of a step that its worst place asks for (x, y).

    Also return whether any place is too near, and which is the worst, 0 for none.
    """
    most, push_x, push_y, worst, outside, lacks = 0.0, 0.0, 0.0, 0, False, False
    for everywhere in range(2):
        for n in range(1, 10 if beyond > 1 else 9):
            off_x, off_y, weight = place_on(path, n, first, beyond)
            _, _, index = quarter(x + off_x, y + off_y, frame, place)
            if bound[index] > max(room, 0.0):
                outside = True
                continue
            gap, away_x, away_y = wall_gap(x + off_x, y + off_y, frame, place, choice, option, limit)
            outside, lacks = outside or gap > 0, lacks or gap < room
            if (gap > 0 or everywhere) and (room - gap) / weight > most:
                most, push_x, push_y, worst = (room - gap) / weight, away_x, away_y, n
        if outside:
            break
    return most * push_x, most * push_y, lacks, worst


@jit
def touches_wall(x, y, path, least, frame, place, choice, option, bound, limit):
    """Return whether a walk comes nearer to a wall than ``least``."""
    for n in range(1, 9):
        off_x, off_y, _ = place_on(path, n, 0.25, 1.0)
        _, _, index = quarter(x + off_x, y + off_y, frame, place)
        if bound[index] < least:
            gap, _, _ = wall_gap(x + off_x, y + off_y, frame, place, choice, option, limit)
            if gap < least:
                return True
    return False


@jit
def correction(x, y, apart, room, firm, rest, mine, theirs, blends, first, beyond, rounding):
    """Return whether two come too near, and the change of their relative step that prevents it."""
    lack, part, along, at_x, at_y, gap = closest(x, y, mine, theirs, room, firm, rest, blends, first, beyond)
    if lack <= rounding:
        return False, 0.0, 0.0
    line_x, line_y = x / apart, y / apart
    back, _ = way_back(line_x, line_y, apart, room, firm, rest, mine, theirs, blends, first, beyond)
    aside = lack / max(weight_of(part, along, first, beyond), 1e-3)
    if aside < back:
        share = min(aside, 1e3) / gap
        return True, share * at_x, share * at_y
    return True, back * line_x, back * line_y


@jit
def precedence(x, y, mine, theirs, velocity, other_velocity, wait, rank, constants):
    """Return how clearly an agent at (x, y) from another goes first: see `precedence.precedence`."""
    ahead, tie, _, least, seconds, _ = constants
    size = max(math.sqrt(mine[0] * mine[0] + mine[1] * mine[1]), least)
    other = max(math.sqrt(theirs[0] * theirs[0] + theirs[1] * theirs[1]), least)
    lead = 0.5 * (x * (mine[0] / size + theirs[0] / other) + y * (mine[1] / size + theirs[1] / other))
    lead += seconds * (mine[0] * velocity[0] + mine[1] * velocity[1]) / size
    lead -= seconds * (theirs[0] * other_velocity[0] + theirs[1] * other_velocity[1]) / other
    lead = (lead + tie * np.sign(rank)) / tie if wait else lead / ahead
    return min(max(lead, -1.0), 1.0)


@jit
def meetings(
    position, step, velocity, longest, present, moved, waits, radius, robot, rank, narrow, margin, shoulders,
    order, beyond, members, number, stands,
):  # fmt: skip
    """Write the pairs of a scene that may come too near, and return their number.

    Args are the agents' (A, ...), constants, those of precedence in a tuple, and the results: the agents of
    each pair (N, 2); of each pair (9, N) the place, the distance, the wanted, firm and untouchable room, both
    shares, and the room after the step; and which agents stand to make way (A,).
    """
    pairs = 0
    stands[:] = False
    shift = 0.5 - order[2]
    for a in range(len(moved)):
        for o in range(a):
            if not (present[a] and present[o] and (moved[a] or moved[o])):
                continue
            x, y = position[a, 0] - position[o, 0], position[a, 1] - position[o, 1]
            distance, bodies = length(x, y), radius[a] + radius[o]
            most, wait = bodies + margin, waits[a] and waits[o]
            broad = (narrow[a] or narrow[o]) and not wait
            reach = longest[a] if moved[a] else length(step[a, 0], step[a, 1])
            reach += longest[o] if moved[o] else length(step[o, 0], step[o, 1])
            if distance > (max(most, shoulders) if broad else most) + beyond * reach + margin:
                continue
            yields, other = moved[a] and not robot[a], moved[o] and not robot[o]
            gives, other_gives = yields or (moved[a] and not other), other or (moved[o] and not yields)
            share = 0.5 if gives and other_gives else 1.0
            share, other_share, room = share * gives, share * other_gives, shoulders
            rest = min(distance, bodies + margin) if distance >= bodies else bodies + margin
            if yields and other:
                first = precedence(
                    x, y, step[a], step[o], velocity[a], velocity[o], wait, rank[a] - rank[o], order
                )  # fmt: skip
                share, other_share = share - shift * first, share + shift * first
                if wait and first != 0 and beyond > 1:
                    rest = bodies + margin + order[5]
                if (broad or wait) and first != 0:
                    mine = nearest(x, y, step[a, 0], step[a, 1])
                    theirs = nearest(-x, -y, step[o, 0], step[o, 1])
                    past, press = (mine, theirs) if first > 0 else (theirs, mine)
                    if abs(first) > 0.5 and past[0] > 0:
                        room = min(room, past[3])
                    near = bodies + margin
                    holds_up = past[0] > 0 and past[3] < near
                    if wait and (
                        holds_up or (press[0] > 0 and press[3] < near and distance < near + order[5])
                    ):
                        stands[o if first > 0 else a] = True
            if broad:
                most = max(most, room)
            members[pairs, 0], members[pairs, 1] = a, o
            number[0, pairs], number[1, pairs], number[2, pairs] = x, y, distance
            number[3, pairs], number[4, pairs] = min(distance, most), min(distance, bodies + margin)
            number[5, pairs] = min(distance, bodies + 0.004) - 1e-4
            number[6, pairs], number[7, pairs], number[8, pairs] = share, other_share, rest
            pairs += 1
    return pairs
