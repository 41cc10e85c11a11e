"""The interface of robots' sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.errors import UserError
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robot_parts.view import RobotView, shape_of


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


@dataclass(eq=False, kw_only=True)
class Sensor(ABC):
    """One file in `pedzoo.sim.sensors`, or ``file.py:Class``: what robots observe in every decision.

    Attributes:
        noise: Standard deviation of normal noise, in the sensor's unit.
        dropout: Share of decisions in which the reading is missing: all of its numbers are 0.
        delay: Seconds by which readings are late.
    """

    noise: float = 0.0
    dropout: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values; a sensor with more settings is a dataclass, and checks its own as well.

        Raises:
            UserError: A value is out of range.
        """
        if self.noise < 0 or not 0 <= self.dropout < 1 or self.delay < 0:
            raise UserError(
                f"sensor {type(self).__name__}: noise {self.noise}, dropout {self.dropout}, delay "
                f"{self.delay}: expected at least 0, a share below 1, and seconds from 0 on"
            )

    @property
    @abstractmethod
    def readings(self) -> Mapping[str, Reading]:
        """What the entries are like that it adds to an observation, by name."""

    @abstractmethod
    def read(self, view: RobotView) -> dict[str, Tensor]:
        """Return the entries (B, R, ...) without noise, dropout and delay.

        Scenes that begin anew are asked for alone: B is that of the view, and nothing is remembered by row.
        """

    def observe(self, view: RobotView) -> dict[str, Tensor]:
        """Return the entries with noise and dropout, which depend on scene, robot and clock alone.

        Raises:
            UserError: `read` returned other entries than `readings` says, or other shapes.
        """
        exact = self.read(view)
        self._check_shapes(exact, (len(view.state.mask), view.robots))
        if not self.noise and not self.dropout:
            return exact
        state = view.state
        tick = (state.clock / TRACE_SECONDS).round().long()
        robots = torch.arange(view.robots, device=tick.device)
        key = randomness.join(state.key, type(self).__name__, tick).unsqueeze(1)
        key = randomness.join(key, robots)
        missing = randomness.uniform(randomness.join(key, "dropout")) < self.dropout
        return {name: self._spoilt(name, value, key, missing) for name, value in exact.items()}

    def _check_shapes(self, exact: Mapping[str, Tensor], scenes_and_robots: tuple[int, int]) -> None:
        name, expected = type(self).__name__, self.readings
        if not isinstance(exact, Mapping) or exact.keys() != expected.keys():
            given = ", ".join(map(str, exact)) if isinstance(exact, Mapping) else f"{exact!r:.60}"
            raise UserError(
                f"sensor {name}: read returned {given}: expected the entries of its readings, "
                f"{', '.join(expected)}"
            )
        for entry, reading in expected.items():
            shape = (*scenes_and_robots, *reading.shape)
            if (given := shape_of(exact[entry])) != shape:
                raise UserError(
                    f"sensor {name}: {entry} is {given}: expected (B, R, ...) = {shape}, as "
                    f"Reading({tuple(reading.shape)}) says"
                )

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


def check_view(number: str, count: int, reach: float, field_of_view: float) -> None:
    """Check how many things a sensor sees, how far in metres, and how wide in degrees.

    Args:
        number: The sensor's name and that of its ``count``.
        count: Of beams, people, ...
        reach: Metres.
        field_of_view: Degrees.

    Raises:
        UserError: A value is out of range.
    """
    if count < 1 or not reach > 0 or not 0 < field_of_view <= 360:
        raise UserError(
            f"sensor {number} {count}, reach {reach}, field_of_view {field_of_view}: expected at least 1, "
            "metres above 0, and degrees up to 360"
        )
