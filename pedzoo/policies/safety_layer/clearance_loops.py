"""The safety layer in loops that numba compiles: as `clearance` says, scene by scene.

A scene is left as soon as nothing in it is to be corrected. `clearance_slopes` goes back over what is
recorded here, for gradients.
"""

import math

import numpy as np

from pedzoo.core.compiled import compiled
from pedzoo.maps.walls.compiled import quarter, wall_gap
from pedzoo.policies.safety_layer.clearance_parts import (
    closest,
    correction,
    limited,
    meetings,
    push,
    touches_wall,
    walk,
)


@compiled(
    "void(f4[:,:,:], f4[:,:,:], f4[:,:,:], f4[:,:], b1[:,:], b1[:,:], b1[:,:], f4[:,:], b1[:,:], f4[:,:], b1,"
    " UniTuple(f8, 6), UniTuple(f8, 4), i8, f8, f8, f8, f8, f8, f8, f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:],"
    " f8, f4[:,:,:], b1[:,:], f4[:,:,:], f4[:,:], i8[:], f8[:,:,:,:], b1[:,:])"
)
def keep_clear(
    position, asked, velocity, longest, present, moved, waits, radius, robot, rank, blends,
    order, parts, rounds, margin, shoulders, narrow_gap, first, beyond, rounding, frames, places,
    choice, option, bound, limit, out, narrow, slope, shares, used, record, stands,
):  # fmt: skip
    """Write steps (B, A, 2), metres, without contacts: see `pedzoo.policies.safety_layer.layer.kept_clear`.

    Args are those of `ProposedSteps`, with velocities in metres per quarter of a step; whether velocities
    blend; and constants, those of precedence in a tuple, and the parts of
    a step that are tried. Then the walls: frames (B, 7) and places (B, 3), no
    rows without walls, and their tables. Then the results:

    * the steps;
    * which agents are in a narrow place (B, A);
    * how the room to walls grows with their place (B, A, 2), not 0 only for agents that lack room;
    * share of their steps that they walk (B, A);
    * how many rounds had corrections (B,);
    * of each round (B, R, A, 7): size, 0 for none; steps at its begin, after others and after walls; the
      place on the way that a wall corrects, 0 for none;
    * which agents stand to make way (B, A).
    """
    scenes, agents = moved.shape
    step, change = np.zeros((agents, 2)), np.zeros((agents, 2))
    path, levels, still = np.zeros((agents, 6)), np.zeros((len(parts), agents, 6)), np.zeros(6)
    room, asking, level = np.zeros(agents), np.zeros(agents), np.zeros(agents, np.int64)
    near, stops = np.zeros((2, agents), np.bool_)
    members, number = np.zeros((agents * agents, 2), np.int64), np.zeros((9, agents * agents))
    from_x, from_y, apart, wanted, firm, touch, mine, theirs, rest = number
    frame, place = np.zeros(7), np.zeros(3, np.int64)
    for b in range(scenes):
        has_walls = frames.shape[0] > 0
        if has_walls:
            frame[:], place[:] = frames[b], places[b]
        for a in range(agents):
            near[a], narrow[b, a] = False, False
            slope[b, a, 0], slope[b, a, 1] = 0.0, 0.0
            step[a, 0], step[a, 1] = asked[b, a, 0], asked[b, a, 1]
            if not present[b, a]:
                continue
            x, y = position[b, a, 0], position[b, a, 1]
            if has_walls:
                reach = max(beyond * longest[b, a] + radius[b, a] + margin, narrow_gap)
                _, _, index = quarter(x, y, frame, place)
                if bound[index] < reach:
                    gap, away_x, away_y = wall_gap(x, y, frame, place, choice, option, limit)
                    near[a] = moved[b, a] and gap < reach
                    narrow[b, a] = gap < narrow_gap
                    room[a] = radius[b, a] + margin
                    if gap < room[a]:
                        room[a], slope[b, a, 0], slope[b, a, 1] = gap, away_x, away_y
                x, y = x + step[a, 0], y + step[a, 1]
                _, _, index = quarter(x, y, frame, place)
                if not narrow[b, a] and bound[index] < narrow_gap:
                    gap, _, _ = wall_gap(x, y, frame, place, choice, option, limit)
                    narrow[b, a] = gap < narrow_gap
            if moved[b, a]:
                step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], longest[b, a])
            walk(
                step[a, 0], step[a, 1], velocity[b, a, 0], velocity[b, a, 1], longest[b, a],
                blends and moved[b, a], path[a],
            )  # fmt: skip
        pairs = meetings(
            position[b], step, velocity[b], longest[b], present[b], moved[b], waits[b], radius[b], robot[b],
            rank[b], narrow[b], margin, shoulders, order, beyond, members, number, stands[b],
        )  # fmt: skip
        for a in range(agents):
            if stands[b, a]:
                step[a] = 0.0
                before = velocity[b, a]
                walk(0.0, 0.0, before[0], before[1], longest[b, a], blends, path[a])
        settled, safe = False, False
        used[b] = 0
        for r in range(rounds):
            settled, safe = True, True
            change[:], asking[:] = 0.0, 0.0
            for k in range(pairs):
                a, o = members[k]
                lacks, x, y = correction(
                    from_x[k], from_y[k], apart[k], wanted[k], firm[k], rest[k], path[a], path[o],
                    blends, first, beyond, rounding,
                )  # fmt: skip
                if lacks:
                    settled = False
                    asking[a] += 1
                    asking[o] += 1
                    change[a, 0] += mine[k] * x
                    change[a, 1] += mine[k] * y
                    change[o, 0] -= theirs[k] * x
                    change[o, 1] -= theirs[k] * y
            for a in range(agents):
                if record.size > 0:
                    record[b, r, a, 0:2], record[b, r, a, 6] = step[a], 0.0
                if not (present[b, a] and moved[b, a]):
                    continue
                changed = asking[a] > 0
                before = velocity[b, a]
                if changed:
                    step[a] += change[a] / math.sqrt(asking[a])
                    walk(step[a, 0], step[a, 1], before[0], before[1], longest[b, a], blends, path[a])
                if record.size > 0:
                    record[b, r, a, 2:4] = step[a]
                if near[a]:
                    x, y, lacks, worst = push(
                        position[b, a, 0], position[b, a, 1], path[a], room[a], first, beyond,
                        frame, place, choice, option, bound, limit,
                    )  # fmt: skip
                    safe = safe and not lacks
                    if x != 0 or y != 0:
                        settled, changed = False, True
                        step[a, 0], step[a, 1] = step[a, 0] + x, step[a, 1] + y
                        if record.size > 0:
                            record[b, r, a, 6] = worst
                if record.size > 0:
                    record[b, r, a, 4:6] = step[a]
                if changed:
                    step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], longest[b, a])
                    walk(step[a, 0], step[a, 1], before[0], before[1], longest[b, a], blends, path[a])
            if settled:
                break
            used[b] = r + 1
        level[:] = 0
        if not (settled and safe):
            for a in range(agents):
                for part in range(len(parts)):
                    share = parts[part]
                    walk(
                        share * step[a, 0], share * step[a, 1], velocity[b, a, 0], velocity[b, a, 1],
                        longest[b, a], blends and moved[b, a], levels[part, a],
                    )  # fmt: skip
            for turn in range(agents + len(parts) - 1):
                stops[:] = False
                for k in range(pairs):
                    a, o = members[k]
                    x, y, least = from_x[k], from_y[k], touch[k]
                    my_path, their_path = levels[level[a], a], levels[level[o], o]
                    if closest(x, y, my_path, their_path, least, least, least, blends, first, 1.0)[0] > 0:
                        alone = closest(x, y, my_path, still, least, least, least, blends, first, 1.0)[0] > 0
                        other = (
                            closest(x, y, still, their_path, least, least, least, blends, first, 1.0)[0] > 0
                        )
                        # where both have to walk for a touch, who goes first need not stop
                        stops[a] = stops[a] or (mine[k] > 0 and (alone or (not other and mine[k] >= 0.5)))
                        stops[o] = stops[o] or (theirs[k] > 0 and (other or (not alone and theirs[k] >= 0.5)))
                ended = True
                for a in range(agents):
                    if near[a] and not stops[a]:
                        stops[a] = touches_wall(
                            position[b, a, 0], position[b, a, 1], levels[level[a], a],
                            min(room[a], radius[b, a] + margin / 2) - 1e-4,
                            frame, place, choice, option, bound, limit,
                        )  # fmt: skip
                    if stops[a]:
                        ended = False
                        level[a] = min(turn + 1, len(parts) - 1)
                if ended:
                    break
        for a in range(agents):
            shares[b, a] = parts[level[a]]
            out[b, a, 0], out[b, a, 1] = shares[b, a] * step[a, 0], shares[b, a] * step[a, 1]
