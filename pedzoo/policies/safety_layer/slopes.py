"""The way back over the safety layer's loops, for gradients, which are those of the torch path.

Parts of a way, shares of steps and directions of walls count as constants. The gradient by (x, y) is the
complex number x + iy, too.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.compiled import compiled, jit
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.policies.safety_layer.clearance import BEYOND, FIRST, HEAD_ON
from pedzoo.policies.safety_layer.loops import (
    PAIR,
    PARTS,
    SHIFT,
    Trace,
    as_complex,
    closest,
    correction,
    dot,
    limited,
    meetings,
    walk,
    way_back,
    weight_of,
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
