"""The loops of the compiled backend: `pedzoo.sim.dynamics.integrate` and contacts, agent by agent."""

from __future__ import annotations

import math

import numpy as np

from pedzoo.maps.walls.compiled import compiled, quarter, wall_gap

_NO_WALL = 1e6


@compiled(
    "void(f4[:,:,:], f4[:,:,:,:], f4[:,:], b1[:,:], b1[:,:], f4[:,:,:,:,:], f4[:,:,:], b1[:,:], f8,"
    " i8, i8, f8, f8, f8, f8, f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:], f8,"
    " f4[:,:,:,:], b1[:,:,:], b1[:,:,:], b1[:,:,:], f4[:,:,:,:,:], f4[:,:,:,:])"
)
def advance(
    position, velocity, radius, present, moved, played, goal, wanted, goal_radius2,
    steps, strides, skin, rounding, creep, tick_seconds,
    frames, places, choice, option, least, limit,
    trace, agent_contact, wall_contact, reached, paths, slopes,
):  # fmt: skip
    """Write traces (B, A, S, 2), contacts and goals reached (B, A, S), paths (B, A, S, M, 2) if asked for.

    If asked for, ``slopes`` (B, A, S, 8) are written, two matrices row by row. They are the derivatives of
    the position at the end of each trace step, by that at its beginning and by its velocity.

    Args, in this order:

    * of the agents: positions (B, A, 2), metres; velocities (2, S, B, A), m/s; radii (B, A), metres;
    * which of them are there, and which are moved (B, A);
    * played paths (B, A, S, M, 2), size 0 for none; goals (B, A, 2); which agents may reach theirs (B, A);
    * numbers;
    * the walls as scenes see them, frames (B, 7) and places (B, 3) (size 0 without walls), and their tables;
    * the results.
    """
    scenes, agents, ticks = trace.shape[:3]
    has_walls, has_script = frames.shape[0] > 0, played.size > 0
    path = np.empty((agents, steps, 2))
    here, away = np.empty((agents, 2)), np.zeros((agents, 2))
    blocked_away, blocked_at = np.zeros((agents, 2)), np.zeros((agents, 2))
    gap, allowed, blocked_gap, extent = np.empty(agents), np.empty(agents), np.empty(agents), np.empty(agents)
    room = np.empty(agents)
    frame, place = np.empty(7), np.empty(3, np.int64)
    seconds = tick_seconds / strides
    for b in range(scenes):
        if has_walls:
            frame[:], place[:] = frames[b], places[b]
        for a in range(agents):
            here[a, 0], here[a, 1] = position[b, a, 0], position[b, a, 1]
            blocked_gap[a] = _NO_WALL
            gap[a] = np.nan  # looked up where a wall can matter
            allowed[a] = radius[b, a] - skin
            # no wall is nearer than this, from any point of this quarter of a cell
            room[a] = _NO_WALL
            if has_walls and moved[b, a]:
                _, _, index = quarter(here[a, 0], here[a, 1], frame, place)
                room[a] = least[index] - 3 * frame[6]
                if least[index] < allowed[a]:
                    gap[a], away[a, 0], away[a, 1] = wall_gap(
                        here[a, 0], here[a, 1], frame, place, choice, option, limit
                    )
                    allowed[a] = min(gap[a], allowed[a])
        for s in range(ticks):
            for a in range(agents):
                wall_contact[b, a, s] = False
                agent_contact[b, a, s] = False
                if not present[b, a]:
                    path[a, :, 0], path[a, :, 1] = here[a, 0], here[a, 1]
                    continue
                if not moved[b, a]:
                    for m in range(steps):
                        if has_script:
                            here[a, 0], here[a, 1] = played[b, a, s, m, 0], played[b, a, s, m, 1]
                        path[a, m, 0], path[a, m, 1] = here[a, 0], here[a, 1]
                        if has_walls and not wall_contact[b, a, s]:
                            _, _, index = quarter(here[a, 0], here[a, 1], frame, place)
                            if least[index] < radius[b, a]:
                                nearest = wall_gap(
                                    here[a, 0], here[a, 1], frame, place, choice, option, limit
                                )
                                wall_contact[b, a, s] = nearest[0] < radius[b, a]
                    continue
                if slopes.size > 0:
                    m00, m01, m10, m11, n00, n01, n10, n11 = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
                full_x, full_y = velocity[0, s, b, a] * seconds, velocity[1, s, b, a] * seconds
                length = math.sqrt(full_x * full_x + full_y * full_y)
                near = radius[b, a] + length + 1e-3
                for n in range(strides):
                    old_x, old_y = here[a, 0], here[a, 1]
                    free = room[a] > near
                    if not free:
                        _, _, index = quarter(old_x, old_y, frame, place)
                        room[a] = least[index] - 3 * frame[6]
                        free = least[index] > near
                    room[a] -= length
                    if free:
                        here[a, 0], here[a, 1] = old_x + full_x, old_y + full_y
                        if slopes.size > 0:
                            n00, n11 = n00 + seconds, n11 + seconds
                        gap[a], blocked_gap[a], allowed[a] = np.nan, _NO_WALL, radius[b, a] - skin
                    else:
                        if math.isnan(gap[a]):
                            gap[a], away[a, 0], away[a, 1] = wall_gap(
                                old_x, old_y, frame, place, choice, option, limit
                            )
                        share = min(max(allowed[a], creep) / max(length, 1e-6), 1.0)
                        move_x, move_y = full_x * share, full_y * share
                        lacking = max(allowed[a] - gap[a] - move_x * away[a, 0] - move_y * away[a, 1], 0.0)
                        x, y = old_x + move_x + lacking * away[a, 0], old_y + move_y + lacking * away[a, 1]
                        # what is left of moves: all but what the walls take
                        p00, p01, p11 = 1.0, 0.0, 1.0
                        if lacking > 0:
                            p00, p01, p11 = 1 - away[a, 0] ** 2, -away[a, 0] * away[a, 1], 1 - away[a, 1] ** 2
                        p10 = p01
                        if blocked_gap[a] < _NO_WALL:
                            bx, by = blocked_away[a, 0], blocked_away[a, 1]
                            ahead = blocked_gap[a] + (x - blocked_at[a, 0]) * bx + (y - blocked_at[a, 1]) * by
                            lacking = max(allowed[a] - ahead, 0.0)
                            x, y = x + lacking * bx, y + lacking * by
                            if lacking > 0:
                                q0, q1 = bx * p00 + by * p10, bx * p01 + by * p11
                                p00, p01, p10, p11 = (
                                    p00 - bx * q0,
                                    p01 - bx * q1,
                                    p10 - by * q0,
                                    p11 - by * q1,
                                )
                        new_gap, new_x, new_y = wall_gap(x, y, frame, place, choice, option, limit)
                        if new_gap < allowed[a] - rounding:
                            blocked_gap[a], blocked_at[a, 0], blocked_at[a, 1] = new_gap, x, y
                            blocked_away[a, 0], blocked_away[a, 1] = new_x, new_y
                        else:
                            blocked_gap[a] = _NO_WALL
                            here[a, 0], here[a, 1] = x, y
                            gap[a], away[a, 0], away[a, 1] = new_gap, new_x, new_y
                            allowed[a] = max(min(new_gap, radius[b, a] - skin), allowed[a])
                            if slopes.size > 0:
                                m00, m10 = p00 * m00 + p01 * m10, p10 * m00 + p11 * m10
                                m01, m11 = p00 * m01 + p01 * m11, p10 * m01 + p11 * m11
                                n00, n11 = n00 + share * seconds, n11 + share * seconds
                                n00, n10 = p00 * n00 + p01 * n10, p10 * n00 + p11 * n10
                                n01, n11 = p00 * n01 + p01 * n11, p10 * n01 + p11 * n11
                        if gap[a] < radius[b, a]:
                            wall_contact[b, a, s] = True
                    half = steps // strides
                    for m in range(half):
                        part = (m + 1) / half
                        path[a, n * half + m, 0] = old_x + part * (here[a, 0] - old_x)
                        path[a, n * half + m, 1] = old_y + part * (here[a, 1] - old_y)
                        if not free and part < 1 and not wall_contact[b, a, s]:
                            x, y = path[a, n * half + m, 0], path[a, n * half + m, 1]
                            _, _, index = quarter(x, y, frame, place)
                            if least[index] < radius[b, a]:
                                nearest = wall_gap(x, y, frame, place, choice, option, limit)
                                wall_contact[b, a, s] = nearest[0] < radius[b, a]
                if slopes.size > 0:
                    for k, value in enumerate((m00, m01, m10, m11, n00, n01, n10, n11)):
                        slopes[b, a, s, k] = value
            for a in range(agents):
                extent[a] = 0.0
                for m in range(1, steps):
                    dx, dy = path[a, m, 0] - path[a, 0, 0], path[a, m, 1] - path[a, 0, 1]
                    extent[a] = max(extent[a], dx * dx + dy * dy)
                extent[a] = math.sqrt(extent[a])
                trace[b, a, s, 0], trace[b, a, s, 1] = path[a, steps - 1, 0], path[a, steps - 1, 1]
                if paths.size > 0:
                    paths[b, a, s] = path[a]
                done = s > 0 and reached[b, a, s - 1]
                if wanted[b, a] and not done:
                    for m in range(steps):
                        dx, dy = path[a, m, 0] - goal[b, a, 0], path[a, m, 1] - goal[b, a, 1]
                        done = done or dx * dx + dy * dy < goal_radius2
                reached[b, a, s] = done
            for a in range(agents):
                if not present[b, a]:
                    continue
                for other in range(a):
                    if not present[b, other] or (agent_contact[b, a, s] and agent_contact[b, other, s]):
                        continue
                    both = radius[b, a] + radius[b, other]
                    far = both + extent[a] + extent[other]
                    dx, dy = path[a, 0, 0] - path[other, 0, 0], path[a, 0, 1] - path[other, 0, 1]
                    if dx * dx + dy * dy > far * far:
                        continue
                    for m in range(steps):
                        dx, dy = path[a, m, 0] - path[other, m, 0], path[a, m, 1] - path[other, m, 1]
                        if dx * dx + dy * dy < both * both:
                            agent_contact[b, a, s] = True
                            agent_contact[b, other, s] = True
                            break


@compiled("void(f4[:,:,:], f4[:,:], b1[:,:], f4[:,:,:], f4[:,:,:], f4[:,:])")
def body_rays(position, radius, present, origin, direction, length):
    """Shorten rays (B, R) to where they meet a body (B, A); those that begin inside of it do not see it."""
    for b in range(length.shape[0]):
        for a in range(radius.shape[1]):
            if not present[b, a]:
                continue
            x, y, square = position[b, a, 0], position[b, a, 1], radius[b, a] * radius[b, a]
            for i in range(length.shape[1]):
                off_x, off_y = origin[b, i, 0] - x, origin[b, i, 1] - y
                along = off_x * direction[b, i, 0] + off_y * direction[b, i, 1]
                outside = off_x * off_x + off_y * off_y - square
                # |origin + t direction - position| = radius; a root below zero lies behind the ray
                root = along * along - outside
                if along < 0 and outside > 0 and root > 0:
                    length[b, i] = min(length[b, i], -along - np.sqrt(root))
