"""The interface of robots' policies."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from pedzoo.core.batch import ROBOT, agents_of, maps_of, other_agents
from pedzoo.core.bodies import HOLONOMIC, Fleet, RobotBody
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, unrotate
from pedzoo.policies.policy import Policy
from pedzoo.policies.walker import Walker


class Robot(NamedTuple):
    """One robot in each scene."""

    position: Tensor
    """Centre (B, 2), metres."""
    velocity: Tensor
    """Current velocity (B, 2), m/s."""
    goal: Tensor
    """Where it shall go (B, 2), metres."""
    radius: Tensor
    """Of its disc (B,), metres."""
    v_pref: Tensor
    """The speed it likes, which is its top speed (B,), m/s."""


class DriveState(NamedTuple):
    """How B differential drives move."""

    heading: Tensor
    """Where they face (B,), radians from the x axis."""
    speed: Tensor
    """Forwards (B,), m/s."""
    turn_rate: Tensor
    """To the left (B,), rad/s."""


class ObservedPeople(NamedTuple):
    """The people that the robot knows of; any numbers where there is no person."""

    position: Tensor
    """Centres (B, N, 2), metres."""
    velocity: Tensor
    """Velocities (B, N, 2), m/s."""
    radius: Tensor
    """Of their discs (B, N), metres."""
    mask: Tensor
    """Which of them are there (B, N) bool."""


Clearance = Callable[[Tensor], Tensor]
"""Distances (B, M) of points (B, M, 2) from the nearest walls, metres."""


class LocalPlanner(Protocol):
    """Anything that gives robots velocities; one object serves the same B scenes from their start.

    A class takes its settings as arguments, and ``time_step`` if it wants it: the seconds for which its
    velocities are held. A policy with memory starts with an empty one. Scenes that have ended stay in the
    batch, and their velocities are ignored.

    One that avoids walls takes them as a third argument, ``walls: Clearance | None``. One for wheels has a
    method ``command`` beside, see `pedzoo.policies.robots.dwa.Dwa.command`.
    """

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the next velocities (B, 2), m/s; longer ones than ``v_pref`` are shortened to it."""
        ...


TURN_GAIN = 4.0
"""Turning rate of a robot on wheels for each radian by which it faces away from where it should go, 1/s."""


class RobotPolicy(TensorDictModuleBase):
    """Reads an observation of `pedzoo.make_robot_env`, and writes ``robots/action`` (B, R, 2).

    The bodies of the robots stand in the batch: `bodies_of`. A policy by name is a file in
    `pedzoo.policies.robots`, or ``file.py:Class``: one of these, or a `LocalPlanner`.
    """

    in_keys: ClassVar[list[Any]] = ["agents", "robots", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("robots", "action")]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions of all robots."""
        tensordict["robots", "action"] = self.action(tensordict)
        return tensordict

    @abstractmethod
    def action(self, scenes: TensorDictBase) -> Tensor:
        """Return the actions (B, R, 2), see `pedzoo.core.bodies.RobotBody`."""


class PedestrianRobotPolicy(RobotPolicy):
    """A policy of people moves the robots: it sees all agents, and moves those alone; see `tracked`."""

    def __init__(self, policy: Policy | Walker) -> None:
        """Take the policy."""
        super().__init__()
        self.policy = policy

    def action(self, scenes: TensorDictBase) -> Tensor:
        bodies, seen, agents = bodies_of(scenes), scenes.copy(), agents_of(scenes).copy()
        agents["controlled"] = agents["mask"] & (agents["kind"] == ROBOT)
        del agents["info"]  # of the environment's decision, which may be shorter than the policy's
        seen["agents"] = agents
        velocity, count = cast("Tensor", self.policy(seen)["agents", "action"]), bodies.radius.shape[-1]
        return tracked(velocity[:, -count:], cast("Tensor", agents["heading"])[:, -count:, 0], bodies)


class LocalPlannerPolicy(RobotPolicy):
    """A local planner moves each robot: it sees all other agents, the walls, and the carrot as its goal."""

    def __init__(self, planner: LocalPlanner) -> None:
        """Take the planner."""
        super().__init__()
        self.planner = planner
        self._takes_walls = "walls" in inspect.signature(planner).parameters

    def action(self, scenes: TensorDictBase) -> Tensor:
        bodies = bodies_of(scenes)
        shape, (robot, drive, people) = bodies.radius.shape, _seen(scenes, bodies)
        command = getattr(self.planner, "command", None)
        walls = _walls(scenes, shape[1]) if command or self._takes_walls else None
        if command:
            if bool((bodies.drive == HOLONOMIC).any()):
                name = type(self.planner).__name__.lower()
                raise UserError(f"{name} plans for wheels: expected robot=diff_drive, unicycle or the like")
            speed, turn = command(robot, drive, people, walls)
            return bodies.from_speed(speed.view(shape), turn.view(shape))
        velocity = self.planner(robot, people, **{"walls": walls} if self._takes_walls else {})
        return tracked(velocity.view(*shape, 2), drive.heading.view(shape), bodies)


class LearnedPlanner:
    """A trained disc as a local planner, where there are no walls: all of its way is in sight."""

    def __init__(self, policy: RobotPolicy) -> None:
        """Take the policy."""
        self.policy, self.bodies = policy, Fleet.of([RobotBody()])

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the next velocities (B, 2), m/s; robots face along the x axis of the world."""
        shape, still = (len(robot.goal), 1), torch.zeros_like(robot.goal[:, 0])
        bodies = self.bodies._replace(radius=robot.radius, top_speed=robot.v_pref, slowest=-robot.v_pref)
        body = {name: value.expand(shape[0]).unsqueeze(1) for name, value in bodies._asdict().items()}
        observation = TensorDict(sensed(robot, people, still, still), shape)
        group = TensorDict({"observation": observation, "body": TensorDict(body, shape)}, shape)
        return self.policy.action(TensorDict({"robots": group}, shape[:1]))[:, 0]


def sensed(robot: Robot, people: ObservedPeople, heading: Tensor, turn_rate: Tensor) -> dict[str, Tensor]:
    """Return what sensors read of one robot in each scene (B, 1, ...), where all of its way is in sight.

    It faces along ``heading`` (B,), radians, and turns at ``turn_rate`` (B,), rad/s.
    """
    way, axis = robot.goal - robot.position, direction_of(heading)
    place, axes = people.position - robot.position.unsqueeze(1), axis.unsqueeze(1).expand_as(people.position)
    place, velocity = (unrotate(value, axes) for value in (place, people.velocity))
    rows = torch.cat((place, velocity, people.radius.unsqueeze(-1)), dim=-1)
    numbers = {"remaining_path": torch.linalg.vector_norm(way, dim=-1), "radius": robot.radius}
    numbers |= {"turn_rate": turn_rate, "heading": heading}
    seen = {name: value.unsqueeze(1) for name, value in numbers.items()}
    seen |= dict.fromkeys(("goal", "waypoint"), unrotate(way, axis)) | {
        "velocity": unrotate(robot.velocity, axis),
        "people": torch.where(people.mask.unsqueeze(-1), rows, 0),
        "people_mask": people.mask,
    }
    return {name: value.unsqueeze(1) for name, value in seen.items()}


def _seen(scenes: TensorDictBase, bodies: Fleet) -> tuple[Robot, DriveState, ObservedPeople]:
    """Return the observation of each of the B * R robots of itself and all other agents, in one row each."""
    agents = agents_of(scenes)
    count = bodies.radius.shape[-1]
    position = cast("Tensor", agents["history"])[:, :, -1]
    velocity, carrot = cast("Tensor", agents["velocity"]), cast("Tensor", scenes["robots", "carrot"])
    radius, heading = (cast("Tensor", agents[name])[..., 0] for name in ("radius", "heading"))
    others = other_agents(cast("Tensor", agents["mask"]), count).flatten(0, 1)

    def own(value: Tensor) -> Tensor:
        return value[:, -count:].flatten(0, 1)

    def around(value: Tensor) -> Tensor:
        return value.unsqueeze(1).expand(-1, count, *value.shape[1:]).flatten(0, 1)

    robot = Robot(own(position), own(velocity), carrot.flatten(0, 1), own(radius), bodies.top_speed.flatten())
    # the scene batch has no turn rates; a planner's window begins at none
    speed = own((velocity * direction_of(heading)).sum(-1))
    drive = DriveState(own(heading), speed, torch.zeros_like(speed))
    return robot, drive, ObservedPeople(around(position), around(velocity), around(radius), others)


def _walls(scenes: TensorDictBase, robots: int) -> Clearance | None:
    """Return how far points (B * R, M, 2) are from walls; None where there are none."""
    if not (maps := maps_of(scenes)).grids:
        return None
    map_id, pose = cast("Tensor", scenes["map_id"]), cast("Tensor", scenes["scene_pose"])
    around = maps.walls_around(map_id[:, 0].repeat_interleave(robots), pose.repeat_interleave(robots, 0))
    return lambda points: around.closest(points)[0]


def bodies_of(scenes: TensorDictBase) -> Fleet:
    """Return the bodies of the robots (B, R) of a batch."""
    body = cast("TensorDictBase", scenes["robots", "body"])
    return Fleet(*(cast("Tensor", body[name]) for name in Fleet._fields))


def tracked(velocity: Tensor, heading: Tensor, bodies: Fleet) -> Tensor:
    """Return actions (B, R, 2) by which robots follow ``velocity`` (B, R, 2), m/s, over the ground.

    Holonomic robots follow it exactly. Robots on wheels turn towards it at `TURN_GAIN`. They drive slower the
    farther they face away (cos^3), and stand beyond 90 degrees. So they lag behind velocities that were
    decided for a disc: a policy of discs is a weaker baseline on wheels.
    """
    own = unrotate(velocity, direction_of(heading))
    speed = torch.linalg.vector_norm(velocity, dim=-1)
    off = torch.atan2(own[..., 1], own[..., 0])
    off = torch.where(speed > 1e-3, off, 0.0)
    turn = (TURN_GAIN * off).clamp(-bodies.top_turn, bodies.top_turn)
    wheels = bodies.from_speed(speed.minimum(bodies.top_speed) * off.cos().clamp_min(0) ** 3, turn)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), own, wheels)
