"""The safety layer in loops that numba compiles: what `pedzoo.models.clearance` says, scene by scene.

A scene is left as soon as nothing in it is to be corrected. Constants are arguments: numba's cache does not
notice when they change in another file.
"""

from __future__ import annotations

import math

import numpy as np

from pedzoo.maps.compiled import compiled, jit, quarter, wall_gap


@jit
def _length(x, y):
    return math.sqrt(x * x + y * y + 1e-9)


@jit
def _limited(x, y, longest):
    share = min(longest / math.sqrt(max(x * x + y * y, 1e-12)), 1.0)
    return x * share, y * share


@jit
def _walk(x, y, before_x, before_y, longest, blends, path):
    """Write where a step (x, y) is after its first, third and last quarter, path (6,): see `walked`."""
    if not blends:
        path[0], path[1], path[2], path[3], path[4], path[5] = 0.25 * x, 0.25 * y, 0.75 * x, 0.75 * y, x, y
        return
    command_x, command_y = 0.25 * x, 0.25 * y
    half_x, half_y = 0.5 * (before_x - command_x), 0.5 * (before_y - command_y)
    size = math.sqrt(half_x * half_x + half_y * half_y + 1e-12)
    share = min(math.sqrt(command_x * command_x + command_y * command_y + 1e-12) / size, 1.0)
    half_x, half_y = half_x * share, half_y * share
    most = 0.25 * longest
    path[0], path[1] = _limited(command_x + half_x, command_y + half_y, most)
    next_x, next_y = _limited(command_x - 0.5 * half_x, command_y - 0.5 * half_y, most)
    path[2], path[3] = path[0] + 2 * next_x, path[1] + 2 * next_y
    path[4], path[5] = path[2] + command_x, path[3] + command_y


@jit
def _nearest(x, y, to_x, to_y):
    """Return at which part of a move from (x, y) zero is nearest, that place and its distance."""
    part = -(x * to_x + y * to_y) / max(to_x * to_x + to_y * to_y, 1e-9)
    part = min(max(part, 0.0), 1.0)
    x, y = x + part * to_x, y + part * to_y
    return part, x, y, _length(x, y)


@jit
def _closest(x, y, mine, theirs, room, firm, blends, first, beyond):
    """Return where two lack most room: how much, its weight (see `weights`), the relative place, the gap."""
    part, at_x, at_y, gap = _nearest(x, y, mine[4] - theirs[4], mine[5] - theirs[5])
    lack, weight = room - gap, part
    if blends:
        to_x, to_y = mine[0] - theirs[0], mine[1] - theirs[1]
        part, near_x, near_y, near = _nearest(x, y, to_x, to_y)
        if firm - near > lack:
            lack, weight, at_x, at_y, gap = firm - near, part * first, near_x, near_y, near
        part, near_x, near_y, near = _nearest(
            x + to_x, y + to_y, mine[2] - theirs[2] - to_x, mine[3] - theirs[3] - to_y
        )
        if firm - near > lack:
            weight = first + part * (0.75 - first)
            lack, at_x, at_y, gap = firm - near, near_x, near_y, near
    if beyond > 1:
        near_x, near_y = x + beyond * (mine[4] - theirs[4]), y + beyond * (mine[5] - theirs[5])
        near = _length(near_x, near_y)
        if firm - near > lack:
            lack, weight, at_x, at_y, gap = firm - near, beyond, near_x, near_y, near
    return lack, weight, at_x, at_y, gap


@jit
def _place(path, n, first, beyond):
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
def _push(x, y, path, room, first, beyond, frame, place, choice, option, bound, limit):
    """Return the change of a step that its worst place asks for (x, y), and whether any is too near."""
    most, push_x, push_y, told, lacks = 0.0, 0.0, 0.0, False, False
    for everywhere in range(2):
        for n in range(1, 10 if beyond > 1 else 9):
            off_x, off_y, weight = _place(path, n, first, beyond)
            _, _, index = quarter(x + off_x, y + off_y, frame, place)
            if bound[index] > max(room, 0.0):
                told = True
                continue
            gap, away_x, away_y = wall_gap(x + off_x, y + off_y, frame, place, choice, option, limit)
            told, lacks = told or gap > 0, lacks or gap < room
            if (gap > 0 or everywhere) and (room - gap) / weight > most:
                most, push_x, push_y = (room - gap) / weight, away_x, away_y
        if told:
            break
    return most * push_x, most * push_y, lacks


@jit
def _touches(x, y, path, least, frame, place, choice, option, bound, limit):
    """Return whether a walk comes nearer to a wall than ``least``."""
    for n in range(1, 9):
        off_x, off_y, _ = _place(path, n, 0.25, 1.0)
        _, _, index = quarter(x + off_x, y + off_y, frame, place)
        if bound[index] < least:
            gap, _, _ = wall_gap(x + off_x, y + off_y, frame, place, choice, option, limit)
            if gap < least:
                return True
    return False


@jit
def _yield(away, apart, room, firm, mine, theirs, blends, first, beyond, rounding):
    """Return whether two come too near, and the change of their relative step that prevents it."""
    lack, weight, at_x, at_y, gap = _closest(
        away[0], away[1], mine, theirs, room, firm, blends, first, beyond
    )
    if lack <= rounding:
        return False, 0.0, 0.0
    line_x, line_y = away[0] / apart, away[1] / apart
    full = line_x * (mine[4] - theirs[4]) + line_y * (mine[5] - theirs[5])
    back = room - apart - full
    if blends:
        along = line_x * (mine[0] - theirs[0]) + line_y * (mine[1] - theirs[1])
        back = max(back, (firm - apart - along) / first, (firm - apart) / beyond - full)
    back = max(back, 0.0)
    aside = lack / max(weight, 1e-3) if gap > 1e-3 else np.inf
    if aside < back:
        share = min(aside, 1e3) / gap
        return True, share * at_x, share * at_y
    return True, back * line_x, back * line_y


@compiled(
    "void(f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:], b1[:,:], b1[:,:], b1[:,:], f4[:,:], b1[:,:], b1,"
    " i8, f8, f8, f8, f8, f8, f8, f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:], f8, f4[:,:,:])"
)
def keep_clear(
    position, asked, velocity, longest, present, moved, waits, radius, robot, blends,
    rounds, margin, shoulders, narrow_gap, first, beyond, rounding, frames, places,
    choice, option, bound, limit, out,
):  # fmt: skip
    """Write steps (B, A, 2), metres, without contacts: see `pedzoo.models.safety.kept_clear`.

    Args are those of `Steps`, with velocities as metres in a quarter of a step; whether velocities blend; and
    constants. Then walls as scenes see them, frames (B, 7) and places (B, 3), no rows without walls, and
    their tables.
    """
    scenes, agents = moved.shape
    step, change = np.zeros((agents, 2)), np.zeros((agents, 2))
    path, levels, still = np.zeros((agents, 6)), np.zeros((3, agents, 6)), np.zeros(6)
    room, asking, level = np.zeros(agents), np.zeros(agents), np.zeros(agents, np.int64)
    narrow, near, stops = np.zeros((3, agents), np.bool_)
    who, away = np.zeros((agents * agents, 2), np.int64), np.zeros((agents * agents, 2))
    # of pairs: how far apart, rooms that are wanted, firm and not to be touched, shares of both
    apart, wanted, firm, touch, mine, theirs = np.zeros((6, agents * agents))
    frame, place = np.zeros(7), np.zeros(3, np.int64)
    for b in range(scenes):
        has_walls = frames.shape[0] > 0
        if has_walls:
            frame[:], place[:] = frames[b], places[b]
        for a in range(agents):
            near[a], narrow[a] = False, False
            step[a, 0], step[a, 1] = asked[b, a, 0], asked[b, a, 1]
            if not present[b, a]:
                continue
            x, y = position[b, a, 0], position[b, a, 1]
            if has_walls:
                reach = max(beyond * longest[b, a] + radius[b, a] + margin, narrow_gap)
                _, _, index = quarter(x, y, frame, place)
                if bound[index] < reach:
                    gap, _, _ = wall_gap(x, y, frame, place, choice, option, limit)
                    near[a] = moved[b, a] and gap < reach
                    narrow[a] = gap < narrow_gap
                    room[a] = min(gap, radius[b, a] + margin)
                x, y = x + step[a, 0], y + step[a, 1]
                _, _, index = quarter(x, y, frame, place)
                if not narrow[a] and bound[index] < narrow_gap:
                    gap, _, _ = wall_gap(x, y, frame, place, choice, option, limit)
                    narrow[a] = gap < narrow_gap
            if moved[b, a]:
                step[a, 0], step[a, 1] = _limited(step[a, 0], step[a, 1], longest[b, a])
            _walk(
                step[a, 0], step[a, 1], velocity[b, a, 0], velocity[b, a, 1], longest[b, a],
                blends and moved[b, a], path[a],
            )  # fmt: skip
        pairs = 0
        for a in range(agents):
            for o in range(a):
                if not (present[b, a] and present[b, o] and (moved[b, a] or moved[b, o])):
                    continue
                x, y = position[b, a, 0] - position[b, o, 0], position[b, a, 1] - position[b, o, 1]
                distance, bodies = _length(x, y), radius[b, a] + radius[b, o]
                most = bodies + margin
                if (narrow[a] or narrow[o]) and not (waits[b, a] and waits[b, o]):
                    most = max(most, shoulders)
                reach = longest[b, a] if moved[b, a] else _length(step[a, 0], step[a, 1])
                reach += longest[b, o] if moved[b, o] else _length(step[o, 0], step[o, 1])
                if distance > most + beyond * reach + margin:
                    continue
                yields, other = moved[b, a] and not robot[b, a], moved[b, o] and not robot[b, o]
                gives, other_gives = (
                    yields or (moved[b, a] and not other),
                    other or (moved[b, o] and not yields),
                )
                share = 0.5 if gives and other_gives else 1.0
                who[pairs, 0], who[pairs, 1] = a, o
                away[pairs, 0], away[pairs, 1], apart[pairs] = x, y, distance
                wanted[pairs], firm[pairs] = min(distance, most), min(distance, bodies + margin)
                touch[pairs] = min(distance, bodies + 0.001) - 1e-4
                mine[pairs], theirs[pairs] = share * gives, share * other_gives
                pairs += 1
        settled, safe = False, False
        for _ in range(rounds):
            settled, safe = True, True
            change[:], asking[:] = 0.0, 0.0
            for k in range(pairs):
                a, o = who[k]
                lacks, x, y = _yield(
                    away[k], apart[k], wanted[k], firm[k], path[a], path[o], blends, first, beyond, rounding
                )
                if lacks:
                    settled = False
                    asking[a] += 1
                    asking[o] += 1
                    change[a, 0] += mine[k] * x
                    change[a, 1] += mine[k] * y
                    change[o, 0] -= theirs[k] * x
                    change[o, 1] -= theirs[k] * y
            for a in range(agents):
                if not (present[b, a] and moved[b, a]):
                    continue
                changed = asking[a] > 0
                before = velocity[b, a]
                if changed:
                    step[a] += change[a] / math.sqrt(asking[a])
                    _walk(step[a, 0], step[a, 1], before[0], before[1], longest[b, a], blends, path[a])
                if near[a]:
                    x, y, lacks = _push(
                        position[b, a, 0], position[b, a, 1], path[a], room[a], first, beyond,
                        frame, place, choice, option, bound, limit,
                    )  # fmt: skip
                    safe = safe and not lacks
                    if x != 0 or y != 0:
                        settled, changed = False, True
                        step[a, 0], step[a, 1] = step[a, 0] + x, step[a, 1] + y
                if changed:
                    step[a, 0], step[a, 1] = _limited(step[a, 0], step[a, 1], longest[b, a])
                    _walk(step[a, 0], step[a, 1], before[0], before[1], longest[b, a], blends, path[a])
            if settled:
                break
        level[:] = 0
        if not (settled and safe):
            for a in range(agents):
                for part in range(3):
                    share = 1 - 0.5 * part
                    _walk(
                        share * step[a, 0], share * step[a, 1], velocity[b, a, 0], velocity[b, a, 1],
                        longest[b, a], blends and moved[b, a], levels[part, a],
                    )  # fmt: skip
            for turn in range(agents + 2):
                stops[:] = False
                for k in range(pairs):
                    a, o = who[k]
                    x, y, least = away[k, 0], away[k, 1], touch[k]
                    my_path, their_path = levels[level[a], a], levels[level[o], o]
                    if _closest(x, y, my_path, their_path, least, least, blends, first, 1.0)[0] > 0:
                        alone = _closest(x, y, my_path, still, least, least, blends, first, 1.0)[0] > 0
                        other = _closest(x, y, still, their_path, least, least, blends, first, 1.0)[0] > 0
                        stops[a] = stops[a] or (mine[k] > 0 and (alone or not other))
                        stops[o] = stops[o] or (theirs[k] > 0 and (other or not alone))
                ended = True
                for a in range(agents):
                    if near[a] and not stops[a]:
                        stops[a] = _touches(
                            position[b, a, 0], position[b, a, 1], levels[level[a], a],
                            min(room[a], radius[b, a] + margin / 2) - 1e-4,
                            frame, place, choice, option, bound, limit,
                        )  # fmt: skip
                    if stops[a]:
                        ended = False
                        level[a] = 2 if turn else 1
                if ended:
                    break
        for a in range(agents):
            share = 1 - 0.5 * level[a]
            out[b, a, 0], out[b, a, 1] = share * step[a, 0], share * step[a, 1]
