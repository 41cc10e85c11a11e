"""The safety layer in loops that numba compiles, scene by scene: what `clearance` says in torch.

A scene is left as soon as nothing in it is to be corrected. `pedzoo.policies.safety_layer.slopes` goes back
over what is recorded here, for gradients.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.walls_numba import quarter, wall_gap
from pedzoo.policies.safety_layer.clearance import (
    AHEAD,
    BEYOND,
    FIRST,
    LEAD_SECONDS,
    LEAST_ASKED,
    LEAST_SHARE,
    MARGIN,
    NARROW,
    ROUNDING,
    ROUNDS,
    SHARES,
    SPREAD,
    TIE,
)

_SHIFT = 0.5 - LEAST_SHARE
_LEAD = LEAD_SECONDS / TRACE_SECONDS
PAIR = np.dtype(
    [("a", "i8"), ("o", "i8")]
    + [(name, "f8") for name in ("x", "y", "apart", "room", "firm", "rest", "touch", "mine", "theirs")]
)
"""Two agents who may come too near: their numbers, and from the second to the first the place and distance.

``room`` is wanted on the way to the end of the step, ``firm`` on the parts before, ``rest`` beyond it; nearer
than ``touch`` they run into each other. ``mine`` and ``theirs`` are their shares of a correction.
"""


class People(NamedTuple):
    """The arrays (B, A, ...) of `ProposedSteps`, with velocities in metres per quarter of a step."""

    position: Any
    asked: Any
    velocity: Any
    longest: Any
    present: Any
    moved: Any
    waits: Any
    radius: Any
    robot: Any
    rank: Any


class WallArrays(NamedTuple):
    """Frames and places of scenes, no rows where there are no walls, and the tables behind them."""

    frames: Any
    places: Any
    choice: Any
    option: Any
    bound: Any
    limit: Any


class Ground(NamedTuple):
    """The walls of one scene: its frame (7,) and place (3,), and the tables."""

    frame: Any
    place: Any
    choice: Any
    option: Any
    bound: Any
    limit: Any


class Trace(NamedTuple):
    """What the way back needs.

    Attributes:
        narrow: Which agents are in a narrow place (B, A).
        slope: How the room to walls grows with an agent's place (B, A, 2), not 0 only where room lacks.
        shares: Share of their steps that they walk (B, A).
        used: How many rounds had corrections (B,).
        record: Of each round (B, R, A, 7), or nothing: steps at its begin, after others and after walls, and
            the place on the way that a wall corrects, 0 for none.
        stands: Which agents stand to make way (B, A).
    """

    narrow: Any
    slope: Any
    shares: Any
    used: Any
    record: Any
    stands: Any


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
def walk(x, y, before, longest, blends, path):
    """Write where a step is after its first, third and last quarter, path (6,): `ProposedSteps.integrate`."""
    if not blends:
        path[0], path[1], path[2], path[3], path[4], path[5] = 0.25 * x, 0.25 * y, 0.75 * x, 0.75 * y, x, y
        return
    command_x, command_y = 0.25 * x, 0.25 * y
    half_x, half_y = 0.5 * (before[0] - command_x), 0.5 * (before[1] - command_y)
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
def closest(x, y, mine, theirs, room, firm, rest, blends, on):
    """Return how much room two lack where they lack most, and where that is.

    That is one of four straight parts, how much of it is walked, the relative place (x, y) and the distance.
    The last part, ``on`` after the step, counts if it is asked for.
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
    if on:
        near_x, near_y = x + BEYOND * (mine[4] - theirs[4]), y + BEYOND * (mine[5] - theirs[5])
        near = length(near_x, near_y)
        if rest - near > lack:
            lack, part, along, at_x, at_y, gap = rest - near, 3, 1.0, near_x, near_y, near
    if gap < 1e-3:  # exactly head-on: both keep to the right
        apart = length(x, y)
        lack, at_x, at_y, gap = lack + gap - 1e-3, -1e-3 * y / apart, 1e-3 * x / apart, 1e-3
    return lack, part, along, at_x, at_y, gap


@jit
def weight_of(part, along):
    """Return how much the place on a straight part moves with the step, at least a little."""
    if part == 0:
        return max(along, 1e-3)
    if part == 1:
        return max(along * FIRST, 1e-3)
    if part == 2:
        return max(FIRST + along * (0.75 - FIRST), 1e-3)
    return BEYOND


@jit
def way_back(pair, mine, theirs, blends):
    """Return by how much a step lacks room along the line between two, and which demand is the greatest."""
    line_x, line_y = pair["x"] / pair["apart"], pair["y"] / pair["apart"]
    full = line_x * (mine[4] - theirs[4]) + line_y * (mine[5] - theirs[5])
    back, demand = pair["room"] - pair["apart"] - full, 0
    if blends:
        along = line_x * (mine[0] - theirs[0]) + line_y * (mine[1] - theirs[1])
        if (pair["firm"] - pair["apart"] - along) / FIRST > back:
            back, demand = (pair["firm"] - pair["apart"] - along) / FIRST, 1
        if (pair["rest"] - pair["apart"]) / BEYOND - full > back:
            back, demand = (pair["rest"] - pair["apart"]) / BEYOND - full, 2
    return max(back, 0.0), demand


@jit
def correction(pair, mine, theirs, blends):
    """Return whether two come too near, and the change of their relative step that prevents it."""
    lack, part, along, at_x, at_y, gap = closest(
        pair["x"], pair["y"], mine, theirs, pair["room"], pair["firm"], pair["rest"], blends, blends
    )
    if lack <= ROUNDING:
        return False, 0.0, 0.0
    back, _ = way_back(pair, mine, theirs, blends)
    aside = lack / weight_of(part, along)
    if aside < back:
        share = min(aside, 1e3) / gap
        return True, share * at_x, share * at_y
    return True, back * (pair["x"] / pair["apart"]), back * (pair["y"] / pair["apart"])


@jit
def touches(pair, mine, theirs, blends):
    """Return whether two who walk so run into each other."""
    least = pair["touch"]
    return closest(pair["x"], pair["y"], mine, theirs, least, least, least, blends, False)[0] > 0


@jit
def place_on(path, n, first):
    """Return the place after ``n`` eighths of a walk, the ninth being beyond its end, and its weight."""
    if n == 9:
        return BEYOND * path[4], BEYOND * path[5], BEYOND
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
def least_gap(x, y, ground):
    """Return a lower bound of the distance from a wall, metres."""
    _, _, index = quarter(x, y, ground.frame, ground.place)
    return ground.bound[index]


@jit
def gap_at(x, y, ground):
    """Return the distance to the nearest wall and the direction in which it grows (gap, x, y)."""
    return wall_gap(x, y, ground.frame, ground.place, ground.choice, ground.option, ground.limit)


@jit
def push(position, path, room, blends, ground):
    """Return the change of a step that its worst place asks for (x, y).

    Also return whether any place is too near, and which is the worst, 0 for none.
    """
    most, push_x, push_y, worst, outside, lacks = 0.0, 0.0, 0.0, 0, False, False
    for everywhere in range(2):
        for n in range(1, 10 if blends else 9):
            off_x, off_y, weight = place_on(path, n, FIRST if blends else 0.25)
            x, y = position[0] + off_x, position[1] + off_y
            if least_gap(x, y, ground) > max(room, 0.0):
                outside = True
                continue
            gap, away_x, away_y = gap_at(x, y, ground)
            outside, lacks = outside or gap > 0, lacks or gap < room
            if (gap > 0 or everywhere) and (room - gap) / weight > most:
                most, push_x, push_y, worst = (room - gap) / weight, away_x, away_y, n
        # in the midst of a wall the way out may be the far side: places before it know better
        if outside:
            break
    return most * push_x, most * push_y, lacks, worst


@jit
def touches_wall(position, path, least, ground):
    """Return whether a walk comes nearer to a wall than ``least``."""
    for n in range(1, 9):
        off_x, off_y, _ = place_on(path, n, 0.25)
        x, y = position[0] + off_x, position[1] + off_y
        if least_gap(x, y, ground) < least and gap_at(x, y, ground)[0] < least:
            return True
    return False


@jit
def precedence(people, b, a, o, x, y, step, blends, wait):
    """Return how clearly agent ``a`` goes before ``o``, (x, y) from it: see `clearance.precedence`."""
    mine, theirs, lead_seconds = step[a], step[o], _LEAD if blends else 0.0
    size = max(math.sqrt(mine[0] * mine[0] + mine[1] * mine[1]), LEAST_ASKED)
    other = max(math.sqrt(theirs[0] * theirs[0] + theirs[1] * theirs[1]), LEAST_ASKED)
    lead = 0.5 * (x * (mine[0] / size + theirs[0] / other) + y * (mine[1] / size + theirs[1] / other))
    velocity, their_velocity = people.velocity[b, a], people.velocity[b, o]
    lead += lead_seconds * (mine[0] * velocity[0] + mine[1] * velocity[1]) / size
    lead -= lead_seconds * (theirs[0] * their_velocity[0] + theirs[1] * their_velocity[1]) / other
    rank = people.rank[b, a] - people.rank[b, o]
    lead = (lead + TIE * np.sign(rank)) / TIE if wait else lead / AHEAD
    return min(max(lead, -1.0), 1.0)


@jit
def meetings(people, b, step, blends, shoulders, narrow, pairs, stands):
    """Write the pairs of a scene that may come too near, and return their number.

    Args:
        people: All scenes.
        b: The scene.
        step: The steps of its agents (A, 2).
        blends: Whether velocities blend.
        shoulders: Room in narrow places, metres.
        narrow: Who is in one (A,).
        pairs: Is written, of the type `PAIR`.
        stands: Is written: which agents stand to make way (A,).
    """
    count = 0
    stands[:] = False
    for a in range(people.moved.shape[1]):
        for o in range(a):
            moved, other_moved = people.moved[b, a], people.moved[b, o]
            if not (people.present[b, a] and people.present[b, o] and (moved or other_moved)):
                continue
            x = people.position[b, a, 0] - people.position[b, o, 0]
            y = people.position[b, a, 1] - people.position[b, o, 1]
            distance, bodies = length(x, y), people.radius[b, a] + people.radius[b, o]
            most, wait = bodies + MARGIN, people.waits[b, a] and people.waits[b, o]
            broad = (narrow[a] or narrow[o]) and not wait
            reach = people.longest[b, a] if moved else length(step[a, 0], step[a, 1])
            reach += people.longest[b, o] if other_moved else length(step[o, 0], step[o, 1])
            beyond = BEYOND if blends else 1.0
            if distance > (max(most, shoulders) if broad else most) + beyond * reach + MARGIN:
                continue
            yields, other = moved and not people.robot[b, a], other_moved and not people.robot[b, o]
            gives, other_gives = yields or (moved and not other), other or (other_moved and not yields)
            share = 0.5 if gives and other_gives else 1.0
            share, other_share, room = share * gives, share * other_gives, shoulders
            rest = min(distance, bodies + MARGIN) if distance >= bodies else bodies + MARGIN
            if yields and other:
                first = precedence(people, b, a, o, x, y, step, blends, wait)
                share, other_share = share - _SHIFT * first, share + _SHIFT * first
                if wait and first != 0 and blends:
                    rest = bodies + MARGIN + SPREAD
                if (broad or wait) and first != 0:
                    mine = nearest(x, y, step[a, 0], step[a, 1])
                    theirs = nearest(-x, -y, step[o, 0], step[o, 1])
                    past, press = (mine, theirs) if first > 0 else (theirs, mine)
                    if abs(first) > 0.5 and past[0] > 0:
                        room = min(room, past[3])
                    near = bodies + MARGIN
                    holds_up = past[0] > 0 and past[3] < near
                    if wait and (holds_up or (press[0] > 0 and press[3] < near and distance < near + SPREAD)):
                        stands[o if first > 0 else a] = True
            if broad:
                most = max(most, room)
            pair = pairs[count]
            pair["a"], pair["o"], pair["x"], pair["y"], pair["apart"], pair["rest"] = (
                a,
                o,
                x,
                y,
                distance,
                rest,
            )
            pair["room"], pair["firm"] = min(distance, most), min(distance, bodies + MARGIN)
            pair["touch"] = min(distance, bodies + 0.004) - 1e-4
            pair["mine"], pair["theirs"] = share, other_share
            count += 1
    return count


@jit
def begins(people, b, a, step, walls, ground, trace):
    """Note whether an agent is in a narrow place; return whether walls are near, and its room to them.

    ``walls`` is how much of the longest step counts, 0 where there are none.
    """
    trace.narrow[b, a] = False
    trace.slope[b, a, 0], trace.slope[b, a, 1] = 0.0, 0.0
    near, room = False, people.radius[b, a] + MARGIN
    if walls == 0.0:
        return near, room
    x, y = people.position[b, a, 0], people.position[b, a, 1]
    reach = max(walls * people.longest[b, a] + people.radius[b, a] + MARGIN, NARROW)
    if least_gap(x, y, ground) < reach:
        gap, away_x, away_y = gap_at(x, y, ground)
        near = people.moved[b, a] and gap < reach
        trace.narrow[b, a] = gap < NARROW
        if gap < room:
            room, trace.slope[b, a, 0], trace.slope[b, a, 1] = gap, away_x, away_y
    x, y = x + step[0], y + step[1]
    if not trace.narrow[b, a] and least_gap(x, y, ground) < NARROW:
        trace.narrow[b, a] = gap_at(x, y, ground)[0] < NARROW
    return near, room


@jit
def shares_of(people, b, step, blends, pairs, count, near, room, ground, level):
    """Write which of `SHARES` of their steps agents walk, level (A,): less of it if they would touch."""
    agents, last = len(step), len(SHARES) - 1
    paths, still, stops = np.zeros((last + 1, agents, 6)), np.zeros(6), np.zeros(agents, np.bool_)
    for a in range(agents):
        for part in range(last + 1):
            share = SHARES[part]
            walk(
                share * step[a, 0], share * step[a, 1], people.velocity[b, a], people.longest[b, a],
                blends and people.moved[b, a], paths[part, a],
            )  # fmt: skip
    for turn in range(agents + last):
        stops[:] = False
        for k in range(count):
            pair = pairs[k]
            a, o = pair["a"], pair["o"]
            mine, theirs = paths[level[a], a], paths[level[o], o]
            if touches(pair, mine, theirs, blends):
                alone, other = touches(pair, mine, still, blends), touches(pair, still, theirs, blends)
                # where both have to walk for a touch, who goes first need not stop
                stops[a] = stops[a] or (pair["mine"] > 0 and (alone or (not other and pair["mine"] >= 0.5)))
                stops[o] = stops[o] or (
                    pair["theirs"] > 0 and (other or (not alone and pair["theirs"] >= 0.5))
                )
        ended = True
        for a in range(agents):
            if near[a] and not stops[a]:
                least = min(room[a], people.radius[b, a] + MARGIN / 2) - 1e-4
                stops[a] = touches_wall(people.position[b, a], paths[level[a], a], least, ground)
            if stops[a]:
                ended = False
                level[a] = min(turn + 1, last)
        if ended:
            return


@compiled()
def keep_clear(people, walls, blends, shoulders, out, trace):
    """Write steps (B, A, 2), metres, without contacts: see `pedzoo.policies.safety_layer.layer.kept_clear`.

    Args:
        people: As they want to walk.
        walls: Those of each scene.
        blends: Whether velocities blend.
        shoulders: Room in narrow places, metres.
        out: The steps, which are written.
        trace: Is written.
    """
    scenes, agents = people.moved.shape
    step, change, path = np.zeros((agents, 2)), np.zeros((agents, 2)), np.zeros((agents, 6))
    room, asking, level = np.zeros(agents), np.zeros(agents), np.zeros(agents, np.int64)
    near, pairs = np.zeros(agents, np.bool_), np.zeros(agents * agents, PAIR)
    frame, place = np.zeros(7), np.zeros(3, np.int64)
    beyond, stores = 0.0, trace.record.size > 0
    for b in range(scenes):
        if walls.frames.shape[0] > 0:
            frame[:], place[:] = walls.frames[b], walls.places[b]
            beyond = BEYOND if blends else 1.0
        ground = Ground(frame, place, walls.choice, walls.option, walls.bound, walls.limit)
        for a in range(agents):
            step[a, 0], step[a, 1] = people.asked[b, a, 0], people.asked[b, a, 1]
            near[a], room[a] = begins(
                people, b, a, step[a], beyond if people.present[b, a] else 0.0, ground, trace
            )
            if not people.present[b, a]:
                continue
            longest, moved = people.longest[b, a], people.moved[b, a]
            if moved:
                step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], longest)
            walk(step[a, 0], step[a, 1], people.velocity[b, a], longest, blends and moved, path[a])
        stands = trace.stands[b]
        count = meetings(people, b, step, blends, shoulders, trace.narrow[b], pairs, stands)
        for a in range(agents):
            if stands[a]:
                step[a] = 0.0
                walk(0.0, 0.0, people.velocity[b, a], people.longest[b, a], blends, path[a])
        settled, safe = False, False
        trace.used[b] = 0
        for r in range(ROUNDS):
            settled, safe = True, True
            change[:], asking[:] = 0.0, 0.0
            for k in range(count):
                pair = pairs[k]
                a, o = pair["a"], pair["o"]
                lacks, x, y = correction(pair, path[a], path[o], blends)
                if lacks:
                    settled = False
                    asking[a] += 1
                    asking[o] += 1
                    change[a, 0] += pair["mine"] * x
                    change[a, 1] += pair["mine"] * y
                    change[o, 0] -= pair["theirs"] * x
                    change[o, 1] -= pair["theirs"] * y
            for a in range(agents):
                if stores:
                    trace.record[b, r, a, 0:2], trace.record[b, r, a, 6] = step[a], 0.0
                if not (people.present[b, a] and people.moved[b, a]):
                    continue
                changed = asking[a] > 0
                before, longest = people.velocity[b, a], people.longest[b, a]
                if changed:
                    step[a] += change[a] / math.sqrt(asking[a])
                    walk(step[a, 0], step[a, 1], before, longest, blends, path[a])
                if stores:
                    trace.record[b, r, a, 2:4] = step[a]
                if near[a]:
                    x, y, lacks, worst = push(people.position[b, a], path[a], room[a], blends, ground)
                    safe = safe and not lacks
                    if x != 0 or y != 0:
                        settled, changed = False, True
                        step[a, 0], step[a, 1] = step[a, 0] + x, step[a, 1] + y
                        if stores:
                            trace.record[b, r, a, 6] = worst
                if stores:
                    trace.record[b, r, a, 4:6] = step[a]
                if changed:
                    step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], longest)
                    walk(step[a, 0], step[a, 1], before, longest, blends, path[a])
            if settled:
                break
            trace.used[b] = r + 1
        level[:] = 0
        if not (settled and safe):
            shares_of(people, b, step, blends, pairs, count, near, room, ground, level)
        for a in range(agents):
            share = SHARES[level[a]]
            trace.shares[b, a] = share
            out[b, a, 0], out[b, a, 1] = share * step[a, 0], share * step[a, 1]
