"""The way into the safety layer's compiled loops and out: tensors on the CPU become arrays without a copy."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.machine import compiles
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.walls.local_walls import LocalWalls
from pedzoo.policies.safety_layer.clearance import (
    MARGIN,
    NARROW,
    ROUNDING,
    ROUNDS,
    SHARES,
    ProposedSteps,
)
from pedzoo.policies.safety_layer.precedence import AHEAD, LEAD_SECONDS, LEAST_ASKED, LEAST_SHARE, SPREAD, TIE

_NONE: Any = np.zeros((0, 7), np.float32), np.zeros((0, 3), np.int32), np.zeros(1, np.int32)
_NO_WALLS = *_NONE, np.zeros((1, 1), np.float32), np.zeros(1, np.float32), 0.0
_NO_RECORD = np.zeros((0, 0, 0, 7))


def loops_take(steps: ProposedSteps) -> bool:
    """Return whether the compiled loops may take these: top speeds and radii have gradients in torch only."""
    numbers = [part for part in steps if part is not None and part.is_floating_point()]
    constants = torch.is_grad_enabled() and (steps.longest.requires_grad or steps.radius.requires_grad)
    return not constants and compiles(*numbers)


def kept_clear_compiled(steps: ProposedSteps, walls: LocalWalls | None, shoulders: float) -> Tensor:
    """`pedzoo.policies.safety_layer.layer.kept_clear`, compiled, with its gradients."""
    return _KeptClear.apply(steps.position, steps.step, steps.velocity, steps, walls, shoulders)


class _KeptClear(torch.autograd.Function):
    """Records the corrections of steps if gradients are asked for, and goes back over them."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        """Return the steps (B, A, 2); given are positions, steps and velocities, all steps and the walls."""
        from pedzoo.policies.safety_layer.clearance_loops import keep_clear

        steps, walls, shoulders = given[3:]
        people, stored = _people(steps), torch.empty_like(steps.step, memory_format=torch.contiguous_format)
        size = steps.moved.shape
        result = (
            np.empty(size, np.bool_), np.empty((*size, 2), np.float32), np.empty(size, np.float32),
            np.empty(size[0], np.int64),
        )  # fmt: skip
        records = any(ctx.needs_input_grad)
        record = np.empty((size[0], ROUNDS, size[1], 7)) if records else _NO_RECORD
        stands = np.empty(size, np.bool_)
        keep_clear(
            *people, _order(steps), SHARES, ROUNDS, MARGIN, shoulders, NARROW, steps.first, steps.beyond,
            ROUNDING, *_wall_arrays(walls), stored.numpy(), *result, record, stands,
        )  # fmt: skip
        if records:
            ctx.order, ctx.shoulders = _order(steps), shoulders
            ctx.people, ctx.paths, ctx.result = people, (steps.first, steps.beyond), (*result, record, stands)
        return stored

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor | None, ...]:
        """Return gradients (B, A, 2) of positions, steps and velocities."""
        from pedzoo.policies.safety_layer.clearance_slopes import keep_clear_slope

        values = [torch.empty_like(gradients[0], memory_format=torch.contiguous_format) for _ in range(3)]
        keep_clear_slope(
            *ctx.people, ctx.order, MARGIN, ctx.shoulders, *ctx.paths, ROUNDING, *ctx.result,
            gradients[0].detach().numpy(), *(part.numpy() for part in values),
        )  # fmt: skip
        place, step, velocity = values
        return place, step, TRACE_SECONDS * velocity if ctx.needs_input_grad[2] else None, None, None, None


def _people(steps: ProposedSteps) -> list[Any]:
    """Return the arrays of `ProposedSteps`, velocities as metres in 0.1 s, and whether velocities blend."""
    blends = steps.velocity is not None
    before = steps.step if steps.velocity is None else steps.velocity * TRACE_SECONDS
    rank = torch.zeros_like(steps.longest) if steps.rank is None else steps.rank
    people: Any = steps.position, steps.step, before, *steps[2:8], rank
    return [*(part.detach().numpy() for part in people), blends]


def _order(steps: ProposedSteps) -> tuple[float, ...]:
    """Return the constants of `precedence`."""
    seconds = 0.0 if steps.velocity is None else LEAD_SECONDS / TRACE_SECONDS
    return AHEAD, TIE, LEAST_SHARE, LEAST_ASKED, seconds, SPREAD


def _wall_arrays(walls: LocalWalls | None) -> tuple[Any, ...]:
    """Return frames (B, 7) and places (B, 3) of scenes, no rows for no walls, and the tables behind them."""
    if walls is None:
        return _NO_WALLS
    return walls.frame.t().float().numpy(), walls.place.t().numpy(), *walls.walls.arrays
