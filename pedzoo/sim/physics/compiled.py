"""Compiled loops on the CPU, torch on other devices and where gradients are asked for: the default.

The loops take one agent after the other, in records of arrays: named tuples with the fields of `State`. They
do what `pedzoo.sim.kernel.step` and `pedzoo.sim.dynamics.integrate` do, in their order and in single
precision; tests compare both, field by field.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.compiled import jit
from pedzoo.core.geometry import TURNS_FROM
from pedzoo.core.machine import compiles
from pedzoo.core.types import GOAL_RADIUS, TRACE_SECONDS
from pedzoo.maps.constants import NO_WALL
from pedzoo.maps.walls_numba import WallArrays, quarter, wall_gap
from pedzoo.sim.dynamics import CREEP, ROUNDING, SKIN, STRIDE
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.scenario import Rules
from pedzoo.sim.state import CLOCK_ROUNDING, PAST_LEN, Decision, Motion, MotionInput, State

_0, _1, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_TINY, _MOST = np.float32(1e-12), np.float32(1e6)
_SECOND, _LATE, _TURNS = np.float32(TRACE_SECONDS), np.float32(CLOCK_ROUNDING), np.float32(TURNS_FROM)
_NO_WALLS, _NOT_PLAYED = (torch.zeros(0, 7), torch.zeros(0, 3).int()), torch.zeros(0, 0, 0, 0, 2)


_Moves = namedtuple("_Moves", "past mask radius goal_point velocity moving wanted played")
"""What moves agents: fields of `State`, and as in `MotionInput`. Velocities are (2, S, B, A)."""

_Before = namedtuple(
    "_Before",
    "commands past mask radius goal_point velocity failed controlled goal_id later_goals person goal_index "
    "reached heading top_speed clock deadline stands overdue",
)
"""Commands (B, A, 2), and fields of `State` before a decision."""

_After = namedtuple(
    "_After",
    "past velocity heading clock failed mask controlled overdue person goal_id goal_index reached "
    "moving sets_out",
)
"""Fields of `State` after a decision; which agents moved, and which set out (B, A)."""


class Compiled(Torch):
    """Answers as `Torch`, several times faster on a CPU. With gradients it is `Torch`."""

    _whole = True

    def __init_subclass__(cls, **settings: Any) -> None:
        """Find contacts in loops only where a subclass has none of its own."""
        super().__init_subclass__(**settings)
        names = ("contacts", "owned", "advance", "_advance", "_touched")
        cls._whole = all(getattr(cls, name) is getattr(Compiled, name) for name in names)

    def _advance(self, state: State, inputs: MotionInput) -> Motion:
        if not _compiles(state.past, inputs.velocity, inputs.played):
            return super()._advance(state, inputs)
        fields = state._asdict() | inputs._asdict()
        if inputs.played is None:
            fields["played"] = _NOT_PLAYED
        moves = _Moves(*_arrays(*(fields[name] for name in _Moves._fields)))
        shape = *state.mask.shape, inputs.velocity.shape[1]
        trace, events = torch.empty(*shape, 2), torch.empty(3, *shape, dtype=torch.bool)
        paths = _NOT_PLAYED if self._whole else torch.empty(*shape, inputs.substeps, 2)
        arrays = trace.numpy(), events.numpy(), paths.numpy()
        _advance_loop(moves, self._loop_walls(state), inputs.substeps, *arrays)
        agent, wall, reached = events.unbind()
        touched = (agent, wall) if self._whole else self._touched(state, paths, inputs)
        return Motion(trace, *touched, reached)

    def decide(self, state: State, commands: Tensor, rules: Rules) -> Decision | None:
        """See `Physics.decide`: of holonomic agents that do not wait at places, without a script."""
        special = rules.wheels or rules.waits is not None or rules.script is not None
        if special or not self._whole or not _compiles(commands, state.past, state.velocity):
            return None
        shape, ticks, fields = state.mask.shape, rules.ticks, state._asdict() | {"commands": commands}
        before = _Before(*_arrays(*(fields[name] for name in _Before._fields)))
        # without gaps, whatever strides the state has: loops write into arrays, not into copies
        moved = {name: fields[name].new_empty(fields[name].shape) for name in _After._fields[:-2]}
        moving, sets_out = torch.empty(2, *shape, dtype=torch.bool)
        events = torch.empty(3, *shape, ticks, dtype=torch.bool)
        after = _After(*_arrays(*moved.values(), moving, sets_out))
        numbers = rules.substeps, rules.goals, rules.leave, rules.keep_goal
        _decide_loop(before, after, self._loop_walls(state), *numbers, events.numpy())
        motion = Motion(moved["past"][:, :, -ticks:], *events.unbind())
        return Decision(state._replace(**moved), motion, moving, motion.reached, sets_out)

    def _loop_walls(self, state: State) -> WallArrays:
        lies = (state.wall_frame, state.wall_place) if self.bank.grids else _NO_WALLS
        return WallArrays(*_arrays(*lies), *self.bank.walls.arrays)


def _compiles(*given: Tensor | None) -> bool:
    """Return whether loops can take tensors: on the CPU, without gradients."""
    there = [value for value in given if value is not None]
    asked = torch.is_grad_enabled() and any(value.requires_grad for value in there)
    return not asked and compiles(*there)


def _arrays(*tensors: Tensor) -> list[Any]:
    """Return tensors as arrays without gaps, for which the loops are compiled."""
    return [value.detach().contiguous().numpy() for value in tensors]


@jit
def _gap(x, y, frame, place, walls):
    """Return the distance to the nearest wall, metres, and the direction in which it grows."""
    return wall_gap(x, y, frame, place, walls.choice, walls.option, walls.limit)


@jit
def _room(x, y, frame, place, walls):
    """Return a distance than which no wall is nearer, metres."""
    return walls.least[quarter(x, y, frame, place)[2]]


@jit
def _walk(b, a, moves, walls, frame, place, path, nears):
    """Write the path (A, S * M, 2) of an agent, and in which trace steps (S,) walls are near."""
    ticks, strides = moves.velocity.shape[1], path.shape[1] // (moves.velocity.shape[1] * STRIDE)
    x, y, body = float(moves.past[b, a, -1, 0]), float(moves.past[b, a, -1, 1]), moves.radius[b, a]
    has_walls, seconds = len(walls.frames) > 0, TRACE_SECONDS / strides
    blocked, blocked_x, blocked_y, block_x, block_y = NO_WALL, x, y, 0.0, 0.0
    gap, away_x, away_y = np.nan, 0.0, 0.0  # looked up where a wall can matter
    # no wall is nearer than the room, from any point of this quarter of a cell
    allowed, room = body - SKIN, NO_WALL
    if has_walls:
        room = _room(x, y, frame, place, walls)
        if room < allowed:
            gap, away_x, away_y = _gap(x, y, frame, place, walls)
            allowed = min(gap, allowed)
        room -= 3 * frame[6]
    for k in range(ticks * strides):
        tick, old_x, old_y = k // strides, x, y
        full_x, full_y = moves.velocity[0, tick, b, a] * seconds, moves.velocity[1, tick, b, a] * seconds
        length = math.sqrt(full_x * full_x + full_y * full_y)
        near = body + length + 1e-3
        free = room > near
        if not free:
            least = _room(x, y, frame, place, walls)
            room, free = least - 3 * frame[6], least > near
        room -= length
        if free:
            x, y = x + full_x, y + full_y
            gap, blocked, allowed = np.nan, NO_WALL, body - SKIN
        else:
            if math.isnan(gap):
                gap, away_x, away_y = _gap(x, y, frame, place, walls)
            share = min(max(allowed, CREEP) / max(length, 1e-6), 1.0)
            move_x, move_y = full_x * share, full_y * share
            lacking = max(allowed - gap - move_x * away_x - move_y * away_y, 0.0)
            to_x, to_y = x + move_x + lacking * away_x, y + move_y + lacking * away_y
            if blocked < NO_WALL:
                ahead = blocked + (to_x - blocked_x) * block_x + (to_y - blocked_y) * block_y
                lacking = max(allowed - ahead, 0.0)
                to_x, to_y = to_x + lacking * block_x, to_y + lacking * block_y
            new_gap, new_x, new_y = _gap(to_x, to_y, frame, place, walls)
            if new_gap < allowed - ROUNDING:
                blocked, blocked_x, blocked_y, block_x, block_y = new_gap, to_x, to_y, new_x, new_y
            else:
                blocked, x, y, gap, away_x, away_y = NO_WALL, to_x, to_y, new_gap, new_x, new_y
                allowed = max(min(new_gap, body - SKIN), allowed)
            nears[tick] = True
        path[a, 2 * k, 0], path[a, 2 * k, 1] = 0.5 * (old_x + x), 0.5 * (old_y + y)
        path[a, 2 * k + 1, 0], path[a, 2 * k + 1, 1] = x, y


@jit
def _touch(path, extent, present, radius, contact):
    """Set in which trace steps (A, S) agents of a scene on paths (A, S * M, 2) touch another one."""
    steps = path.shape[1] // contact.shape[1]
    for a in range(1, len(path)):
        if not present[a]:
            continue
        for other in range(a):
            both = radius[a] + radius[other]
            far = both + extent[a] + extent[other]
            dx, dy = path[a, 0, 0] - path[other, 0, 0], path[a, 0, 1] - path[other, 0, 1]
            if dx * dx + dy * dy > far * far or not present[other]:
                continue
            for k in range(path.shape[1]):
                dx, dy = path[a, k, 0] - path[other, k, 0], path[a, k, 1] - path[other, k, 1]
                if dx * dx + dy * dy < both * both:
                    contact[a, k // steps], contact[other, k // steps] = True, True


@jit
def _advance_loop(moves, walls, steps, trace, events, paths):
    """Write ends of traces (B, A, N, 2), events (3, B, A, S): contacts, walls, goals; paths if wanted."""
    _, scenes, agents, ticks = events.shape
    path, extent = np.empty((agents, ticks * steps, 2)), np.empty(agents)
    frame, place, last = np.empty(7), np.empty(3, np.int64), trace.shape[2] - ticks
    events[:] = False
    for b in range(scenes):
        if len(walls.frames):
            frame[:], place[:] = walls.frames[b], walls.places[b]
        for a in range(agents):
            nears, reached, body = events[1, b, a], events[2, b, a], moves.radius[b, a]
            if moves.mask[b, a] and moves.moving[b, a]:
                _walk(b, a, moves, walls, frame, place, path, nears)
            elif moves.mask[b, a] and moves.played.size > 0:
                path[a] = moves.played[b, a].reshape(ticks * steps, 2)
                nears[:] = len(walls.frames) > 0
            else:
                path[a] = moves.past[b, a, -1]
                nears[:] = moves.mask[b, a] and len(walls.frames) > 0
            trace[b, a, last:] = path[a, steps - 1 :: steps]
            if paths.size > 0:
                paths[b, a] = path[a].reshape(ticks, steps, 2)
            extent[a] = 0.0
            for k in range(ticks * steps):
                x, y, tick = path[a, k, 0], path[a, k, 1], k // steps
                extent[a] = max(extent[a], math.hypot(x - path[a, 0, 0], y - path[a, 0, 1]))
                if k % steps == 0:
                    near, nears[tick] = nears[tick], False
                if near and not nears[tick] and _room(x, y, frame, place, walls) < body:
                    nears[tick] = _gap(x, y, frame, place, walls)[0] < body
                to_x, to_y = x - moves.goal_point[b, a, 0], y - moves.goal_point[b, a, 1]
                if moves.wanted[b, a] and to_x * to_x + to_y * to_y < GOAL_RADIUS * GOAL_RADIUS:
                    reached[tick:] = True
        _touch(path, extent, moves.mask[b], moves.radius[b], events[0, b])


@jit
def _limited(x, y, top_speed):
    """Return a velocity that is shortened to a top speed: `pedzoo.core.geometry.limited`."""
    share = min(top_speed / np.sqrt(max(x * x + y * y, _TINY)), _1)
    return x * share, y * share


@jit
def _blended(old_x, old_y, x, y, top_speed, velocity):
    """Write the velocities (2, S) of one agent: `pedzoo.core.geometry.blended`, limited."""
    ticks = velocity.shape[1]
    between = max(1, ticks - 2)
    half_x, half_y = _HALF * (old_x - x), _HALF * (old_y - y)
    size = np.sqrt(half_x * half_x + half_y * half_y + _TINY)
    speed = np.sqrt(x * x + y * y + _TINY)
    share = min(np.float32(0.5 * between) * speed / size, _1)
    half_x, half_y, part = half_x * share, half_y * share, np.float32(between)
    for tick in range(ticks):
        now_x, now_y = x, y
        if tick == 0 and ticks > 1:
            now_x, now_y = x + half_x, y + half_y
        elif 0 < tick <= between:
            now_x, now_y = x - half_x / part, y - half_y / part
        velocity[0, tick], velocity[1, tick] = _limited(now_x, now_y, top_speed)


@jit
def _command(before, after, velocity, wanted):
    """Write velocities (2, S, B, A), and which agents may reach their goals (B, A)."""
    scenes, agents = wanted.shape
    for b in range(scenes):
        failed = before.failed[b]
        for a in range(agents):
            x, y = before.commands[b, a, 0], before.commands[b, a, 1]
            failed = failed or (before.controlled[b, a] and not (math.isfinite(x) and math.isfinite(y)))
        after.failed[b] = failed
        for a in range(agents):
            after.moving[b, a] = before.controlled[b, a] and not failed
            wanted[b, a] = after.moving[b, a] and before.goal_id[b, a] >= 0
            x, y, top_speed, old = _0, _0, before.top_speed[b, a], before.velocity[b, a]
            if wanted[b, a]:
                x = min(max(before.commands[b, a, 0], -_MOST), _MOST)
                y = min(max(before.commands[b, a, 1], -_MOST), _MOST)
            x, y = _limited(x, y, top_speed)
            _blended(old[0], old[1], x, y, top_speed, velocity[:, :, b, a])


@jit
def _decide_loop(before, after, walls, steps, goals, leave, keep_goal, events):
    """Write the result of a decision without the planner's part, and its events (3, B, A, S)."""
    _, scenes, agents, ticks = events.shape
    velocity = np.empty((2, ticks, scenes, agents), np.float32)
    wanted, played = np.empty((scenes, agents), np.bool_), np.empty((0, 0, 0, 0, 2), np.float32)
    moves = _Moves(
        before.past, before.mask, before.radius, before.goal_point, velocity, after.moving, wanted, played
    )
    _command(before, after, velocity, wanted)
    after.past[:, :, : PAST_LEN - ticks] = before.past[:, :, ticks:]
    _advance_loop(moves, walls, steps, after.past, events, played)
    for b in range(scenes):
        clock = before.clock[b] + np.float32(ticks * TRACE_SECONDS)
        after.clock[b] = clock
        for a in range(agents):
            hit, in_time = events[2, b, a, -1], False
            for tick in range(ticks):
                when = before.clock[b] + _SECOND * np.float32(tick + 1)
                in_time = in_time or (events[2, b, a, tick] and when <= before.deadline[b, a] + _LATE)
            late = clock > before.deadline[b, a] + _LATE and not in_time and before.reached[b, a] < goals
            after.overdue[b, a] = before.overdue[b, a] or (late and before.controlled[b, a])
            stands = before.mask[b, a] and not before.controlled[b, a] and before.stands[b, a] > 0
            sets_out = stands and clock + _LATE >= before.stands[b, a]
            count = before.reached[b, a] + hit
            stays = not leave or count < goals
            there = before.mask[b, a] and stays
            later = before.later_goals[b, a, before.goal_index[b, a] % before.later_goals.shape[2]]
            after.sets_out[b, a], after.mask[b, a] = sets_out, there
            after.controlled[b, a] = (before.controlled[b, a] or sets_out) and stays
            after.person[b, a] = before.person[b, a] if there else -1
            after.goal_id[b, a] = later if hit and (later >= 0 or not keep_goal) else before.goal_id[b, a]
            after.goal_index[b, a], after.reached[b, a] = before.goal_index[b, a] + hit, count
            x = (after.past[b, a, -1, 0] - after.past[b, a, -2, 0]) / _SECOND
            y = (after.past[b, a, -1, 1] - after.past[b, a, -2, 1]) / _SECOND
            after.velocity[b, a, 0], after.velocity[b, a, 1] = x, y
            turns = x * x + y * y > _TURNS * _TURNS
            after.heading[b, a] = math.atan2(y, x) if turns else before.heading[b, a]
