"""Teachers for the first updates: any robot's policy, or the best of some constant velocities."""

from __future__ import annotations

import math
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.geometry import direction_of, unrotate
from pedzoo.policies.load import load_robot_policy
from pedzoo.policies.robots._base import bodies_of
from pedzoo.policies.robots.attention import TURN_GAIN, as_decision, frame_of
from pedzoo.train.robots.experience import Teacher

DIRECTIONS, SPEEDS, HORIZON, STEP = 24, 3, 12, 0.25
"""How many are tried, and for how many steps of so many seconds."""

WALL_SPARE = 0.2
"""Metres by which the margin to a wall is less than that to people."""

MARGIN, MARGIN_COST, COLLISION_COST, DISCOUNT = 0.25, 4.0, 10.0, 0.97
"""Metres to keep from others, what a metre too near costs for a second, a contact, and the next step."""


CONSTANT_VELOCITY = "constant_velocity"
"""The name of the teacher that knows no more than the robot senses."""


def teacher_of(name: str) -> Teacher:
    """Return a teacher: `CONSTANT_VELOCITY`, or a policy of robots by its name with settings.

    Such a policy may see everything: `pedzoo.policies.load.load_robot_policy`.

    Raises:
        UserError: An unknown name or setting.
    """
    if name == CONSTANT_VELOCITY:
        return taught
    policy = load_robot_policy(name)

    def decision(scenes: TensorDictBase) -> Tensor:
        bodies = bodies_of(scenes)
        return as_decision(policy.action(scenes), frame_of(scenes, bodies), bodies)

    return decision


@torch.no_grad()
def taught(scenes: TensorDictBase) -> Tensor:
    """Return decisions (..., R, 2) as `pedzoo.policies.robots.attention.Attention.mean` has them.

    It reads what the robot senses. Where the lidar's beams end it sees points that stand. Robots on wheels
    turn towards the velocity.
    """
    bodies = bodies_of(scenes)
    seen = cast("TensorDictBase", scenes["robots", "observation"])
    way = seen["waypoint"]
    left = torch.linalg.vector_norm(way, dim=-1)
    way = way / left.clamp_min(1e-6).unsqueeze(-1)
    own = _samples(way.device)  # of a robot that looks along its way
    score = _worth(seen, own, bodies.top_speed, way, left.clamp_min(0.3))
    best = own[score.argmax(-1)]
    ahead = way[..., 1].atan2(way[..., 0]) + best[..., 1].atan2(best[..., 0])
    speed = torch.linalg.vector_norm(best, dim=-1)
    off = torch.where(speed > 0, torch.remainder(ahead + math.pi, 2 * math.pi) - math.pi, 0.0)
    turn = (TURN_GAIN * off / bodies.top_turn).clamp(-1, 1)
    wheels = torch.stack((speed * off.cos().clamp_min(0), turn), dim=-1)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), best, wheels)


def _samples(device: torch.device) -> Tensor:
    """Return shares of the top speed (S, 2), standing last."""
    angle = torch.arange(DIRECTIONS, device=device) * (2 * math.pi / DIRECTIONS)
    turn = direction_of(angle)
    share = torch.arange(SPEEDS, 0, -1, device=device) / SPEEDS
    return torch.cat(((turn[:, None] * share[:, None]).flatten(0, 1), torch.zeros(1, 2, device=device)))


def _worth(seen: TensorDictBase, own: Tensor, top_speed: Tensor, way: Tensor, left: Tensor) -> Tensor:
    """Return what samples are worth (..., S): the way that gets shorter, less what is too near."""
    velocity = own * top_speed[..., None, None]
    gap = _gap(seen, velocity, way)
    steps = torch.arange(HORIZON + 1, device=own.device) * STEP
    place = velocity.unsqueeze(-2) * steps[:, None]
    goal = torch.stack((left, torch.zeros_like(left)), dim=-1)[..., None, None, :]
    rest = torch.linalg.vector_norm(goal - place, dim=-1)
    touched, there = gap < 0, rest[..., 1:] < 0.3
    over = (touched | there).long().cumsum(-1)
    on = torch.cat((torch.zeros_like(over[..., :1]), over[..., :-1]), dim=-1) == 0
    close = (MARGIN - gap).clamp(0, MARGIN)
    worth = rest[..., :-1] - rest[..., 1:] - MARGIN_COST * STEP * close
    worth = torch.where(touched, -COLLISION_COST, worth)
    return (worth * on * DISCOUNT ** torch.arange(HORIZON, device=own.device)).sum(-1)


def _gap(seen: TensorDictBase, velocity: Tensor, way: Tensor) -> Tensor:
    """Return the least distances of bodies in each step (..., S, H), metres."""
    mask = seen["people_mask"]
    place, move, radius = cast("Tensor", seen["people"]).split([2, 2, 1], dim=-1)
    spare = torch.zeros_like(radius)
    if "lidar" in seen.keys():
        beams = seen["lidar"].shape[-1]
        angle = torch.arange(beams, device=way.device) * (2 * math.pi / beams)
        ends = seen["lidar"].unsqueeze(-1) * direction_of(angle)
        place = torch.cat((place, ends), dim=-2)
        move = torch.cat((move, torch.zeros_like(ends)), dim=-2)
        radius = torch.cat((radius, torch.zeros_like(ends[..., :1])), dim=-2)
        spare = torch.cat((spare, torch.full_like(ends[..., :1], WALL_SPARE)), dim=-2)
        mask = torch.cat((mask, torch.ones_like(seen["lidar"], dtype=torch.bool)), dim=-1)
    axis = way.unsqueeze(-2).expand_as(place)
    place, move = unrotate(place, axis).unsqueeze(-3), unrotate(move, axis).unsqueeze(-3)
    move = move - velocity.unsqueeze(-2)
    square = move.square().sum(-1).clamp_min(1e-9)
    nearest = -(place * move).sum(-1) / square
    least = place.square().sum(-1) - nearest.square() * square
    bodies = (radius[..., 0] + seen["radius"]).unsqueeze(-2)
    result = []
    for step in range(HORIZON):
        at = nearest.clamp(step * STEP, (step + 1) * STEP)
        apart = (least + (at - nearest).square() * square).clamp_min(0).sqrt() - bodies
        apart = torch.where(apart > 0, apart + spare[..., 0].unsqueeze(-2), apart)
        result.append(apart.masked_fill(~mask.unsqueeze(-2), torch.inf).amin(-1))
    return torch.stack(result, dim=-1)
