"""The way back over the safety layer's loops, for gradients; and the way of tensors into both.

Gradients are those of the torch path: parts of a way, shares of steps and directions of walls count as
constants.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.compiled import compiled, jit
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.walls import LocalWalls
from pedzoo.policies.safety_layer.clearance import BEYOND, FIRST, ROUNDS, ProposedSteps
from pedzoo.policies.safety_layer.loops import (
    PAIR,
    People,
    Trace,
    WallArrays,
    closest,
    correction,
    keep_clear,
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
def place_slope(n, of_x, of_y, out):
    """Write the gradient by a walk, out (6,), for that of its place ``n``: see `place_on`."""
    out[:] = 0.0
    if n == 9:
        out[4], out[5] = BEYOND * of_x, BEYOND * of_y
    elif n <= 2:
        out[0], out[1] = 0.5 * n * of_x, 0.5 * n * of_y
    else:
        at, part = (0, 0.25 * (n - 2)) if n <= 6 else (2, 0.5 * (n - 6))
        out[at], out[at + 1] = (1 - part) * of_x, (1 - part) * of_y
        out[at + 2], out[at + 3] = part * of_x, part * of_y


@jit
def walk_slope(x, y, before, longest, blends, of_path, grown, of_before):
    """Add the gradients by the step and by the velocity before, (2,) each, for that of the path (6,)."""
    begin_x, begin_y, middle_x, middle_y, end_x, end_y = of_path
    if not blends:
        grown[0] += 0.25 * begin_x + 0.75 * middle_x + end_x
        grown[1] += 0.25 * begin_y + 0.75 * middle_y + end_y
        return
    command_x, command_y = 0.25 * x, 0.25 * y
    half_x, half_y = 0.5 * (before[0] - command_x), 0.5 * (before[1] - command_y)
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
    grown[0] += 0.25 * (of_command_x - 0.5 * of_half_x)
    grown[1] += 0.25 * (of_command_y - 0.5 * of_half_y)
    of_before[0] += 0.5 * of_half_x
    of_before[1] += 0.5 * of_half_y


@jit
def correction_slope(pair, mine, theirs, blends, of_x, of_y, out):
    """Write gradients by the place (x, y) and by the relative walk (6,), out (8,), for a correction's."""
    out[:] = 0.0
    apart, first = pair["apart"], FIRST if blends else 0.25
    lack, part, along, at_x, at_y, gap = closest(
        pair["x"], pair["y"], mine, theirs, pair["room"], pair["firm"], pair["rest"], blends, blends
    )
    line_x, line_y = pair["x"] / apart, pair["y"] / apart
    back, demand = way_back(pair, mine, theirs, blends)
    weight = weight_of(part, along)
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
            of_end = along if part == 0 else BEYOND
            out[6], out[7] = of_end * go_x, of_end * go_y
        if (pair["room"] if part == 0 else pair["rest"] if part == 3 else pair["firm"]) == apart:
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
        if (pair["room"] if demand == 0 else pair["rest"] if demand == 2 else pair["firm"]) != apart:
            of_apart = -of_back / (BEYOND if demand == 2 else weight)
        of_apart -= (of_line_x * line_x + of_line_y * line_y) / apart
        out[0], out[1] = of_line_x / apart, of_line_y / apart
    out[0], out[1] = out[0] + of_apart * line_x, out[1] + of_apart * line_y


@jit
def push_slope(people, b, a, steps, path, blends, slope, grown, place, of_path, of_before):
    """Go back over a wall's push of one agent: change its gradients by step, place and velocity."""
    worst = int(steps[6])
    x, y = steps[4] - steps[2], steps[5] - steps[3]
    _, _, weight = place_on(path, worst, FIRST if blends else 0.25)
    size2 = max(x * x + y * y, 1e-24)
    along = -(grown[0] * x + grown[1] * y) / (math.sqrt(size2) * weight)
    x, y = along * x / math.sqrt(size2), along * y / math.sqrt(size2)
    place[0] += x - along * slope[0]
    place[1] += y - along * slope[1]
    place_slope(worst, x, y, of_path)
    velocity, longest = people.velocity[b, a], people.longest[b, a]
    walk_slope(steps[2], steps[3], velocity, longest, blends, of_path, grown, of_before)


@compiled()
def keep_clear_slope(people, blends, shoulders, trace, gradient, of_position, of_step, of_velocity):
    """Write gradients (B, A, 2) by positions, steps asked for and velocities, for ``gradient`` of the result.

    The other args are those of `keep_clear`, and its trace.
    """
    scenes, agents = people.moved.shape
    step, path, of_path = np.zeros((agents, 2)), np.zeros((agents, 6)), np.zeros((agents, 6))
    grown, place, before = np.zeros((agents, 2)), np.zeros((agents, 2)), np.zeros((agents, 2))
    asking, of_pair, stood = np.zeros(agents), np.zeros(8), np.zeros(agents, np.bool_)
    pairs = np.zeros(agents * agents, PAIR)
    for b in range(scenes):
        place[:], before[:] = 0.0, 0.0
        for a in range(agents):
            share = trace.shares[b, a]
            grown[a, 0], grown[a, 1] = share * gradient[b, a, 0], share * gradient[b, a, 1]
        count = 0
        if trace.used[b] > 0:
            for a in range(agents):
                step[a, 0], step[a, 1] = people.asked[b, a, 0], people.asked[b, a, 1]
                if people.moved[b, a]:
                    step[a, 0], step[a, 1] = limited(step[a, 0], step[a, 1], people.longest[b, a])
            count = meetings(people, b, step, blends, shoulders, trace.narrow[b], pairs, stood)
        for r in range(trace.used[b] - 1, -1, -1):
            steps = trace.record[b, r]
            asking[:] = 0.0
            for a in range(agents):
                walk(
                    steps[a, 0], steps[a, 1], people.velocity[b, a], people.longest[b, a],
                    blends and people.moved[b, a], path[a],
                )  # fmt: skip
            for k in range(count):
                pair = pairs[k]
                if correction(pair, path[pair["a"]], path[pair["o"]], blends)[0]:
                    asking[pair["a"]] += 1
                    asking[pair["o"]] += 1
            for a in range(agents):
                if not people.moved[b, a] or (asking[a] == 0 and steps[a, 6] == 0):
                    continue
                grown[a, 0], grown[a, 1] = limited_slope(
                    steps[a, 4], steps[a, 5], people.longest[b, a], grown[a, 0], grown[a, 1]
                )
                if steps[a, 6] > 0:
                    push_slope(
                        people, b, a, steps[a], path[a], blends, trace.slope[b, a],
                        grown[a], place[a], of_path[a], before[a],
                    )  # fmt: skip
            of_path[:] = 0.0
            for k in range(count):
                pair = pairs[k]
                a, o = pair["a"], pair["o"]
                if asking[a] == 0 or asking[o] == 0 or not correction(pair, path[a], path[o], blends)[0]:
                    continue
                mine, theirs = pair["mine"] / math.sqrt(asking[a]), pair["theirs"] / math.sqrt(asking[o])
                of_x = mine * grown[a, 0] - theirs * grown[o, 0]
                of_y = mine * grown[a, 1] - theirs * grown[o, 1]
                correction_slope(pair, path[a], path[o], blends, of_x, of_y, of_pair)
                for i in range(2):
                    place[a, i] += of_pair[i]
                    place[o, i] -= of_pair[i]
                for i in range(6):
                    of_path[a, i] += of_pair[2 + i]
                    of_path[o, i] -= of_pair[2 + i]
            for a in range(agents):
                walk_slope(
                    steps[a, 0], steps[a, 1], people.velocity[b, a], people.longest[b, a],
                    blends and people.moved[b, a], of_path[a], grown[a], before[a],
                )  # fmt: skip
        for a in range(agents):
            x, y = grown[a, 0], grown[a, 1]
            if trace.stands[b, a]:
                x, y = 0.0, 0.0
            elif people.moved[b, a]:
                x, y = limited_slope(people.asked[b, a, 0], people.asked[b, a, 1], people.longest[b, a], x, y)
            of_step[b, a, 0], of_step[b, a, 1] = x, y
            of_position[b, a, 0], of_position[b, a, 1] = place[a, 0], place[a, 1]
            of_velocity[b, a, 0], of_velocity[b, a, 1] = before[a, 0], before[a, 1]


_NO_WALLS = WallArrays(
    np.zeros((0, 7), np.float32),
    np.zeros((0, 3), np.int32),
    np.zeros(1, np.int32),
    np.zeros((1, 1), np.float32),
    np.zeros(1, np.float32),
    0.0,
)


class KeptClear(torch.autograd.Function):
    """Records the corrections of steps if gradients are asked for, and goes back over them."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        """Return the steps (B, A, 2).

        Given are positions, steps and velocities, then all of the steps, the walls and the shoulders.
        """
        steps, walls, shoulders = given[3:]
        people, out = _people(steps), torch.empty_like(steps.step, memory_format=torch.contiguous_format)
        size, blends = steps.moved.shape, steps.velocity is not None
        records = any(ctx.needs_input_grad)
        trace = Trace(
            narrow=np.empty(size, np.bool_),
            slope=np.empty((*size, 2), np.float32),
            shares=np.empty(size, np.float32),
            used=np.empty(size[0], np.int64),
            record=np.empty((size[0], ROUNDS, size[1], 7) if records else (0, 0, 0, 7)),
            stands=np.empty(size, np.bool_),
        )
        keep_clear(people, _wall_arrays(walls), blends, float(shoulders), out.numpy(), trace)
        if records:
            ctx.stored = people, blends, float(shoulders), trace
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor | None, ...]:
        """Return gradients (B, A, 2) of positions, steps and velocities."""
        gradient = gradients[0].detach().contiguous()
        values = [torch.empty_like(gradient) for _ in range(3)]
        keep_clear_slope(*ctx.stored, gradient.numpy(), *(part.numpy() for part in values))
        place, step, velocity = values
        return place, step, TRACE_SECONDS * velocity if ctx.needs_input_grad[2] else None, None, None, None


def _people(steps: ProposedSteps) -> People:
    before = steps.step if steps.velocity is None else steps.velocity * TRACE_SECONDS
    rank = torch.zeros_like(steps.longest) if steps.rank is None else steps.rank
    parts = (*steps[:2], before, *steps[2:8], rank)
    return People(*(part.detach().contiguous().numpy() for part in parts))


def _wall_arrays(walls: LocalWalls | None) -> WallArrays:
    if walls is None:
        return _NO_WALLS
    return WallArrays(
        walls.frame.t().float().contiguous().numpy(),
        walls.place.t().contiguous().numpy(),
        *walls.walls.arrays,
    )
