"""What every policy of robots is, and how robots on wheels follow a wanted velocity."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from pedzoo.core.batch import ROBOT, agents_of
from pedzoo.core.bodies import HOLONOMIC, Fleet
from pedzoo.core.geometry import unrotate
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.policy import Policy

TURN_GAIN = 2.5
"""Turning rate of a robot on wheels for each radian by which it faces away from where it should go, 1/s."""


class RobotPolicy(TensorDictModuleBase):
    """Reads what `pedzoo.make_robot_env` observes, and writes ``robots/action`` (B, R, 2).

    The bodies of the robots stand in the batch: `bodies_of`. A policy by name is a file in
    `pedzoo.policies.robots`, or ``file.py:Class``.
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


class VelocityPolicy(RobotPolicy):
    """A robot that decides a velocity over the ground; with wheels it tracks it, see `tracked`."""

    def action(self, scenes: TensorDictBase) -> Tensor:
        """Return the actions (B, R, 2)."""
        bodies = bodies_of(scenes)
        heading = cast("Tensor", agents_of(scenes)["heading"])[:, -bodies.radius.shape[-1] :, 0]
        return tracked(self.velocity(scenes), heading, bodies)

    @abstractmethod
    def velocity(self, scenes: TensorDictBase) -> Tensor:
        """Return the wanted velocities (B, R, 2) over the ground, m/s."""


class AsPedestrian(VelocityPolicy):
    """A policy of people moves the robots: it sees all agents, and moves those alone."""

    def __init__(self, policy: Policy | Walker) -> None:
        """Take the policy."""
        super().__init__()
        self.policy = policy

    def velocity(self, scenes: TensorDictBase) -> Tensor:
        """See `VelocityPolicy.velocity`."""
        seen, agents = scenes.copy(), agents_of(scenes).copy()
        robots = agents["kind"] == ROBOT
        agents["controlled"] = agents["mask"] & robots
        del agents["info"]  # of the environment's decision, which may be shorter than the policy's
        seen["agents"] = agents
        count = bodies_of(scenes).radius.shape[-1]
        return cast("Tensor", self.policy(seen)["agents", "action"])[:, -count:]


def bodies_of(scenes: TensorDictBase) -> Fleet:
    """Return the bodies of the robots (B, R) of a batch."""
    body = cast("TensorDictBase", scenes["robots", "body"])
    return Fleet(*(cast("Tensor", body[name]) for name in Fleet._fields))


def tracked(velocity: Tensor, heading: Tensor, bodies: Fleet) -> Tensor:
    """Return actions (B, R, 2) by which robots follow ``velocity`` (B, R, 2), m/s, over the ground.

    Holonomic robots just do. Robots on wheels turn towards it at `TURN_GAIN`. They drive the slower the
    farther they face away, and not at all beyond 90 degrees. So they follow late what was decided for a disc
    that moves in any direction: such a policy is a baseline, and not at its best.
    """
    direction = torch.stack((heading.cos(), heading.sin()), dim=-1)
    own = unrotate(velocity, direction)
    speed = torch.linalg.vector_norm(velocity, dim=-1)
    off = torch.atan2(own[..., 1], own[..., 0])
    off = torch.where(speed > 1e-3, off, 0.0)
    turn = (TURN_GAIN * off).clamp(-bodies.top_turn, bodies.top_turn)
    wheels = bodies.from_speed(speed.minimum(bodies.top_speed) * off.cos().clamp_min(0), turn)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), own, wheels)
