"""The readings of all sensors of robots, some of which come late."""

from __future__ import annotations

from collections.abc import Sequence

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
        self._sensors, self._late = list(sensors), []
        self._last: dict[str, Tensor] = {}
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

    def __call__(self, view: RobotView, begun: Tensor | None = None) -> dict[str, Tensor]:
        """Return all entries (B, R, ...).

        Args:
            view: The scenes now; where there was no decision, those that begin alone.
            begun: Which scenes these are (N,) long; None after a decision.
        """
        if begun is None or len(begun):
            for sensor, late in zip(self._sensors, self._late, strict=True):
                for name, now in sensor.observe(view).items():
                    self._last[name] = self._with(name, now.expand(late + 1, *now.shape), begun)
        # a caller may write into what it gets
        return {name: last[0].clone() for name, last in self._last.items()}

    def _with(self, name: str, now: Tensor, begun: Tensor | None) -> Tensor:
        """Return an entry of the last decisions (1 + late, B, R, ...), the oldest first."""
        last = self._last.get(name, now)
        return torch.cat((last[1:], now[:1])) if begun is None else last.index_copy(1, begun, now)


def _spec(reading: Reading, shape: tuple[int, ...]) -> TensorSpec:
    if reading.dtype == torch.bool:
        return Categorical(2, shape=torch.Size(shape), dtype=torch.bool)
    return Bounded(reading.low, reading.high, torch.Size(shape), dtype=reading.dtype)
