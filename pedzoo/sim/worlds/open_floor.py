"""Motion in the open: no walls, and contacts that are not asked for. What imitation walks in."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.dynamics import integrate
from pedzoo.sim.motion import Motion
from pedzoo.sim.state import State
from pedzoo.types import GOAL_RADIUS


class OpenFloor:
    """Moves agents straight, or as they were recorded; differentiable."""

    def advance(
        self,
        state: State,
        velocity: Tensor,
        moving: Tensor,
        substeps: int,
        played: Tensor | None = None,
        command: Tensor | None = None,
    ) -> Motion:
        """Return where agents are every 0.1 s; see `pedzoo.sim.worlds.base.Physics.advance`."""
        path, _ = integrate(state.position.movedim(-1, 0), velocity * moving, state.radius, substeps, None)
        if played is not None:
            given = played.flatten(2, 3).permute(3, 2, 0, 1).to(path.dtype)
            path = torch.where(state.mask & ~moving, given, path)
        apart = path.detach() - state.goal_point.detach().movedim(-1, 0).unsqueeze(1)
        near = apart.square().sum(0) < GOAL_RADIUS**2
        wanted = moving & (state.goal_id >= 0)
        reached = (near & wanted).unflatten(0, (-1, substeps)).any(1).cumsum(0) > 0
        trace = path[:, substeps - 1 :: substeps].permute(2, 3, 1, 0)
        nothing = torch.zeros_like(trace[..., 0], dtype=torch.bool)
        return Motion(trace, nothing, nothing, reached.permute(1, 2, 0))
