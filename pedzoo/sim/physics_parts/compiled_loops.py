"""The loops of the compiled backend: `pedzoo.sim.dynamics.integrate` and contacts, agent by agent."""

from __future__ import annotations

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit
from pedzoo.maps.walls.compiled import quarter, wall_gap
from pedzoo.maps.walls.constants import NO_WALL


@jit
def _extent(path, a):
    """Return how far the path of an agent (A, K, 2) leads from its first point, metres."""
    farthest = 0.0
    for k in range(path.shape[1]):
        dx, dy = path[a, k, 0] - path[a, 0, 0], path[a, k, 1] - path[a, 0, 1]
        farthest = max(farthest, dx * dx + dy * dy)
    return math.sqrt(farthest)


@jit
def _reaches(path, extent, goal_x, goal_y, goal_radius, steps, reached, b, a):
    """Set in which trace steps (B, A, S) an agent on its path (A, S * M, 2) has been at its goal."""
    dx, dy = path[a, 0, 0] - goal_x, path[a, 0, 1] - goal_y
    if dx * dx + dy * dy > (goal_radius + extent) ** 2:
        return
    for k in range(path.shape[1]):
        dx, dy = path[a, k, 0] - goal_x, path[a, k, 1] - goal_y
        if dx * dx + dy * dy < goal_radius * goal_radius:
            for s in range(k // steps, reached.shape[2]):
                reached[b, a, s] = True
            return


@jit
def _touch(path, extent, present, radius, steps, contact, b):
    """Set in which trace steps (B, A, S) agents of a scene on paths (A, S * M, 2) touch another one."""
    for a in range(1, len(path)):
        if not present[b, a]:
            continue
        x, y, body, way = path[a, 0, 0], path[a, 0, 1], radius[b, a], extent[a]
        for other in range(a):
            both = body + radius[b, other]
            far = both + way + extent[other]
            dx, dy = x - path[other, 0, 0], y - path[other, 0, 1]
            if dx * dx + dy * dy > far * far or not present[b, other]:
                continue
            for s in range(contact.shape[2]):
                for k in range(s * steps, (s + 1) * steps):
                    dx, dy = path[a, k, 0] - path[other, k, 0], path[a, k, 1] - path[other, k, 1]
                    if dx * dx + dy * dy < both * both:
                        contact[b, a, s], contact[b, other, s] = True, True
                        break


@compiled(
    "void(f4[:,:,:], f4[:,:,:,:], f4[:,:], b1[:,:], b1[:,:], f4[:,:,:,:,:], f4[:,:,:], b1[:,:], f8,"
    " i8, i8, f8, f8, f8, f8, f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:], f8,"
    " f4[:,:,:,:], b1[:,:,:], b1[:,:,:], b1[:,:,:], f4[:,:,:,:,:], f4[:,:,:,:])"
)
def advance(
    position, velocity, radius, present, moved, played, goal, wanted, goal_radius,
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
    has_walls, has_script, has_slopes = frames.shape[0] > 0, played.size > 0, slopes.size > 0
    points = ticks * steps
    path, extent = np.empty((agents, points, 2)), np.empty(agents)
    frame, place = np.empty(7), np.empty(3, np.int64)
    seconds = tick_seconds / strides
    for b in range(scenes):
        if has_walls:
            frame[:], place[:] = frames[b], places[b]
        for a in range(agents):
            x, y, body = float(position[b, a, 0]), float(position[b, a, 1]), radius[b, a]
            blocked_gap, blocked_x, blocked_y, blocked_away_x, blocked_away_y = NO_WALL, x, y, 0.0, 0.0
            gap, away_x, away_y = np.nan, 0.0, 0.0  # looked up where a wall can matter
            allowed = body - skin
            # no wall is nearer than this, from any point of this quarter of a cell
            room = NO_WALL
            if has_walls and moved[b, a]:
                _, _, index = quarter(x, y, frame, place)
                room = least[index] - 3 * frame[6]
                if least[index] < allowed:
                    gap, away_x, away_y = wall_gap(x, y, frame, place, choice, option, limit)
                    allowed = min(gap, allowed)
            k = 0  # of the next point of the path
            for s in range(ticks):
                touches = False
                if not present[b, a]:
                    for _ in range(steps):
                        path[a, k, 0], path[a, k, 1] = x, y
                        k += 1
                elif not moved[b, a]:
                    for m in range(steps):
                        if has_script:
                            x, y = float(played[b, a, s, m, 0]), float(played[b, a, s, m, 1])
                        path[a, k, 0], path[a, k, 1] = x, y
                        k += 1
                        if has_walls and not touches:
                            _, _, index = quarter(x, y, frame, place)
                            if least[index] < body:
                                touches = wall_gap(x, y, frame, place, choice, option, limit)[0] < body
                else:
                    if has_slopes:
                        m00, m01, m10, m11, n00, n01, n10, n11 = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
                    full_x, full_y = velocity[0, s, b, a] * seconds, velocity[1, s, b, a] * seconds
                    length = math.sqrt(full_x * full_x + full_y * full_y)
                    near = body + length + 1e-3
                    for _ in range(strides):
                        old_x, old_y = x, y
                        free = room > near
                        if not free:
                            _, _, index = quarter(old_x, old_y, frame, place)
                            room = least[index] - 3 * frame[6]
                            free = least[index] > near
                        room -= length
                        if free:
                            x, y = old_x + full_x, old_y + full_y
                            if has_slopes:
                                n00, n11 = n00 + seconds, n11 + seconds
                            gap, blocked_gap, allowed = np.nan, NO_WALL, body - skin
                        else:
                            if math.isnan(gap):
                                gap, away_x, away_y = wall_gap(
                                    old_x, old_y, frame, place, choice, option, limit
                                )
                            share = min(max(allowed, creep) / max(length, 1e-6), 1.0)
                            move_x, move_y = full_x * share, full_y * share
                            lacking = max(allowed - gap - move_x * away_x - move_y * away_y, 0.0)
                            to_x, to_y = old_x + move_x + lacking * away_x, old_y + move_y + lacking * away_y
                            # what is left of moves: all but what the walls take
                            p00, p01, p11 = 1.0, 0.0, 1.0
                            if lacking > 0:
                                p00, p01, p11 = 1 - away_x**2, -away_x * away_y, 1 - away_y**2
                            p10 = p01
                            if blocked_gap < NO_WALL:
                                bx, by = blocked_away_x, blocked_away_y
                                ahead = blocked_gap + (to_x - blocked_x) * bx + (to_y - blocked_y) * by
                                lacking = max(allowed - ahead, 0.0)
                                to_x, to_y = to_x + lacking * bx, to_y + lacking * by
                                if lacking > 0:
                                    q0, q1 = bx * p00 + by * p10, bx * p01 + by * p11
                                    p00, p01, p10, p11 = (
                                        p00 - bx * q0,
                                        p01 - bx * q1,
                                        p10 - by * q0,
                                        p11 - by * q1,
                                    )
                            new_gap, new_x, new_y = wall_gap(to_x, to_y, frame, place, choice, option, limit)
                            if new_gap < allowed - rounding:
                                blocked_gap, blocked_x, blocked_y = new_gap, to_x, to_y
                                blocked_away_x, blocked_away_y = new_x, new_y
                            else:
                                blocked_gap, x, y = NO_WALL, to_x, to_y
                                gap, away_x, away_y = new_gap, new_x, new_y
                                allowed = max(min(new_gap, body - skin), allowed)
                                if has_slopes:
                                    m00, m10 = p00 * m00 + p01 * m10, p10 * m00 + p11 * m10
                                    m01, m11 = p00 * m01 + p01 * m11, p10 * m01 + p11 * m11
                                    n00, n11 = n00 + share * seconds, n11 + share * seconds
                                    n00, n10 = p00 * n00 + p01 * n10, p10 * n00 + p11 * n10
                                    n01, n11 = p00 * n01 + p01 * n11, p10 * n01 + p11 * n11
                            touches = touches or gap < body
                        mid_x, mid_y = 0.5 * (old_x + x), 0.5 * (old_y + y)
                        path[a, k, 0], path[a, k, 1] = mid_x, mid_y
                        path[a, k + 1, 0], path[a, k + 1, 1] = x, y
                        k += 2
                        if not free and not touches:
                            _, _, index = quarter(mid_x, mid_y, frame, place)
                            if least[index] < body:
                                there = wall_gap(mid_x, mid_y, frame, place, choice, option, limit)
                                touches = there[0] < body
                    if has_slopes:
                        for i, value in enumerate((m00, m01, m10, m11, n00, n01, n10, n11)):
                            slopes[b, a, s, i] = value
                trace[b, a, s, 0], trace[b, a, s, 1] = x, y
                wall_contact[b, a, s], agent_contact[b, a, s], reached[b, a, s] = touches, False, False
            if paths.size > 0:
                paths[b, a] = path[a].reshape((ticks, steps, 2))
            extent[a] = _extent(path, a)
            if wanted[b, a]:
                _reaches(path, extent[a], goal[b, a, 0], goal[b, a, 1], goal_radius, steps, reached, b, a)
        _touch(path, extent, present, radius, steps, agent_contact, b)


@compiled(
    "void(f4[:,:,:,:], b1[:,:], f4[:,:], f4[:,:,:], b1[:,:], f8, i8,"
    " f4[:,:], i4[:,:], i4[:], f4[:,:], f4[:], f8, b1[:,:,:], b1[:,:,:], b1[:,:,:])"
)
def events(
    paths, present, radius, goal, wanted, goal_radius, steps,
    frames, places, choice, option, least, limit, agent_contact, wall_contact, reached,
):  # fmt: skip
    """Write contacts and goals reached (B, A, S) on paths (2, S * M, B, A); all else is as in `advance`."""
    points, scenes, agents = paths.shape[1:]
    path, extent = np.empty((agents, points, 2)), np.empty(agents)
    frame, place = np.empty(7), np.empty(3, np.int64)
    for b in range(scenes):
        if len(frames):
            frame[:], place[:] = frames[b], places[b]
        for a in range(agents):
            for k in range(points):
                path[a, k, 0], path[a, k, 1] = paths[0, k, b, a], paths[1, k, b, a]
            for s in range(points // steps):
                agent_contact[b, a, s], wall_contact[b, a, s], reached[b, a, s] = False, False, False
            for k in range(points if len(frames) and present[b, a] else 0):
                x, y, body = path[a, k, 0], path[a, k, 1], radius[b, a]
                _, _, index = quarter(x, y, frame, place)
                if least[index] < body:
                    touches = wall_gap(x, y, frame, place, choice, option, limit)[0] < body
                    wall_contact[b, a, k // steps] |= touches
            extent[a] = _extent(path, a)
            if wanted[b, a]:
                _reaches(path, extent[a], goal[b, a, 0], goal[b, a, 1], goal_radius, steps, reached, b, a)
        _touch(path, extent, present, radius, steps, agent_contact, b)


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
