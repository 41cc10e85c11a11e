"""The safety layer in loops that numba compiles, scene by scene: what `clearance` says in torch.

Vectors are complex numbers, x + iy. A scene is left as soon as nothing in it is to be corrected. ``people``
are `ProposedSteps` of arrays (B, A), with velocities in metres per quarter of a step.

The functions behind `kept` go back over what it records, for gradients, which are those of the torch path.
Parts of a way, shares of steps and directions of walls count as constants. Gradients are complex, too.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.compiled import compiled, jit
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.walls import LocalWalls, Walls
from pedzoo.maps.walls_numba import WallArrays, quarter, wall_gap
from pedzoo.policies.clearance import (
    AHEAD,
    BARELY,
    BEYOND,
    EVEN,
    FIRST,
    HEAD_ON,
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
    ProposedSteps,
    places,
)

_LEAD = LEAD_SECONDS / TRACE_SECONDS
PARTS, SHIFT = (part.numpy() for part in places(torch.zeros(0, dtype=torch.float64)))
PAIR = np.dtype(
    [("a", "i8"), ("o", "i8"), ("away", "c16")]
    + [(name, "f8") for name in ("apart", "room", "firm", "rest", "touch", "mine", "theirs")]
)
"""Two agents who may come too near: their numbers, and from the second to the first the place and distance.

``room`` is wanted on the way to the end of the step, ``firm`` on the parts before, ``rest`` beyond it; nearer
than ``touch`` they run into each other. ``mine`` and ``theirs`` are their shares of a correction.
"""


class Trace(NamedTuple):
    """What the way back needs, of agents (B, A)."""

    narrow: Any  # which are in a narrow place
    slope: Any  # how the room to walls grows with an agent's place, not 0 only where room lacks
    shares: Any  # of their steps that they walk
    used: Any  # how many rounds had corrections (B,)
    record: Any  # (B, R, A, 4) or nothing: steps at a round's begin, after others and after walls; then the
    # place on the way that a wall corrects, -1 for none
    stands: Any  # which stand to make way


@jit
def dot(one, other):
    """Return the scalar product."""
    return one.real * other.real + one.imag * other.imag


@jit
def length(vector):
    """Return the length of a vector, with a slope at zero."""
    return math.sqrt(dot(vector, vector) + 1e-9)


@jit
def limited(vector, longest):
    """Return a vector shortened to at most ``longest``."""
    return vector * min(longest / math.sqrt(max(dot(vector, vector), 1e-12)), 1.0)


@jit
def walk(people, b, a, step, path):
    """Write where a step is after its first, third and last quarter, path (3,): `ProposedSteps.integrate`."""
    command = 0.25 * step
    path[0], path[1], path[2] = command, 0.75 * step, step
    if people.moved[b, a]:
        half, most = 0.5 * (people.velocity[b, a] - command), 0.25 * people.longest[b, a]
        size = math.sqrt(dot(half, half) + 1e-12)
        half *= min(math.sqrt(dot(command, command) + 1e-12) / size, 1.0)
        path[0] = limited(command + half, most)
        path[1] = path[0] + 2 * limited(command - 0.5 * half, most)
        path[2] = path[1] + command


@jit
def nearest(at, move):
    """Return at which part of a move from a place zero is nearest, that place and its distance."""
    part = min(max(-dot(at, move) / max(dot(move, move), 1e-9), 0.0), 1.0)
    at = at + part * move
    return part, at, length(at)


@jit
def closest(away, mine, theirs, rooms, on):
    """Return how much room two lack where they lack most, and where that is.

    That is one of four straight parts, how much of it is walked, the relative place and the distance. The
    last part, ``on`` after the step, counts if it is asked for. ``rooms`` are those of `PAIR`.
    """
    move, part = mine[2] - theirs[2], 0
    along, at, gap = nearest(away, move)
    lack = rooms[0] - gap
    start, go = away, mine[0] - theirs[0]
    for n in range(1, 3):
        share, place, near = nearest(start, go)
        if rooms[1] - near > lack:
            lack, part, along, at, gap = rooms[1] - near, n, share, place, near
        start, go = start + go, mine[1] - theirs[1] - go
    if on:
        place = away + BEYOND * move
        near = length(place)
        if rooms[2] - near > lack:
            lack, part, along, at, gap = rooms[2] - near, 3, 1.0, place, near
    if gap < HEAD_ON:  # both keep to the right
        lack, at, gap = lack + gap - HEAD_ON, 1j * away * (HEAD_ON / length(away)), HEAD_ON
    return lack, part, along, at, gap


@jit
def weight_of(part, along):
    """Return how much the place on a straight part moves with the step, at least a little."""
    if part == 3:
        return BEYOND
    if part > 0:
        along = along * FIRST if part == 1 else FIRST + along * (0.75 - FIRST)
    return max(along, 1e-3)


@jit
def way_back(pair, mine, theirs):
    """Return by how much a step lacks room along the line between two, the greatest demand, and the line."""
    apart, line = pair["apart"], pair["away"] * (1 / pair["apart"])
    full = dot(line, mine[2] - theirs[2])
    back, demand = pair["room"] - apart - full, 0
    begin = (pair["firm"] - apart - dot(line, mine[0] - theirs[0])) / FIRST
    if begin > back:
        back, demand = begin, 1
    if (pair["rest"] - apart) / BEYOND - full > back:
        back, demand = (pair["rest"] - apart) / BEYOND - full, 2
    return max(back, 0.0), demand, line


@jit
def correction(pair, mine, theirs):
    """Return whether two come too near, and the change of their relative step that prevents it."""
    rooms = pair["room"], pair["firm"], pair["rest"]
    lack, part, along, at, gap = closest(pair["away"], mine, theirs, rooms, True)
    if lack <= ROUNDING:
        return False, 0j
    back, _, line = way_back(pair, mine, theirs)
    aside = lack / weight_of(part, along)
    return True, at * (min(aside, 1e3) / gap) if aside < back else back * line


@jit
def touches(pair, mine, theirs):
    """Return whether two who walk so run into each other."""
    least = pair["touch"]
    return closest(pair["away"], mine, theirs, (least, least, least), False)[0] > 0


@jit
def place_on(path, n):
    """Return the place ``n`` of `places` on a walk."""
    return PARTS[n, 0] * path[0] + PARTS[n, 1] * path[1] + PARTS[n, 2] * path[2]


@jit
def least_gap(at, walls, b):
    """Return a lower bound of the distance from a wall, metres."""
    return walls.least[quarter(at.real, at.imag, walls.frames[b], walls.places[b])[2]]


@jit
def gap_at(at, walls, b):
    """Return the distance to the nearest wall and the direction in which it grows."""
    gap, x, y = wall_gap(
        at.real, at.imag, walls.frames[b], walls.places[b], walls.choice, walls.option, walls.limit
    )
    return gap, complex(x, y)


@jit
def push(position, path, room, walls, b):
    """Return the change of a step for its worst place, whether any is too near, and that place, or -1."""
    most, way, worst, outside, lacks = 0.0, 0j, -1, False, False
    for everywhere in range(2):
        for n in range(len(PARTS)):
            at = position + place_on(path, n)
            if least_gap(at, walls, b) > max(room, 0.0):
                outside = True
                continue
            gap, away = gap_at(at, walls, b)
            outside, lacks = outside or gap > 0, lacks or gap < room
            if (gap > 0 or everywhere) and (room - gap) / SHIFT[n] > most:
                most, way, worst = (room - gap) / SHIFT[n], away, n
        # in the midst of a wall the way out may be the far side: places before it know better
        if outside:
            break
    return most * way, lacks, worst


@jit
def touches_wall(position, path, least, walls, b):
    """Return whether a walk comes nearer to a wall than ``least``."""
    for n in range(len(PARTS) - 1):
        at = position + place_on(path, n)
        if least_gap(at, walls, b) < least and gap_at(at, walls, b)[0] < least:
            return True
    return False


@jit
def precedence(people, b, a, o, away, step, wait):
    """Return how clearly agent ``a`` goes before ``o``, ``away`` from it: see `clearance.precedence`."""
    mine = step[a] * (1 / max(math.sqrt(dot(step[a], step[a])), LEAST_ASKED))
    theirs = step[o] * (1 / max(math.sqrt(dot(step[o], step[o])), LEAST_ASKED))
    lead = 0.5 * dot(away, mine + theirs)
    lead += _LEAD * (dot(mine, people.velocity[b, a]) - dot(theirs, people.velocity[b, o]))
    tie = np.sign(people.rank[b, a] - people.rank[b, o])
    if not wait and abs(lead) < EVEN:
        return BARELY * tie
    return min(max(lead / TIE + tie if wait else lead / AHEAD, -1.0), 1.0)


@jit
def meetings(people, b, step, shoulders, narrow, pairs, stands):
    """Write the ``pairs`` of scene ``b`` that may come too near, and who ``stands``; return their number.

    Its agents go by steps (A,); who is in a ``narrow`` place (A,) needs ``shoulders``, metres.
    """
    count = 0
    stands[:] = False
    for a in range(people.moved.shape[1]):
        for o in range(a):
            moved, other_moved = people.moved[b, a], people.moved[b, o]
            if not (people.present[b, a] and people.present[b, o] and (moved or other_moved)):
                continue
            away = people.position[b, a] - people.position[b, o]
            distance, bodies = length(away), people.radius[b, a] + people.radius[b, o]
            near, wait = bodies + MARGIN, people.waits[b, a] and people.waits[b, o]
            broad, most = (narrow[a] or narrow[o]) and not wait, near
            reach = people.longest[b, a] if moved else length(step[a])
            reach += people.longest[b, o] if other_moved else length(step[o])
            if distance > (max(near, shoulders) if broad else near) + BEYOND * reach + MARGIN:
                continue
            yields, other = moved and not people.robot[b, a], other_moved and not people.robot[b, o]
            gives, other_gives = yields or (moved and not other), other or (other_moved and not yields)
            share = 0.5 if gives and other_gives else 1.0
            share, other_share, room = share * gives, share * other_gives, shoulders
            rest = min(distance, near) if distance >= bodies else near
            if yields and other:
                first = precedence(people, b, a, o, away, step, wait)
                share -= (0.5 - LEAST_SHARE) * first
                other_share += (0.5 - LEAST_SHARE) * first
                if wait and first != 0:
                    rest = near + SPREAD
                if (broad or wait) and first != 0:
                    past, press = nearest(away, step[a]), nearest(-away, step[o])
                    if first < 0:
                        past, press = press, past
                    if abs(first) > 0.5 and past[0] > 0:
                        room = min(room, past[2])
                    holds_up = past[0] > 0 and past[2] < near
                    if wait and (holds_up or (press[0] > 0 and press[2] < near and distance < near + SPREAD)):
                        stands[o if first > 0 else a] = True
            if broad:
                most = max(near, room)
            pair = pairs[count]
            pair["a"], pair["o"], pair["away"], pair["apart"] = a, o, away, distance
            pair["room"], pair["firm"], pair["rest"] = min(distance, most), min(distance, near), rest
            pair["touch"] = min(distance, bodies + 0.004) - 1e-4
            pair["mine"], pair["theirs"] = share, other_share
            count += 1
    return count


@jit
def begins(people, b, a, step, walls, trace):
    """Note whether an agent is in a narrow place; return whether walls are near, and its room to them."""
    trace.narrow[b, a], trace.slope[b, a] = False, 0.0
    near, room = False, people.radius[b, a] + MARGIN
    if walls.frames.shape[0] == 0 or not people.present[b, a]:
        return near, room
    at = people.position[b, a] + 0j
    reach = max(BEYOND * people.longest[b, a] + people.radius[b, a] + MARGIN, NARROW)
    if least_gap(at, walls, b) < reach:
        gap, away = gap_at(at, walls, b)
        near = people.moved[b, a] and gap < reach
        trace.narrow[b, a] = gap < NARROW
        if gap < room:
            room, trace.slope[b, a] = gap, away
    if not trace.narrow[b, a] and least_gap(at + step, walls, b) < NARROW:
        trace.narrow[b, a] = gap_at(at + step, walls, b)[0] < NARROW
    return near, room


@jit
def shares_of(people, b, step, pairs, count, near, room, walls, level):
    """Write which of `SHARES` of their steps agents walk, level (A,): less of it if they would touch."""
    agents, last = len(step), len(SHARES) - 1
    paths, still = np.zeros((last + 1, agents, 3), np.complex128), np.zeros(3, np.complex128)
    stops = np.zeros(agents, np.bool_)
    for a in range(agents):
        for part in range(last + 1):
            walk(people, b, a, SHARES[part] * step[a], paths[part, a])
    for turn in range(agents + last):
        stops[:] = False
        for k in range(count):
            pair = pairs[k]
            a, o, share, other_share = pair["a"], pair["o"], pair["mine"], pair["theirs"]
            mine, theirs = paths[level[a], a], paths[level[o], o]
            if touches(pair, mine, theirs):
                alone, other = touches(pair, mine, still), touches(pair, still, theirs)
                # where both have to walk for a touch, who goes first need not stop
                stops[a] = stops[a] or (share > 0 and (alone or (not other and share >= 0.5)))
                stops[o] = stops[o] or (other_share > 0 and (other or (not alone and other_share >= 0.5)))
        ended = True
        for a in range(agents):
            if near[a] and not stops[a]:
                least = min(room[a], people.radius[b, a] + MARGIN / 2) - 1e-4
                stops[a] = touches_wall(people.position[b, a], paths[level[a], a], least, walls, b)
            if stops[a]:
                ended, level[a] = False, min(turn + 1, last)
        if ended:
            return


@compiled()
def keep_clear(people, walls, shoulders, out, trace):
    """Write steps (B, A), metres, without contacts, to ``out``, and how they came about to ``trace``."""
    scenes, agents = people.moved.shape
    step, change = np.zeros(agents, np.complex128), np.zeros(agents, np.complex128)
    path, pairs = np.zeros((agents, 3), np.complex128), np.zeros(agents * agents, PAIR)
    room, asking, level = np.zeros(agents), np.zeros(agents), np.zeros(agents, np.int64)
    near, stores = np.zeros(agents, np.bool_), trace.record.size > 0
    for b in range(scenes):
        for a in range(agents):
            step[a] = people.step[b, a]
            near[a], room[a] = begins(people, b, a, step[a], walls, trace)
            if people.present[b, a] and people.moved[b, a]:
                step[a] = limited(step[a], people.longest[b, a])
        stands = trace.stands[b]
        count = meetings(people, b, step, shoulders, trace.narrow[b], pairs, stands)
        for a in range(agents):
            if stands[a]:
                step[a] = 0.0
            walk(people, b, a, step[a], path[a])
        settled, safe, trace.used[b] = False, False, 0
        for r in range(ROUNDS):
            settled, safe = True, True
            change[:], asking[:] = 0.0, 0.0
            for k in range(count):
                pair = pairs[k]
                a, o = pair["a"], pair["o"]
                lacks, way = correction(pair, path[a], path[o])
                if lacks:
                    settled = False
                    asking[a] += 1
                    asking[o] += 1
                    change[a] += pair["mine"] * way
                    change[o] -= pair["theirs"] * way
            for a in range(agents):
                before, worst, pushed = step[a], -1, 0j
                changed = asking[a] > 0
                if not (people.present[b, a] and people.moved[b, a]):
                    if stores:
                        trace.record[b, r, a, 0], trace.record[b, r, a, 3] = before, -1.0
                    continue
                if changed:
                    step[a] += change[a] * (1 / math.sqrt(asking[a]))
                    walk(people, b, a, step[a], path[a])
                aside = step[a]
                if near[a]:
                    pushed, lacks, worst = push(people.position[b, a], path[a], room[a], walls, b)
                    safe = safe and not lacks
                    if pushed != 0:
                        settled, changed = False, True
                        step[a] += pushed
                if stores:
                    trace.record[b, r, a, 0], trace.record[b, r, a, 1] = before, aside
                    trace.record[b, r, a, 2], trace.record[b, r, a, 3] = step[a], worst if pushed != 0 else -1
                if changed:
                    step[a] = limited(step[a], people.longest[b, a])
                    walk(people, b, a, step[a], path[a])
            if settled:
                break
            trace.used[b] = r + 1
        level[:] = 0
        if not (settled and safe):
            shares_of(people, b, step, pairs, count, near, room, walls, level)
        for a in range(agents):
            share = SHARES[level[a]]
            trace.shares[b, a], out[b, a] = share, share * step[a]


def kept(
    steps: ProposedSteps, walls: LocalWalls | None, shoulders: float, out: Tensor, records: bool
) -> tuple[Any, float, Trace]:
    """Write steps (B, A, 2) to ``out`` by `keep_clear`; return what the way back needs if it ``records``."""
    rank = torch.zeros_like(steps.longest) if steps.rank is None else steps.rank
    asked = steps._replace(velocity=TRACE_SECONDS * steps.velocity, rank=rank)
    given = [part.detach().contiguous() for part in asked if part is not None]
    people: Any = [as_complex(part) if part.dim() == 3 else part.numpy() for part in given]
    people = ProposedSteps(*people)
    arrays = _NO_WALLS
    if walls is not None:
        frames, places = walls.frame.t().float().contiguous(), walls.place.t().contiguous()
        arrays = WallArrays(frames.numpy(), places.numpy(), *walls.walls.arrays)
    size = steps.moved.shape
    trace = Trace(
        narrow=np.empty(size, np.bool_),
        slope=np.empty(size, np.complex64),
        shares=np.empty(size, np.float32),
        used=np.empty(size[0], np.int64),
        record=np.empty((size[0], ROUNDS, size[1], 4) if records else (0, 0, 0, 4), np.complex128),
        stands=np.empty(size, np.bool_),
    )
    keep_clear(people, arrays, float(shoulders), as_complex(out), trace)
    return people, float(shoulders), trace


def as_complex(vectors: Tensor) -> Any:
    """Return contiguous vectors (..., 2) as complex numbers (...) in the same memory."""
    return vectors.numpy().view(np.complex64)[..., 0]


_NO_WALLS = WallArrays(
    np.zeros((0, 7), np.float32), np.zeros((0, 3), np.int32), *Walls.of((), "free", 0.0).arrays
)


@jit
def limited_slope(vector, longest, of):
    """Return the gradient by a vector of what `limited` makes of it, for that ``of`` the result."""
    size2 = dot(vector, vector)
    share = longest / math.sqrt(max(size2, 1e-12))
    if share >= 1:
        return of
    along = dot(of, vector) / size2 if size2 > 1e-12 else 0.0
    return share * (of - along * vector)


@jit
def walk_slope(people, b, a, step, of_path):
    """Return the gradients by the step and by the velocity before, for that of the path (3,)."""
    begin, middle, end = of_path[0], of_path[1], of_path[2]
    if not people.moved[b, a]:
        return 0.25 * begin + 0.75 * middle + end, 0j
    command = 0.25 * step
    half = 0.5 * (people.velocity[b, a] - command)
    size = math.sqrt(dot(half, half) + 1e-12)
    commanded = math.sqrt(dot(command, command) + 1e-12)
    ratio, most = commanded / size, 0.25 * people.longest[b, a]
    share, middle = min(ratio, 1.0), middle + end
    first = limited_slope(command + share * half, most, begin + middle)
    later = limited_slope(command - 0.5 * share * half, most, 2 * middle)
    of_command, blend = end + first + later, first - 0.5 * later
    of_half = share * blend
    if ratio < 1:
        of_share = dot(blend, half) / size
        of_half -= (of_share * ratio / size) * half
        of_command += (of_share / commanded) * command
    return 0.25 * (of_command - 0.5 * of_half), 0.5 * of_half


@jit
def correction_slope(pair, mine, theirs, of, out):
    """Write the gradients by the relative place and walk, out (4,), for that ``of`` a correction."""
    out[:] = 0.0
    apart, rooms, of_apart = pair["apart"], (pair["room"], pair["firm"], pair["rest"]), 0.0
    lack, part, along, at, gap = closest(pair["away"], mine, theirs, rooms, True)
    back, demand, line = way_back(pair, mine, theirs)
    weight = weight_of(part, along)
    aside = lack / weight
    # rooms that are the distance itself move with it
    if aside < back:
        if gap == HEAD_ON:
            return  # constants
        share, unit = min(aside, 1e3) / gap, dot(of, at) / gap
        of_lack = unit / weight if aside < 1e3 else 0.0
        go = share * of - ((share * unit + of_lack) / gap) * at
        out[0] = go
        if part == 1:
            out[1] = along * go
        elif part == 2:
            out[1], out[2] = (1 - along) * go, along * go
        else:
            out[3] = (along if part == 0 else BEYOND) * go
        if rooms[0 if part == 0 else 2 if part == 3 else 1] == apart:
            of_apart = of_lack
    elif back > 0:
        of_back, of_line = dot(of, line), back * of
        point, weight = (0, FIRST) if demand == 1 else (2, 1.0)
        out[1 + point] = (-of_back / weight) * line
        of_line -= (of_back / weight) * (mine[point] - theirs[point])
        if rooms[demand] != apart:
            of_apart = -of_back / (BEYOND if demand == 2 else weight)
        of_apart -= dot(of_line, line) / apart
        out[0] = of_line * (1 / apart)
    out[0] += of_apart * line


@jit
def push_slope(people, b, a, steps, slope, grown, place, of_path, of_before):
    """Go back over a wall's push of one agent: change its gradients by step, place and velocity."""
    worst, way = int(steps[3].real), steps[2] - steps[1]
    way = way * (1 / math.sqrt(max(dot(way, way), 1e-24)))
    along = -dot(grown[a], way) / SHIFT[worst]
    place[a] += along * (way - slope)
    for i in range(3):
        of_path[i] = PARTS[worst, i] * along * way
    more, before = walk_slope(people, b, a, steps[1], of_path)
    grown[a] += more
    of_before[a] += before


@compiled()
def keep_clear_slope(people, shoulders, trace, gradient, of_position, of_step, of_velocity):
    """Write gradients (B, A) by positions, steps and velocities, for that of what `keep_clear` writes."""
    scenes, agents = people.moved.shape
    step, path = np.zeros(agents, np.complex128), np.zeros((agents, 3), np.complex128)
    grown, place, before = np.zeros_like(step), np.zeros_like(step), np.zeros_like(step)
    of_path, of_pair = np.zeros_like(path), np.zeros(4, np.complex128)
    asking, stood = np.zeros(agents), np.zeros(agents, np.bool_)
    pairs = np.zeros(agents * agents, PAIR)
    for b in range(scenes):
        place[:], before[:], count = 0.0, 0.0, 0
        for a in range(agents):
            grown[a] = trace.shares[b, a] * gradient[b, a]
        if trace.used[b] > 0:
            for a in range(agents):
                step[a] = people.step[b, a]
                if people.moved[b, a]:
                    step[a] = limited(step[a], people.longest[b, a])
            count = meetings(people, b, step, shoulders, trace.narrow[b], pairs, stood)
        for r in range(trace.used[b] - 1, -1, -1):
            steps = trace.record[b, r]
            asking[:] = 0.0
            for a in range(agents):
                walk(people, b, a, steps[a, 0], path[a])
            for k in range(count):
                pair = pairs[k]
                if correction(pair, path[pair["a"]], path[pair["o"]])[0]:
                    asking[pair["a"]] += 1
                    asking[pair["o"]] += 1
            for a in range(agents):
                pushed = steps[a, 3].real >= 0
                if people.moved[b, a] and (asking[a] > 0 or pushed):
                    grown[a] = limited_slope(steps[a, 2], people.longest[b, a], grown[a])
                    if pushed:
                        slope = trace.slope[b, a]
                        push_slope(people, b, a, steps[a], slope, grown, place, of_path[a], before)
            of_path[:] = 0.0
            for k in range(count):
                pair = pairs[k]
                a, o = pair["a"], pair["o"]
                if asking[a] == 0 or asking[o] == 0 or not correction(pair, path[a], path[o])[0]:
                    continue
                mine, theirs = pair["mine"] / math.sqrt(asking[a]), pair["theirs"] / math.sqrt(asking[o])
                of = mine * grown[a] - theirs * grown[o]
                correction_slope(pair, path[a], path[o], of, of_pair)
                place[a] += of_pair[0]
                place[o] -= of_pair[0]
                for i in range(3):
                    of_path[a, i] += of_pair[1 + i]
                    of_path[o, i] -= of_pair[1 + i]
            for a in range(agents):
                more, of_before = walk_slope(people, b, a, steps[a, 0], of_path[a])
                grown[a] += more
                before[a] += of_before
        for a in range(agents):
            of = grown[a]
            if trace.stands[b, a]:
                of = 0j
            elif people.moved[b, a]:
                of = limited_slope(people.step[b, a] + 0j, people.longest[b, a], of)
            of_step[b, a], of_position[b, a], of_velocity[b, a] = of, place[a], before[a]


def slopes_of(stored: tuple[Any, float, Trace], gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return gradients (B, A, 2) of positions, steps and velocities, for that of what `kept` has stored."""
    gradient = gradient.detach().contiguous()
    place, step, velocity = (torch.empty_like(gradient) for _ in range(3))
    keep_clear_slope(*stored, *(as_complex(part) for part in (gradient, place, step, velocity)))
    return place, step, TRACE_SECONDS * velocity
