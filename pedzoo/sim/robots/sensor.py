"""What robots observe: the view of a scene, the interface of sensors, and the readings of several of them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torchrl.data import Bounded, Categorical
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core import randomness
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, rotate, unrotate
from pedzoo.core.registry import name_of_class
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.physics._base import Bodies, Physics
from pedzoo.sim.state import State


class RobotView(NamedTuple):
    """B scenes of A agents, of which the last R are robots: what sensors and rewards look at.

    Attributes:
        state: The scenes.
        guidance: What the planner says to all agents.
        physics: Casts rays, and takes pictures.
        robots: R.
    """

    state: State
    guidance: Guidance
    physics: Physics
    robots: int

    def robot(self, values: Tensor) -> Tensor:
        """Return the values (B, R, ...) of robots among those of all agents (B, A, ...)."""
        return values[:, -self.robots :]

    @property
    def position(self) -> Tensor:
        """Positions of robots (B, R, 2), metres."""
        return self.robot(self.state.position)

    @property
    def heading(self) -> Tensor:
        """Headings of robots (B, R), radians."""
        return self.robot(self.state.heading)

    @property
    def ahead(self) -> Tensor:
        """Unit vectors (B, R, 2) of the headings."""
        return direction_of(self.heading)

    def own(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the world in the robots' frames: x ahead, y to the left."""
        return unrotate(vectors, _aligned(self.ahead, vectors))

    def world(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the robots' frames in the world's: the inverse of `own`."""
        return rotate(vectors, _aligned(self.ahead, vectors))

    def own_places(self, points: Tensor) -> Tensor:
        """Return points (B, R, ..., 2) of the world in the robots' frames, from their positions, metres."""
        return self.own(points - _aligned(self.position, points))

    def rays(self, direction: Tensor, reach: float, people: bool = True) -> Tensor:
        """Return how far rays from the robots' centres go (B, R, N), metres, at most ``reach``.

        Args:
            direction: Unit vectors of the world (B, R, N, 2).
            reach: Metres.
            people: Other agents are in the way, too, and not walls alone; a robot does not see itself.
        """
        scenes, robots, rays, _ = direction.shape
        origin = self.position.unsqueeze(2).expand_as(direction).flatten(1, 2)
        bodies = Bodies.of(self.state)
        if not people:
            bodies = bodies._replace(mask=torch.zeros_like(bodies.mask))
        # a ray that begins inside a body does not see it: so a robot does not see itself
        return self.physics.rays(bodies, origin, direction.flatten(1, 2), reach).view(scenes, robots, rays)


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

    def spec(self, scenes: int, robots: int) -> TensorSpec:
        """Return the spec of the entry of some scenes and robots."""
        shape = torch.Size((scenes, robots, *self.shape))
        if self.dtype == torch.bool:
            return Categorical(2, shape=shape, dtype=torch.bool)
        return Bounded(self.low, self.high, shape, dtype=self.dtype)


@dataclass(eq=False, kw_only=True)
class Sensor(ABC):
    """A class of `pedzoo.sim.robots.sensors`, or ``file.py:Class``: what robots observe in every decision.

    Attributes:
        noise: Standard deviation of normal noise, in the sensor's unit.
        dropout: Share of decisions in which the reading is missing: all of its numbers are 0.
        delay: Seconds by which readings are late.
    """

    noise: float = 0.0
    dropout: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values; a sensor with more settings is a dataclass, and may check its own as well."""
        given = f"noise {self.noise}, dropout {self.dropout}, delay {self.delay}"
        valid = self.noise >= 0 and 0 <= self.dropout < 1 and self.delay >= 0
        self.check(valid, given, "at least 0, a share below 1, and seconds from 0 on")
        self._set_up()

    def _set_up(self) -> None:  # noqa: B027  for our own sensors
        pass

    def check(self, valid: bool, given: str, expected: str) -> None:
        """Raise the error of settings ``given`` that are not as ``expected``, unless they are valid."""
        if not valid:
            raise UserError(f"sensor {name_of_class(type(self).__name__)}: {given}: expected {expected}")

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
        exact, state = self.read(view), view.state
        self._check_shapes(exact, (len(state.mask), view.robots))
        if not self.noise and not self.dropout:
            return exact
        tick = (state.clock / TRACE_SECONDS).round().long()
        robots = torch.arange(view.robots, device=tick.device)
        key = randomness.join(state.key, type(self).__name__, tick).unsqueeze(1)
        key = randomness.join(key, robots)
        missing = randomness.uniform(randomness.join(key, "dropout")) < self.dropout
        return {name: self._disturbed(name, value, key, missing) for name, value in exact.items()}

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

    def _disturbed(self, name: str, value: Tensor, key: Tensor, missing: Tensor) -> Tensor:
        ones = [1] * (value.dim() - 2)
        missing = missing.view(*missing.shape, *ones)
        if not value.is_floating_point():
            return value.masked_fill(missing, 0)
        numbers = torch.arange(value[0, 0].numel(), device=value.device).view(value.shape[2:])
        own, reading = randomness.join(key, name).view(*key.shape, *ones), self.readings[name]
        noisy = value + self.noise * randomness.normal(randomness.join(own, numbers))
        # what is not seen is 0, and stays so
        noisy = torch.where(value == 0, value, noisy.clamp(reading.low, reading.high))
        return torch.where(missing, 0.0, noisy)


class Readings:
    """Reads all sensors once in every decision, and keeps what is not there yet."""

    def __init__(self, sensors: Sequence[Sensor], decision_dt: float) -> None:
        """Take the sensors of robots that decide every ``decision_dt`` seconds.

        Raises:
            UserError: Two sensors have entries of one name, or a delay is no multiple of the interval.
        """
        self.entries: dict[str, Reading] = {}
        self._late: list[tuple[Sensor, int]] = []
        self._last: dict[str, Tensor] = {}
        for sensor in sensors:
            name, late = type(sensor).__name__, round(sensor.delay / decision_dt)
            if twice := self.entries.keys() & sensor.readings.keys():
                raise UserError(f"sensor {name}: {', '.join(sorted(twice))} is an entry of two sensors")
            if abs(late * decision_dt - sensor.delay) > 1e-6:
                raise UserError(
                    f"sensor {name}: delay {sensor.delay:g} s: expected a multiple of the {decision_dt:g} s "
                    "between two decisions"
                )
            self.entries |= sensor.readings
            self._late.append((sensor, late))

    def __call__(self, view: RobotView, begun: Tensor | None = None) -> dict[str, Tensor]:
        """Return all entries (B, R, ...); where scenes ``begun`` (N,) begin, the view has these alone."""
        for sensor, late in self._late if begun is None or len(begun) else ():
            for name, now in sensor.observe(view).items():
                now = now.expand(late + 1, *now.shape)
                last = self._last.get(name, now)  # of the last decisions, the oldest first
                if begun is None:
                    self._last[name] = torch.cat((last[1:], now[:1]))
                else:
                    self._last[name] = last.index_copy(1, begun, now)
        # a caller may write into what it gets
        return {name: last[0].clone() for name, last in self._last.items()}


def shape_of(value: object) -> tuple[int, ...] | str:
    """Return the shape of what a person's own code returned, or what it is if it is no tensor."""
    return tuple(value.shape) if isinstance(value, Tensor) else f"{value!r:.60}, no tensor"


def _aligned(value: Tensor, like: Tensor) -> Tensor:
    """Return (B, R, 2) with as many dimensions as ``like`` (B, R, ..., 2)."""
    return value.view(*value.shape[:2], *[1] * (like.dim() - 3), 2)
