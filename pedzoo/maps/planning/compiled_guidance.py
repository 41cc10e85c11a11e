"""The planner's compiled loop: tensors on the CPU become arrays without a copy."""

import torch
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import EPSILON, Guidance
from pedzoo.maps.planning.waypoint_table import WaypointTable


def guidance_compiled(
    bank: MapBank,
    table: WaypointTable,
    points: Tensor,
    goal_id: Tensor,
    row: Tensor,
    pose: Tensor,
    pref_speed: Tensor,
    seconds: float,
) -> Guidance:
    """Return what `Planner.guidance` does."""
    from pedzoo.maps.planning.compiled_sight import guidance_loop

    carrot, desired, waypoint, goal = (torch.empty(*goal_id.shape, 2) for _ in range(4))
    made = Guidance(carrot, desired, waypoint, goal, torch.empty(goal_id.shape))
    given = (points.float(), goal_id, row, pose.float(), pref_speed.float())
    guidance_loop(
        *(value.detach().numpy() for value in given),
        seconds,
        *table.arrays,
        *bank.walls.map_arrays,
        *(value.numpy() for value in made),
    )
    if torch.is_grad_enabled() and (points.requires_grad or pref_speed.requires_grad):
        return _differentiable(made, points, pref_speed, seconds)
    return made


def _differentiable(made: Guidance, points: Tensor, pref_speed: Tensor, seconds: float) -> Guidance:
    """Return the same guidance as a function of points and speeds; waypoints are constants."""
    way = made.waypoint - points
    length = way.square().sum(-1, keepdim=True).clamp_min(EPSILON**2).sqrt()
    there = length.detach() <= EPSILON
    speed, ahead = pref_speed.unsqueeze(-1), pref_speed.unsqueeze(-1) * seconds
    beyond = made.desired_velocity / speed.detach()
    unit = torch.where(there, beyond, way / length)
    carrot = torch.where(length.detach() >= ahead.detach(), points + unit * ahead, made.goal)
    distance = made.distance + (length - length.detach())[..., 0]
    return Guidance(carrot, unit * speed, made.waypoint, made.goal_point, distance)
