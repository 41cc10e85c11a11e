"""The loops of `.compiled_step`: `kernel.step` before and after the planner.

Every operation is that of the kernel, in its order and in single precision.
"""

from __future__ import annotations

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.sim.physics_parts.compiled_loops import advance

_0, _1, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_TINY, _MOST = np.float32(1e-12), np.float32(1e6)

_BLOCK = 32
"""Scenes that are moved together: what was written last is still in the processor's cache."""


@jit
def _limited(x, y, top_speed):
    """Return a velocity that is shortened to a top speed: `pedzoo.core.geometry.limited`."""
    share = min(top_speed / np.sqrt(max(x * x + y * y, _TINY)), _1)
    return x * share, y * share


@jit
def _blended(old_x, old_y, x, y, top_speed, velocity, b, a):
    """Write the velocities (2, S, B, A) of one agent: `pedzoo.core.geometry.blended`, limited."""
    ticks = velocity.shape[1]
    if ticks == 1:
        velocity[0, 0, b, a], velocity[1, 0, b, a] = _limited(x, y, top_speed)
        return
    between = max(1, ticks - 2)
    half_x, half_y = _HALF * (old_x - x), _HALF * (old_y - y)
    size = np.sqrt(half_x * half_x + half_y * half_y + _TINY)
    speed = np.sqrt(x * x + y * y + _TINY)
    share = min(np.float32(0.5 * between) * speed / size, _1)
    half_x, half_y = half_x * share, half_y * share
    part = np.float32(between)
    for tick in range(ticks):
        now_x, now_y = x, y
        if tick == 0:
            now_x, now_y = x + half_x, y + half_y
        elif tick <= between:
            now_x, now_y = x - half_x / part, y - half_y / part
        velocity[0, tick, b, a], velocity[1, tick, b, a] = _limited(now_x, now_y, top_speed)


@compiled(
    "void(f4[:,:,:], b1[:], b1[:,:], b1[:,:], i8[:,:], i8[:,:,:], i8[:,:], i8[:,:], i8[:,:], f4[:,:,:,::1],"
    " f4[:,:,:], f4[:,:], f4[:,:], f4[:,:], f4[:,:,:], f4[:], f4[:,:], f4[:,:], b1[:,:],"
    " i8, i8, b1, b1, f4, f4, f8,"
    " i8, i8, f8, f8, f8, f8, f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:], f8,"
    " f4[:,:,:,::1], b1[:,:,:,:], f4[:], b1[:], b1[:,:,:], i8[:,:,:], f4[:,:,:], f4[:,:])"
)
def move(
    commands, failed, mask, controlled, goal_id, later_goals, person, drawn, reached, past,
    velocity, heading, top_speed, radius, goal_point, clock, deadline, stands, overdue,
    ticks, goals, leave, keep_goal, rounding, turns_from, goal_radius,
    steps, strides, skin, wall_rounding, creep, tick_seconds,
    frames, places, choice, option, least, limit,
    new_past, events, new_clock, new_failed, flags, counts, new_velocity, new_heading,
):  # fmt: skip
    """Write the result of a decision for the scenes, without the planner's part.

    Args, in this order: commands (B, A, 2) and fields of `State`; numbers of the rules; numbers of
    `pedzoo.sim.physics_parts.compiled_loops.advance`; the walls; the results:

    * the past with the trace at its end (B, A, 29, 2);
    * events (3, B, A, S): contacts with agents, with walls, goals reached;
    * clocks and failures (B,);
    * flags (6, B, A): mask, controlled, overdue, moved, goal reached now, set out now;
    * counts (4, B, A): person, goal, goals drawn, goals reached;
    * velocities (B, A, 2) and headings (B, A).
    """
    scenes, agents = mask.shape
    length = past.shape[2]
    speeds = np.empty((2, ticks, scenes, agents), np.float32)
    walking = np.empty((scenes, agents), np.bool_)
    new_mask, new_controlled, new_overdue, moving, hit, sets_out = flags
    second = np.float32(tick_seconds)
    step = np.float32(ticks * tick_seconds)
    for first in range(0, scenes, _BLOCK):
        last = min(first + _BLOCK, scenes)
        for b in range(first, last):
            bad = failed[b]
            for a in range(agents):
                finite = math.isfinite(commands[b, a, 0]) and math.isfinite(commands[b, a, 1])
                bad = bad or (controlled[b, a] and not finite)
            new_failed[b] = bad
            new_clock[b] = clock[b] + step
            for a in range(agents):
                moving[b, a] = controlled[b, a] and not bad
                walking[b, a] = moving[b, a] and goal_id[b, a] >= 0
                x, y = _0, _0
                if walking[b, a]:
                    x = min(max(commands[b, a, 0], -_MOST), _MOST)
                    y = min(max(commands[b, a, 1], -_MOST), _MOST)
                x, y = _limited(x, y, top_speed[b, a])
                _blended(velocity[b, a, 0], velocity[b, a, 1], x, y, top_speed[b, a], speeds, b, a)
                for n in range(length - ticks):
                    new_past[b, a, n, 0] = past[b, a, n + ticks, 0]
                    new_past[b, a, n, 1] = past[b, a, n + ticks, 1]
        advance(
            past[first:last, :, length - 1], speeds[:, :, first:last], radius[first:last], mask[first:last],
            moving[first:last], np.empty((0, 0, 0, 0, 2), np.float32), goal_point[first:last],
            walking[first:last], goal_radius, steps, strides, skin, wall_rounding, creep, tick_seconds,
            frames[first:last], places[first:last], choice, option, least, limit,
            new_past[first:last, :, length - ticks :], events[0, first:last], events[1, first:last],
            events[2, first:last], np.empty((0, 0, 0, 0, 2), np.float32), np.empty((0, 0, 0, 8), np.float32),
        )  # fmt: skip
        for b in range(first, last):
            for a in range(agents):
                got = events[2, b, a, ticks - 1]
                in_time = False
                for tick in range(ticks):
                    when = clock[b] + second * np.float32(tick + 1)
                    in_time = in_time or (events[2, b, a, tick] and when <= deadline[b, a] + rounding)
                past_deadline = (
                    new_clock[b] > deadline[b, a] + rounding and not in_time and reached[b, a] < goals
                )
                new_overdue[b, a] = overdue[b, a] or (past_deadline and controlled[b, a])
                waits = mask[b, a] and not controlled[b, a] and stands[b, a] > 0
                sets_out[b, a] = waits and new_clock[b] + rounding >= stands[b, a]
                count = reached[b, a] + got
                stays = not leave or count < goals
                new_mask[b, a] = mask[b, a] and stays
                new_controlled[b, a] = (controlled[b, a] or sets_out[b, a]) and stays
                hit[b, a] = got
                later = later_goals[b, a, drawn[b, a] % later_goals.shape[2]]
                counts[0, b, a] = person[b, a] if new_mask[b, a] else -1
                counts[1, b, a] = later if got and (later >= 0 or not keep_goal) else goal_id[b, a]
                counts[2, b, a] = drawn[b, a] + got
                counts[3, b, a] = count
                x = (new_past[b, a, length - 1, 0] - new_past[b, a, length - 2, 0]) / second
                y = (new_past[b, a, length - 1, 1] - new_past[b, a, length - 2, 1]) / second
                new_velocity[b, a, 0], new_velocity[b, a, 1] = x, y
                new_heading[b, a] = heading[b, a]
                if x * x + y * y > turns_from * turns_from:
                    new_heading[b, a] = math.atan2(y, x)


@compiled(
    "void(f4[:,:], f4[:,:], f4[:,:], f4[:,:], f4[:,:], f4[:,:], f4[:], b1[:], b1[:,:], b1[:,:,:,:],"
    " b1[:,:,:], i8[:,:,:], i8, f4, f4, f4, f4, f4[:,:,:], b1[:,:], i8[:,:], i8[:,:,:])"
)
def settle(
    distance, remaining_path, planned, deadline, goal_since, pref_speed, clock, failed, mask, events, flags,
    counts, goals, paths, least_seconds, goal_radius, contact_cost, lengths, ends, reached, reached_until,
):  # fmt: skip
    """Write the effect of the planner's paths (B, A) on a decision.

    Args, in this order: the planner's ways; fields of the state before, but for clocks and failures; results
    of `move`; numbers; the results: lengths (5, B, A), which are ways, planned ways, deadlines, when
    goals were given, and rewards; ends (2, B), terminated and truncated; goals reached before (B, A), and
    until each trace point (B, A, S).
    """
    scenes, agents = mask.shape
    overdue, moving, hit, sets_out = flags[2], flags[3], flags[4], flags[5]
    for b in range(scenes):
        ended, settled = True, True
        for a in range(agents):
            now = distance[b, a] if math.isfinite(distance[b, a]) else remaining_path[b, a]
            lengths[0, b, a] = now
            begins = hit[b, a] or sets_out[b, a]
            goes_on = (hit[b, a] and counts[1, b, a] >= 0) or sets_out[b, a]
            lengths[1, b, a] = planned[b, a] + (max(now - goal_radius, _0) if goes_on else _0)
            lengths[2, b, a], lengths[3, b, a] = deadline[b, a], goal_since[b, a]
            if begins:
                lengths[3, b, a] = clock[b]
                lengths[2, b, a] = clock[b] + max(paths * now / pref_speed[b, a], least_seconds)
            in_contact = False
            for tick in range(events.shape[3]):
                in_contact = in_contact or events[0, b, a, tick] or events[1, b, a, tick]
                reached_until[b, a, tick] = reached[b, a] + events[2, b, a, tick]
            progress = remaining_path[b, a] - (_0 if hit[b, a] else now)
            lengths[4, b, a] = _0
            if moving[b, a]:
                lengths[4, b, a] = progress - (contact_cost if in_contact else _0)
            done = counts[3, b, a] >= goals or not mask[b, a]
            ended = ended and done
            settled = settled and (done or overdue[b, a])
        ends[0, b] = ended and not failed[b]
        ends[1, b] = (settled or failed[b]) and not ends[0, b]
