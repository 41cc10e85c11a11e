"""How bodies move: velocities of every 0.1 s from what is commanded, and paths along walls.

Pure, differentiable, on any device, and without a look back at the host. Agents come last, (2, ..., B, A):
on a CPU several times faster than pairs. `pedzoo.sim.physics.compiled` has the same in loops: change both.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.core.bodies import HOLONOMIC, speed_and_turn
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.maps.constants import NO_WALL
from pedzoo.maps.walls import LocalWalls
from pedzoo.sim.state import State

SKIN = 0.01
"""Metres by which a body gives at a wall: an agent that presses against one touches it in every backend."""

ROUNDING = 1e-4
"""Metres by which an agent may be nearer to a wall than allowed before it goes back."""

CREEP = 0.02
"""Step length (m) while pushing out of a wall."""

STRIDE = 2
"""Sub-steps of a stride: walls are looked up where a stride ends, contacts are checked after each half."""


def substeps(fastest: float, body_radius: float = BODY_RADIUS) -> int:
    """Return how many sub-steps a trace step of 0.1 s needs for a top speed: whole strides.

    An agent may move half a body radius in one, less `SKIN`: then none passes through anything unseen.
    """
    return STRIDE * max(1, math.ceil(fastest * TRACE_SECONDS / (body_radius - SKIN) - 1e-9))


def driven(state: State, command: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return velocities (2, S, B, A), headings and turning rates (B, A) within limits and by wheels.

    A holonomic agent changes its velocity by its acceleration at most. A unicycle is commanded its speed and
    turning rate, (v, omega) in m/s and rad/s. A differential drive is commanded the speeds of its wheels,
    (left, right) in m/s. Both are limited in acceleration and drive along their heading.

    Args:
        state: Bodies, headings, velocities.
        command: As the agent's drive has it (2, B, A).
        velocity: Wanted velocities of holonomic agents in each trace step (2, S, B, A), m/s.
    """
    wheels = state.drive != HOLONOMIC
    wanted_speed, wanted_turn = speed_and_turn(command, state.drive, state.track)
    wanted_speed = wanted_speed.clamp(-state.top_speed, state.top_speed)
    heading, turn = state.heading, state.turn_rate
    moving = state.velocity.movedim(-1, 0)
    speed = moving[0] * heading.cos() + moving[1] * heading.sin()
    most, most_turn = state.acceleration * TRACE_SECONDS, state.turn_acceleration * TRACE_SECONDS
    result = []
    for tick in range(velocity.shape[1]):
        change = velocity[:, tick] - moving
        share = (most / (change.square().sum(0) + 1e-12).sqrt()).clamp_max(1.0)
        free = torch.lerp(moving, velocity[:, tick], share)  # all of it is exactly what is wanted
        speed = speed + (wanted_speed - speed).clamp(-most, most)
        turn = turn + (wanted_turn - turn).clamp(-most_turn, most_turn)
        middle = heading + 0.5 * TRACE_SECONDS * turn
        rolling = speed * torch.stack((middle.cos(), middle.sin()))
        heading = torch.where(wheels, heading + TRACE_SECONDS * turn, heading)
        moving = torch.where(wheels, rolling, free)
        result.append(moving)
    return torch.stack(result, dim=1), heading, torch.where(wheels, turn, 0.0)


def integrate(
    position: Tensor, velocity: Tensor, radius: Tensor, steps: int, walls: LocalWalls | None
) -> Tensor:
    """Return paths (2, S * M, B, A), metres, of S trace steps of M sub-steps.

    Walls stop agents, and they slide along. An agent that starts inside a wall, or nearer than its body, may
    only move out. In every stride the move is projected on what the nearest wall leaves, and on what the wall
    leaves that the last stride ran into. Where its end is nearer to a wall than allowed all the same, the
    agent stays for this stride. Agents are not pushed apart.

    Args:
        position: Where agents are (2, B, A), metres.
        velocity: In each trace step (2, S, B, A), m/s, limits respected already.
        radius: Of bodies (B, A), metres.
        steps: M, a multiple of `STRIDE`.
        walls: As agents see them, None for none.
    """
    if walls is None:
        time = torch.arange(1, steps + 1, device=position.device, dtype=position.dtype)
        moved = (velocity * TRACE_SECONDS).cumsum(1)
        begin = position.unsqueeze(1) + moved - velocity * TRACE_SECONDS
        time = time.view(1, 1, -1, 1, 1) * (TRACE_SECONDS / steps)
        return (begin.unsqueeze(2) + velocity.unsqueeze(2) * time).flatten(1, 2)
    reach, strides = radius - SKIN, steps // STRIDE
    wanted = velocity * (TRACE_SECONDS / strides)
    length = (wanted.square().sum(0) + 1e-12).sqrt()
    here, places = position, [position]
    # no stride is longer than the reach
    ahead = WallsAhead(walls, here, reach, radius + reach)
    for tick_wanted, tick_length in zip(wanted.unbind(1), length.unbind(), strict=True):
        for _ in range(strides):
            target = ahead.target(here, tick_wanted, tick_length)
            here = torch.lerp(here, target, ahead.arrive(target))
            places.append(here)
    ends = torch.stack(places, dim=1)
    middle = 0.5 * (ends[:, :-1] + ends[:, 1:])
    return torch.stack((middle, ends[:, 1:]), dim=2).flatten(1, 2)


class WallsAhead:
    """The walls around agents (B, A) that go in strides from one place to the next.

    No gradient flows through the walls themselves.
    """

    def __init__(self, walls: LocalWalls, place: Tensor, reach: Tensor, within: Tensor) -> None:
        """Look at the places where agents begin (2, B, A), metres.

        An agent that begins nearer to a wall than its ``reach`` (B, A), metres, may only move out. Walls
        matter in a stride up to ``within`` (B, A), metres.
        """
        self._walls, self._reach, self._within = walls, reach, within
        # half-planes of the nearest wall and of that which the last stride ran into: see `half_planes`
        self._nearest = walls.half_planes(place, within)
        self._allowed = self._nearest[0].minimum(reach)
        self._nearest[1].add_(self._allowed)
        self._no_wall = self._nearest.new_zeros(4, 1, 1)
        self._no_wall[1] = -NO_WALL
        self._blocking = self._no_wall.expand_as(self._nearest)

    def target(self, place: Tensor, step: Tensor, length: Tensor) -> Tensor:
        """Return where agents at a place get by steps (2, B, A) of some lengths (B, A), metres.

        Near a wall a step is shortened, because a straight line must not cut a corner. Then it is projected
        on what the nearest wall leaves, and on what the wall leaves that the last stride ran into.
        """
        place = torch.addcmul(place, step, (self._allowed.clamp_min(CREEP) / length).clamp_max(1))
        for wall in (self._nearest, self._blocking):
            bound, normal = wall[1], wall[2:]
            place = torch.addcmul(place, (bound - (place * normal).sum(0)).relu(), normal)
        return place

    def arrive(self, place: Tensor) -> Tensor:
        """Look around where a stride ends (2, B, A).

        Returns:
            1 for agents that may be there, 0 for those that are too near to a wall and go back (B, A).
        """
        wall = self._walls.half_planes(place, self._within)
        gap = wall[0]
        stuck = gap < self._allowed - ROUNDING
        self._allowed = gap.clamp(self._allowed, self._reach)
        wall[1].add_(self._allowed)
        self._blocking = torch.where(stuck, wall, self._no_wall)
        self._nearest = torch.where(stuck, self._nearest, wall)
        return (~stuck).to(place.dtype)
