"""What every sensor of a robot is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.errors import UserError
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robot_parts.view import RobotView


class Reading(NamedTuple):
    """What one entry of an observation is like.

    Attributes:
        shape: Without scenes and robots.
        dtype: Of its values.
        low: Least value.
        high: Greatest value.
    """

    shape: tuple[int, ...]
    dtype: torch.dtype = torch.float32
    low: float = -torch.inf
    high: float = torch.inf


class Sensor(ABC):
    """One file in `pedzoo.sim.sensors`, or ``file.py:Class``: what robots observe in every decision.

    Attributes:
        noise: Standard deviation of normal noise, in the sensor's unit.
        dropout: Share of decisions in which the reading is missing: all of its numbers are 0.
        delay: Seconds by which readings are late.
    """

    def __init__(self, noise: float = 0.0, dropout: float = 0.0, delay: float = 0.0) -> None:
        """Say how good the sensor is.

        Raises:
            UserError: A value is out of range.
        """
        if noise < 0 or not 0 <= dropout < 1 or delay < 0:
            raise UserError(
                f"sensor {type(self).__name__}: noise {noise}, dropout {dropout}, delay {delay}: expected at "
                "least 0, a share below 1, and seconds from 0 on"
            )
        self.noise, self.dropout, self.delay = noise, dropout, delay

    @property
    @abstractmethod
    def readings(self) -> Mapping[str, Reading]:
        """What the entries are like that it adds to an observation, by name."""

    @abstractmethod
    def read(self, view: RobotView) -> dict[str, Tensor]:
        """Return the entries (B, R, ...) without noise, dropout and delay."""

    def observe(self, view: RobotView) -> dict[str, Tensor]:
        """Return the entries with noise and dropout, which depend on scene, robot and clock alone."""
        exact = self.read(view)
        if not self.noise and not self.dropout:
            return exact
        state = view.state
        tick = (state.clock / TRACE_SECONDS).round().long()
        robots = torch.arange(view.robots, device=tick.device)
        key = randomness.join(state.key, type(self).__name__, tick).unsqueeze(1)
        key = randomness.join(key, robots)
        missing = randomness.uniform(randomness.join(key, "dropout")) < self.dropout
        return {name: self._spoilt(name, value, key, missing) for name, value in exact.items()}

    def _spoilt(self, name: str, value: Tensor, key: Tensor, missing: Tensor) -> Tensor:
        gone = missing.view(*missing.shape, *[1] * (value.dim() - 2))
        if not value.is_floating_point():
            return value.masked_fill(gone, 0)
        numbers = torch.arange(value[0, 0].numel(), device=value.device).view(value.shape[2:])
        own = randomness.join(key, name).view(*key.shape, *[1] * (value.dim() - 2))
        reading = self.readings[name]
        noisy = value + self.noise * randomness.normal(randomness.join(own, numbers))
        # what is not seen is 0, and stays so
        noisy = torch.where(value == 0, value, noisy.clamp(reading.low, reading.high))
        return torch.where(gone, 0.0, noisy)
