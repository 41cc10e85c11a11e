"""The readings of all sensors of robots, some of which come late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.data import Bounded, Categorical
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core.errors import UserError
from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


class Readings:
    """Reads all sensors once in every decision, and keeps what is not there yet."""

    def __init__(self, sensors: Sequence[Sensor], decision_dt: float) -> None:
        """Take the sensors of robots that decide every ``decision_dt`` seconds.

        Raises:
            UserError: Two sensors have entries of one name, or a delay is no multiple of the interval.
        """
        self.entries: dict[str, Reading] = {}
        self._sensors, self._late, self._kept = list(sensors), [], {}
        for sensor in sensors:
            name = type(sensor).__name__
            if twice := self.entries.keys() & sensor.readings.keys():
                raise UserError(f"sensor {name}: {', '.join(sorted(twice))} is an entry of two sensors")
            self.entries |= sensor.readings
            late = round(sensor.delay / decision_dt)
            if abs(late * decision_dt - sensor.delay) > 1e-6:
                raise UserError(
                    f"sensor {name}: delay {sensor.delay:g} s: expected a multiple of the {decision_dt:g} s "
                    "between two decisions"
                )
            self._late.append(late)

    def spec(self, shape: tuple[int, int]) -> dict[str, TensorSpec]:
        """Return the specs of all entries for ``shape`` scenes and robots."""
        return {name: _spec(reading, (*shape, *reading.shape)) for name, reading in self.entries.items()}

    def __call__(self, view: RobotView, begins: bool | None, begun: Tensor | None) -> dict[str, Tensor]:
        """Return all entries (B, R, ...).

        Args:
            view: The scenes now.
            begins: False after a decision; None where scenes begin.
            begun: Which scenes begin (B,) bool; None for all.
        """
        result: dict[str, Tensor] = {}
        for number, (sensor, late) in enumerate(zip(self._sensors, self._late, strict=True)):
            seen = sensor.observe(view)
            if late:
                seen = {
                    name: self._delayed((number, name), value, late, begins is None, begun)
                    for name, value in seen.items()
                }
            result |= seen
        return result

    def _delayed(self, key: Any, now: Tensor, late: int, begins: bool, begun: Tensor | None) -> Tensor:
        stored = self._kept.get(key)
        whole = now.unsqueeze(0).expand(late + 1, *now.shape)
        if stored is None or (begins and begun is None):
            stored = whole.clone()
        elif begins and begun is not None:
            stored = torch.where(begun.view(1, -1, *[1] * (now.dim() - 1)), whole, stored)
        else:
            stored = torch.cat((stored[1:], now.unsqueeze(0)))
        self._kept[key] = stored
        return stored[0]


def _spec(reading: Reading, shape: tuple[int, ...]) -> TensorSpec:
    if reading.dtype == torch.bool:
        return Categorical(2, shape=torch.Size(shape), dtype=torch.bool)
    return Bounded(reading.low, reading.high, torch.Size(shape), dtype=reading.dtype)
