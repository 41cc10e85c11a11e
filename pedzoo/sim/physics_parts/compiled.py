"""The compiled backend's way in and out: tensors on the CPU become arrays without a copy."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.types import GOAL_RADIUS, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.sim.dynamics import CREEP, ROUNDING, SKIN, STRIDE
from pedzoo.sim.state import State
from pedzoo.sim.step_result import Contacts, Motion, MotionInput

_NO_PATHS = np.zeros((0, 0, 0, 0, 2), np.float32)
_NO_SLOPES = np.zeros((0, 0, 0, 8), np.float32)
_NO_FRAMES = np.zeros((0, 7), np.float32), np.zeros((0, 3), np.int32)


def advance_compiled(bank: MapBank, state: State, inputs: MotionInput, paths: Tensor | None = None) -> Motion:
    """`Physics.advance`, compiled; ``paths`` (B, A, S, M, 2) are written if given.

    The trace is differentiable with respect to positions, velocities and played paths.
    """
    velocity, moving, substeps, played, wanted = inputs[:5]
    position = state.past[:, :, -1]
    slopes = None
    if torch.is_grad_enabled() and any(
        part is not None and part.requires_grad for part in (position, velocity, played)
    ):
        slopes = torch.zeros(*moving.shape, velocity.shape[1], 8)
    motion = _run(
        bank, position, velocity, state.radius, state.mask, moving,
        torch.empty(0, 0, 0, 0, 2) if played is None else played.float(), state.goal_point, wanted,
        substeps, (state.wall_frame, state.wall_place), paths, slopes,
    )  # fmt: skip
    if slopes is None:
        return motion
    trace = _Trace.apply(position, velocity, motion.trace, slopes, moving)
    if played is not None:
        scripted = (state.mask & ~moving)[..., None, None]
        trace = torch.where(scripted, played[:, :, :, -1], trace)
    return motion._replace(trace=trace)


class _Trace(torch.autograd.Function):
    """Hands a trace (B, A, S, 2) on, with the gradients that its slopes say."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        """Keep the slopes; ``given`` are positions, velocities, the trace, its slopes and moved agents."""
        _, _, trace, slopes, moving = given
        ctx.save_for_backward(slopes, moving)
        return trace.clone()

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor | None, ...]:
        """Return gradients of places (B, A, 2) and velocities (2, S, B, A), last trace point first."""
        slopes, moving = ctx.saved_tensors
        of_place, of_velocity = slopes.unflatten(3, (2, 2, 2)).unbind(3)
        moved = moving[..., None]
        carried = torch.zeros_like(gradients[0][:, :, 0])
        velocity = []
        for tick in reversed(range(slopes.shape[2])):
            carried = (carried + gradients[0][:, :, tick]).unsqueeze(-1)
            velocity.append(torch.where(moved, (of_velocity[:, :, tick] * carried).sum(2), 0.0))
            carried = torch.where(moved, (of_place[:, :, tick] * carried).sum(2), carried[..., 0])
        return carried, torch.stack(velocity[::-1]).permute(3, 0, 1, 2), None, None, None


def contacts_compiled(
    bank: MapBank, path: Tensor, present: Tensor, radius: Tensor, frame: Tensor, place: Tensor
) -> Contacts:
    """`Physics.contacts`, compiled, for agents who are present (B, A) bool."""
    scenes, agents, ticks, substeps = path.shape[:4]
    nothing = torch.zeros(scenes, agents, dtype=torch.bool)
    start = path[:, :, 0, 0]
    velocity = path.new_zeros(2, ticks, scenes, agents)
    motion = _run(
        bank, start, velocity, radius, present, nothing, path, start, nothing, substeps, (frame, place)
    )  # fmt: skip
    return Contacts(motion.agent_contact, motion.wall_contact)


def events_compiled(
    bank: MapBank, path: Tensor, state: State, inputs: MotionInput
) -> tuple[Tensor, Tensor, Tensor]:
    """Return contacts with agents and with walls, and goals reached (B, A, S) bool.

    Args:
        bank: The floor plans.
        path: Sub-steps (2, S * M, B, A), metres.
        state: At the beginning.
        inputs: Says which agents may reach their goals.
    """
    from pedzoo.sim.physics_parts.compiled_loops import events

    scenes, agents = state.mask.shape
    result = torch.empty(3, scenes, agents, path.shape[1] // inputs.substeps, dtype=torch.bool)
    given = path, state.mask, state.radius, state.goal_point, inputs.wanted
    paths, *arrays = (value.detach().numpy() for value in given)
    walls = _walls(bank, (state.wall_frame, state.wall_place))
    events(paths, *arrays, GOAL_RADIUS, inputs.substeps, *walls, *result.numpy())
    agent, wall, reached = result.unbind()
    return agent, wall, reached


def body_rays_compiled(
    position: Tensor, radius: Tensor, present: Tensor, origin: Tensor, direction: Tensor, reach: float
) -> Tensor:
    """Return how far rays (B, R) go before they meet one of the bodies (B, A) that are present, metres."""
    from pedzoo.sim.physics_parts.compiled_loops import body_rays

    length = torch.full(origin.shape[:2], reach)
    given = position, radius.to(position.dtype), present, origin, direction, length
    body_rays(*(part.detach().numpy() for part in given))
    return length


def _run(
    bank: MapBank, position: Tensor, velocity: Tensor, radius: Tensor, present: Tensor, moving: Tensor,
    played: Tensor, goal: Tensor, wanted: Tensor, substeps: int, walls: tuple[Tensor, Tensor],
    paths: Tensor | None = None, slopes: Tensor | None = None,
) -> Motion:  # fmt: skip
    from pedzoo.sim.physics_parts.compiled_loops import advance

    shape = *moving.shape, velocity.shape[1]
    trace = torch.empty(*shape, 2)
    agent, wall, reached = torch.empty(3, *shape, dtype=torch.bool)
    arrays: list[Any] = [
        value.detach().numpy()
        for value in (position, velocity, radius, present, moving, played, goal, wanted)
    ]
    advance(
        *arrays, *integration(bank, walls, substeps),
        trace.numpy(), agent.numpy(), wall.numpy(), reached.numpy(),
        _NO_PATHS if paths is None else paths.numpy(),
        _NO_SLOPES if slopes is None else slopes.numpy(),
    )  # fmt: skip
    return Motion(trace, agent, wall, reached)


def integration(bank: MapBank, walls: tuple[Tensor, Tensor], substeps: int) -> tuple[Any, ...]:
    """Return arguments of the loops that integrate paths: numbers, the walls in scenes, and their tables.

    Args:
        bank: The floor plans.
        walls: Frames (B, 7) and places (B, 3) of `LocalWalls`, in rows.
        substeps: M, sub-steps of every 0.1 s.
    """
    numbers = substeps, max(1, substeps // STRIDE), SKIN, ROUNDING, CREEP, TRACE_SECONDS
    return GOAL_RADIUS, *numbers, *_walls(bank, walls)


def _walls(bank: MapBank, walls: tuple[Tensor, Tensor]) -> tuple[Any, ...]:
    """Return what loops know of walls: how they lie in scenes, and tables."""
    frames, places = (part.numpy() for part in walls) if bank.grids else _NO_FRAMES
    return frames, places, *bank.walls.arrays
