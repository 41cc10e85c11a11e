"""What robots observe and do, as Gymnasium's spaces and NumPy arrays."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core.bodies import RobotBody

ROBOT = ("goal", "radius", "velocity", "heading", "turn_rate", "waypoint", "remaining_path")
"""Readings of which the vector ``robot`` is made, in this order; those that no sensor gives are left out."""

NAMES = {"people_mask": "mask", "patch": "map"}
"""What Gymnasium's users call readings; all others keep their names."""

Observation = dict[str, NDArray[Any]]


class Observations:
    """Turns the readings of sensors into the Dict observation, and says what space it is in.

    Attributes:
        space: Of one robot.
        columns: Where each reading is in ``robot``.
    """

    def __init__(self, spec: Composite) -> None:
        """Take what ``robots/observation`` is like, (B, R, ...)."""
        readings = {str(name): cast("TensorSpec", spec[name]) for name in spec.keys()}
        self.columns: dict[str, slice] = {}
        self._others = {name: NAMES.get(name, name) for name in readings if name not in ROBOT}
        entries, bounds, width = {}, [], 0
        for name in ROBOT:
            if name in readings:
                bounds.append(_bounds(readings[name]))
                size = bounds[-1][0].size
                self.columns[name] = slice(width, width + size)
                width += size
        if bounds:
            low, high = (np.concatenate(side) for side in zip(*bounds, strict=True))
            entries["robot"] = spaces.Box(low, high, dtype=np.float32)
        for name, called in self._others.items():
            entries[called] = _space(readings[name])
        self.space = spaces.Dict(entries)

    def __call__(self, seen: TensorDictBase) -> Observation:
        """Return the observations (B, R, ...) of a batch; the arrays are the caller's own."""
        result: Observation = {}
        if self.columns:
            parts = [cast("Tensor", seen[name]).flatten(2) for name in self.columns]
            result["robot"] = torch.cat(parts, -1).cpu().numpy()
        for name, called in self._others.items():
            value = cast("Tensor", seen[name]).cpu().numpy()
            result[called] = value.astype(self.space[called].dtype, copy=True)
        return result


def action_space(body: RobotBody) -> spaces.Box:
    """Return the actions of a robot: see `RobotBody.drive`; the bounds are its limits."""
    low, high = np.array(body.limits, dtype=np.float32).T
    return spaces.Box(low, high, dtype=np.float32)


def _bounds(spec: TensorSpec) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    space = cast("Any", spec).space
    return space.low[0, 0].cpu().numpy().reshape(-1), space.high[0, 0].cpu().numpy().reshape(-1)


def _space(spec: TensorSpec) -> spaces.Space[Any]:
    shape = tuple(spec.shape[2:])
    if spec.dtype == torch.bool:
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else list(shape))
    low, high = (side.reshape(shape) for side in _bounds(spec))
    return spaces.Box(low, high, dtype=low.dtype.type)
