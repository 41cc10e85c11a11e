"""Motion in the open, for imitation: no walls, and no contacts."""

from __future__ import annotations

import torch

from pedzoo.maps.bank import MapBank
from pedzoo.sim.arrival import arrived
from pedzoo.sim.motion import Motion, MotionInput
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.state import State


class OpenFloor(Torch):
    """Moves agents straight, or as they were recorded; differentiable."""

    def __init__(self) -> None:
        """Take no floor plan."""
        super().__init__(MapBank())

    def _advance(self, state: State, inputs: MotionInput) -> Motion:
        path, _ = self._integrated(state, inputs)
        trace = path[:, inputs.substeps - 1 :: inputs.substeps].permute(2, 3, 1, 0)
        nothing = torch.zeros_like(trace[..., 0], dtype=torch.bool)
        return Motion(trace, nothing, nothing, arrived(path, state.goal_point, inputs))
