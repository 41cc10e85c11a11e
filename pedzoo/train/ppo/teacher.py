"""Teachers for the first updates: any robot's policy, or the best of some constant velocities."""

import math
from collections.abc import Callable
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import pad

from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.geometry import direction_of, unrotate
from pedzoo.policies.load import load_robot_policy
from pedzoo.policies.robots._base import bodies_of
from pedzoo.policies.robots.attention import TURN_GAIN, as_decision, frame_of

DIRECTIONS, SPEEDS, HORIZON, STEP = 24, 3, 12, 0.25
"""How many are tried, and for how many steps of so many seconds."""

WALL_SPARE = 0.2
"""Metres by which the margin to a wall is less than that to people."""

MARGIN, MARGIN_COST, COLLISION_COST, DISCOUNT = 0.25, 4.0, 10.0, 0.97
"""Metres to keep from others, what a metre too near costs for a second, a contact, and the next step."""

CONSTANT_VELOCITY = "constant_velocity"
"""The name of the teacher that knows no more than the robot senses."""

Teacher = Callable[[TensorDictBase], Tensor]
"""Returns decisions (B, R, 2) for scenes, see `pedzoo.policies.robots.attention.Attention.mean`."""


def teacher_of(name: str) -> Teacher:
    """Return the teacher `CONSTANT_VELOCITY`, or a policy by `load_robot_policy`; errors as there."""
    if name == CONSTANT_VELOCITY:
        return taught
    policy = load_robot_policy(name)

    def decision(scenes: TensorDictBase) -> Tensor:
        bodies = bodies_of(scenes)
        return as_decision(policy.action(scenes), frame_of(scenes, bodies), bodies)

    return decision


@torch.no_grad()
def taught(scenes: TensorDictBase) -> Tensor:
    """Return the decisions (..., R, 2) of the best of some constant velocities, by what the robot senses.

    Where the lidar's beams end it sees points that stand. Robots on wheels turn towards the velocity.
    """
    bodies = bodies_of(scenes)
    seen = cast("TensorDictBase", scenes["robots", "observation"])
    way = seen["waypoint"]
    left = torch.linalg.vector_norm(way, dim=-1)
    way = way / left.clamp_min(1e-6).unsqueeze(-1)
    # shares of the top speed (S, 2) of a robot that looks along its way, standing last
    turn = direction_of(torch.arange(DIRECTIONS, device=way.device) * (2 * math.pi / DIRECTIONS))
    share = torch.arange(SPEEDS, 0, -1, device=way.device) / SPEEDS
    own = pad((turn[:, None] * share[:, None]).flatten(0, 1), (0, 0, 0, 1))
    score = _worth(seen, own * bodies.top_speed[..., None, None], way, left.clamp_min(0.3))
    best = own[score.argmax(-1)]
    ahead = way[..., 1].atan2(way[..., 0]) + best[..., 1].atan2(best[..., 0])
    speed = torch.linalg.vector_norm(best, dim=-1)
    off = torch.where(speed > 0, torch.remainder(ahead + math.pi, 2 * math.pi) - math.pi, 0.0)
    rate = (TURN_GAIN * off / bodies.top_turn).clamp(-1, 1)
    wheels = torch.stack((speed * off.cos().clamp_min(0), rate), dim=-1)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), best, wheels)


def _worth(seen: TensorDictBase, velocity: Tensor, way: Tensor, left: Tensor) -> Tensor:
    """Return what velocities (..., S, 2) are worth (..., S): the way saved, less what is too near."""
    gap = _gap(seen, velocity, way)
    steps = torch.arange(HORIZON + 1, device=way.device) * STEP
    goal = torch.stack((left, torch.zeros_like(left)), dim=-1)[..., None, None, :]
    rest = torch.linalg.vector_norm(goal - velocity.unsqueeze(-2) * steps[:, None], dim=-1)
    touched, there = gap < 0, rest[..., 1:] < 0.3
    going = pad((touched | there).long().cumsum(-1)[..., :-1], (1, 0)) == 0
    close = (MARGIN - gap).clamp(0, MARGIN)
    worth = rest[..., :-1] - rest[..., 1:] - MARGIN_COST * STEP * close
    worth = torch.where(touched, -COLLISION_COST, worth)
    return (worth * going * DISCOUNT ** torch.arange(HORIZON, device=way.device)).sum(-1)


def _gap(seen: TensorDictBase, velocity: Tensor, way: Tensor) -> Tensor:
    """Return the least distances of bodies in each step (..., S, H), metres."""
    mask, people = seen["people_mask"], cast("Tensor", seen["people"])
    spare = torch.zeros_like(people[..., 0])
    if "lidar" in seen.keys():
        lidar = cast("Tensor", seen["lidar"])
        beams = lidar.shape[-1]
        ends = direction_of(torch.arange(beams, device=way.device) * (2 * math.pi / beams))
        people = torch.cat((people, pad(lidar.unsqueeze(-1) * ends, (0, 3))), dim=-2)
        spare = torch.cat((spare, torch.full_like(lidar, WALL_SPARE)), dim=-1)
        mask = torch.cat((mask, torch.ones_like(lidar, dtype=torch.bool)), dim=-1)
    place, move, radius = people.split([2, 2, 1], dim=-1)
    axis = way.unsqueeze(-2).expand_as(place)
    place, move = (unrotate(value, axis).unsqueeze(-3) for value in (place, move))
    move = move - velocity.unsqueeze(-2)
    square = move.square().sum(-1).clamp_min(1e-9)
    nearest = -(place * move).sum(-1) / square
    least = place.square().sum(-1) - nearest.square() * square
    bodies = (radius[..., 0] + seen["radius"]).unsqueeze(-2)
    result = []
    for step in range(HORIZON):
        at = nearest.clamp(step * STEP, (step + 1) * STEP)
        apart = (least + (at - nearest).square() * square).clamp_min(0).sqrt() - bodies
        apart = torch.where(apart > 0, apart + spare.unsqueeze(-2), apart)
        result.append(apart.masked_fill(~mask.unsqueeze(-2), torch.inf).amin(-1))
    return torch.stack(result, dim=-1)
