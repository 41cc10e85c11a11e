"""What robots observe: the interface of sensors, and their table, which are classes by name."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad
from torchrl.data import Bounded, Categorical
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core import randomness
from pedzoo.core.batch import other_agents
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of
from pedzoo.core.registry import name_of_class
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.drawing import Lens
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.scenes import RobotView

NOT_SEEN = 15.0
"""Metres: position of masked people in the observation of CrowdNav++."""


class Reading(NamedTuple):
    """What one entry of an observation is like: its shape without scenes and robots, dtype and bounds."""

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
    """What robots observe: a class of this file, or ``file.py:Class``, a dataclass if it has more settings.

    Attributes:
        noise: Standard deviation of normal noise, in the sensor's unit.
        dropout: Share of decisions in which the reading is missing: all of its numbers are 0.
        delay: Seconds by which readings are late.
    """

    noise: float = 0.0
    dropout: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: one is out of range."""
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
        """Return the entries (B, R, ...) without noise, dropout and delay; B is that of the view.

        Scenes that begin anew are asked for alone: nothing is remembered by row.
        """

    def observe(self, view: RobotView) -> dict[str, Tensor]:
        """Return the entries with noise and dropout, which depend on scene, robot and clock alone.

        Raises:
            UserError: `read` returned other entries than `readings` says, or other shapes.
        """
        exact, expected, name = self.read(view), self.readings, type(self).__name__
        if not isinstance(exact, Mapping) or exact.keys() != expected.keys():
            given = ", ".join(map(str, exact)) if isinstance(exact, Mapping) else f"{exact!r:.60}"
            wanted = f"expected the entries of its readings, {', '.join(expected)}"
            raise UserError(f"sensor {name}: read returned {given}: {wanted}")
        for entry, reading in expected.items():
            shape = (len(view.state.mask), view.robots, *reading.shape)
            if (given := shape_of(exact[entry])) != shape:
                raise UserError(
                    f"sensor {name}: {entry} is {given}: expected (B, R, ...) = {shape}, as "
                    f"Reading({tuple(reading.shape)}) says"
                )
        if not self.noise and not self.dropout:
            return exact
        tick = (view.state.clock / TRACE_SECONDS).round().long()
        key = randomness.join(view.state.key, name, tick).unsqueeze(1)
        key = randomness.join(key, torch.arange(view.robots, device=tick.device))
        missing = randomness.uniform(randomness.join(key, "dropout")) < self.dropout
        result = {}
        for entry, value in exact.items():
            ones = [1] * (value.dim() - 2)
            if value.is_floating_point():
                numbers = torch.arange(value[0, 0].numel(), device=value.device).view(value.shape[2:])
                own = randomness.join(randomness.join(key, entry).view(*key.shape, *ones), numbers)
                noisy = value + self.noise * randomness.normal(own)
                # what is not seen is 0, and stays so
                value = torch.where(value == 0, value, noisy.clamp(expected[entry].low, expected[entry].high))
            result[entry] = value.masked_fill(missing.view(*key.shape, *ones), 0)
        return result


def shape_of(value: object) -> tuple[int, ...] | str:
    """Return the shape of what a person's own code returned, or what it is if it is no tensor."""
    return tuple(value.shape) if isinstance(value, Tensor) else f"{value!r:.60}, no tensor"


def _check_view(sensor: "Lidar | People", number: str, count: int) -> None:
    """Check how many things a sensor sees, how far in metres, and how wide in degrees."""
    reach, angle = sensor.reach, sensor.field_of_view
    given = f"{number} {count}, reach {reach}, field_of_view {angle}"
    valid = count >= 1 and reach > 0 and 0 < angle <= 360
    sensor.check(valid, given, "at least 1, metres above 0, and degrees up to 360")


class Goal(Sensor):
    """The goal, and the way to it, in the robot's own frame.

    ``goal`` and ``waypoint`` (B, R, 2), and ``remaining_path`` (B, R, 1), metres. The waypoint is the
    planner's carrot: a point ahead on the way around walls, in sight.
    """

    readings: Mapping[str, Reading] = {
        **dict.fromkeys(("goal", "waypoint"), Reading((2,))),
        "remaining_path": Reading((1,), low=0.0),
    }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        return {
            "goal": view.own_places(view.robot(view.state.goal_point)),
            "waypoint": view.own_places(view.robot(view.guidance.carrot)),
            "remaining_path": view.robot(view.state.remaining_path).unsqueeze(-1),
        }


class Odometry(Sensor):
    """What a robot knows of its own motion.

    ``velocity`` (B, R, 2), m/s, in the robot's frame; ``turn_rate``, ``radius`` and ``heading`` (B, R, 1).
    Turning rates are in rad/s, radii in metres, headings in radians from the x axis of the world.
    """

    readings: Mapping[str, Reading] = {
        "velocity": Reading((2,)),
        "turn_rate": Reading((1,)),
        "radius": Reading((1,), low=0.0),
        "heading": Reading((1,)),
    }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        names = ("turn_rate", "radius", "heading")
        own = {name: view.robot(getattr(view.state, name)).unsqueeze(-1) for name in names}
        return {"velocity": view.own(view.robot(view.state.velocity)), **own}


@dataclass(eq=False)
class Lidar(Sensor):
    """A planar lidar: how far it is to walls and bodies all around a robot.

    ``lidar`` (B, R, N): metres from the robot's centre, at most ``reach``, of N ``beams``, counterclockwise.
    They are spread evenly over the field of view, degrees. With 360 the first one points ahead; with less it
    points to the right end of the field, the last one to the left end.
    """

    beams: int = 64
    reach: float = 5.0
    field_of_view: float = 360.0

    def _set_up(self) -> None:
        _check_view(self, "beams", self.beams)
        angle = math.radians(self.field_of_view)
        around = torch.arange(self.beams) * (angle / self.beams)
        ahead = torch.linspace(-angle / 2, angle / 2, self.beams)
        self._angles = around if self.field_of_view == 360 else ahead

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"lidar": Reading((self.beams,), low=0.0, high=self.reach)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        angle = view.heading.unsqueeze(-1) + self._angles.to(view.heading.device)
        return {"lidar": view.rays(direction_of(angle), self.reach)}


@dataclass(eq=False)
class Camera(Sensor):
    """A colour camera with depth on a robot, above its centre; it looks ahead, level, and not at the robot.

    ``rgb`` (B, R, H, W, 3) uint8, and ``depth`` (B, R, H, W), metres along the optical axis. Walls and people
    are seen as `bullet` has them, the only backend with such pictures.

    Attributes:
        width: W, pixels.
        height: H, pixels.
        field_of_view: From left to right, degrees.
        eye_height: Metres above the floor.
        reach: Greatest depth, metres: where nothing is nearer.
    """

    width: int = 64
    height: int = 48
    field_of_view: float = 70.0
    eye_height: float = 0.5
    reach: float = 10.0

    def _set_up(self) -> None:
        names = ("width", "height", "field_of_view", "eye_height", "reach")
        width, height, angle, eyes, reach = numbers = [getattr(self, name) for name in names]
        valid = min(width, height) >= 1 and 0 < angle < 180 and eyes > 0 and reach > 0
        given = ", ".join(f"{name} {number}" for name, number in zip(names, numbers, strict=True))
        self.check(valid, given, "pixels, degrees below 180, and metres above 0")
        self._lens = Lens(width, height, math.radians(angle), eyes, reach)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {
            "rgb": Reading((self.height, self.width, 3), torch.uint8, low=0, high=255),
            "depth": Reading((self.height, self.width), low=0.0, high=self.reach),
        }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        pictures = view.physics.onboard(Bodies.of(view.state), view.heading, self._lens)
        rgb, depth = (torch.from_numpy(values).to(view.heading.device) for values in pictures)
        return {"rgb": rgb, "depth": depth}


@dataclass(eq=False)
class Patch(Sensor):
    """A square of floor around a robot, seen from above: walls, and bodies.

    ``patch`` (B, R, 2, N, N): 1 where the centre of one of N x N ``cells`` is in a wall (layer 0) or in a
    body (layer 1). The robot is in the middle and faces up: rows go from ahead to behind, columns from left
    to right. Its own body is not drawn. ``side`` is that of the square, metres.
    """

    cells: int = 32
    side: float = 6.4

    def _set_up(self) -> None:
        cells, side = self.cells, self.side
        self.check(cells >= 1 and side > 0, f"cells {cells}, side {side}", "at least 1, and metres above 0")
        across = (torch.arange(cells) + 0.5) * (side / cells) - side / 2
        self._centres = torch.stack(torch.meshgrid(-across, -across, indexing="ij"), dim=-1)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"patch": Reading((2, self.cells, self.cells), low=0.0, high=1.0)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        state, robots = view.state, view.robots
        scenes, agents = state.mask.shape
        own = self._centres.to(state.past).expand(scenes, robots, self.cells, self.cells, 2)
        points = (view.world(own) + view.position[:, :, None, None]).flatten(2, 3)
        gap, _ = view.physics.bank.closest_wall(points, state.map_id, state.pose)
        away = torch.cdist(points.flatten(1, 2), state.position).view(scenes, robots, -1, agents)
        there = other_agents(state.mask, robots).unsqueeze(2)
        bodies = ((away < state.radius[:, None, None]) & there).any(-1)
        layers = torch.stack((gap <= 0, bodies), dim=2).to(points.dtype)
        return {"patch": layers.unflatten(3, (self.cells, self.cells))}


@dataclass(eq=False)
class People(Sensor):
    """The people and other robots around a robot, as a set: nearest first.

    ``people`` (B, R, N, 5): x, y, vx, vy in the robot's frame, and radius; ``people_mask`` (B, R, N) bool.
    Metres and m/s; velocities are those over the ground. Rows beyond the agents in view are 0 and masked.

    Attributes:
        most: N, the nearest ones.
        reach: Metres between centres.
        field_of_view: Degrees, half of it to either side.
        line_of_sight: Agents behind walls are not seen.
    """

    most: int = 10
    reach: float = 10.0
    field_of_view: float = 360.0
    line_of_sight: bool = False

    def _set_up(self) -> None:
        _check_view(self, "most", self.most)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"people": Reading((self.most, 5)), "people_mask": Reading((self.most,), torch.bool)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        state, robots = view.state, view.robots
        scenes, agents = state.mask.shape
        place, velocity, radius = (
            value.unsqueeze(1).expand(scenes, robots, agents, -1)
            for value in (state.position, state.velocity, state.radius.unsqueeze(-1))
        )
        place = view.own_places(place)
        distance = torch.linalg.vector_norm(place, dim=-1)
        seen = other_agents(state.mask, robots) & (distance <= self.reach)
        if self.field_of_view < 360:
            half = math.radians(self.field_of_view / 2)
            seen = seen & (torch.atan2(place[..., 1], place[..., 0]).abs() <= half)
        if self.line_of_sight:
            direction = view.world(place) / distance.clamp_min(1e-6).unsqueeze(-1)
            free = view.rays(direction, min(self.reach, view.physics.bank.max_distance), people=False)
            seen = seen & (free >= (distance - radius[..., 0]).clamp_max(free.max()))
        count = min(self.most, agents)
        nearest = torch.where(seen, distance, torch.inf).topk(count, largest=False).indices
        mask = seen.gather(2, nearest)
        rows = torch.cat((place, view.own(velocity), radius), -1)
        rows = rows.gather(2, nearest.unsqueeze(-1).expand(*nearest.shape, 5)) * mask.unsqueeze(-1)
        missing = self.most - count
        return {"people": pad(rows, (0, 0, 0, missing)), "people_mask": pad(mask, (0, missing))}


class AttnGraph(People):
    """The observation of CrowdNav++ (Liu et al., "Intention Aware Robot Crowd Navigation", ICRA 2023).

    A dictionary in the frame of the world. ``robot_node`` (B, R, 1, 7) is x, y, radius, goal x, goal y, top
    speed and heading of the robot. ``temporal_edges`` (B, R, 1, 2) is its velocity. ``spatial_edges`` (B, R,
    N, 2 (P + 1)) says for people, nearest first, where they are from the robot's place, and where they will
    be in P steps if they go on as they do; all 15 in other rows. ``visible_masks`` (B, R, N) says which rows
    are people, and ``detected_human_num`` (B, R, 1) how many, at least 1.
    """

    def __init__(
        self,
        most: int = 20,
        reach: float = 5.0,
        field_of_view: float = 360.0,
        predicted: int = 5,
        seconds: float = 0.25,
    ) -> None:
        """See the people that `People` sees, and P steps, ``predicted``, of so many ``seconds`` ahead.

        With 0 steps it says where people are alone, as in DS-RNN.
        """
        super().__init__(most, reach, field_of_view)
        given = f"predicted {predicted}, seconds {seconds}"
        self.check(predicted >= 0 and seconds > 0, given, "at least 0, above 0")
        self.predicted, self.seconds = predicted, seconds

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {
            "robot_node": Reading((1, 7)),
            "temporal_edges": Reading((1, 2)),
            "spatial_edges": Reading((self.most, 2 * (self.predicted + 1))),
            "visible_masks": Reading((self.most,), torch.bool),
            "detected_human_num": Reading((1,), low=1.0, high=float(self.most)),
        }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        seen, state = super().read(view), view.state
        rows, mask = seen["people"], seen["people_mask"]
        place, velocity = view.world(rows[..., 0:2]), view.world(rows[..., 2:4])
        ahead = self.seconds * torch.arange(self.predicted + 1, device=rows.device)
        edges = place.unsqueeze(3) + velocity.unsqueeze(3) * ahead.view(-1, 1)
        own = (state.radius, state.goal_point, state.top_speed, state.heading)
        own = [view.robot(value if value.dim() == 3 else value.unsqueeze(2)) for value in own]
        return {
            "robot_node": torch.cat((view.position, *own), -1).unsqueeze(2),
            "temporal_edges": view.robot(state.velocity).unsqueeze(2),
            "spatial_edges": torch.where(mask.unsqueeze(-1), edges.flatten(3), NOT_SEEN),
            "visible_masks": mask,
            "detected_human_num": mask.sum(-1, keepdim=True).clamp_min(1).to(rows.dtype),
        }
