"""How an episode gets its first 8 observed steps: rolled with ORCA, standing still, or recorded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional as F

from pedzoo.batch import ROBOT
from pedzoo.errors import UserError
from pedzoo.geometry import limit_speed
from pedzoo.maps.planner import Planner
from pedzoo.maps.segments import WallSegments
from pedzoo.sim.dynamics import walk
from pedzoo.sim.orca.settings import OrcaSettings
from pedzoo.sim.orca.velocity import orca_velocity
from pedzoo.sim.scenario import Layout
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP
from pedzoo.types import OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO

WarmStart = Literal["orca", "static", "recorded"]

ORCA = OrcaSettings(radius=0.2, time_step=STEP_SECONDS, max_obstacles=8)
"""The same for every row of a table, whatever walks afterwards."""


@torch.no_grad()
def rolled(
    layout: Layout,
    pose: Tensor,
    planner: Planner,
    walls: WallSegments,
    substeps: int,
    body_radius: float,
    renew: Callable[[Tensor, Tensor], Tensor],
) -> tuple[Tensor, Tensor]:
    """Return the first positions (B, A, 29, 2) of people who walk with ORCA, and their goals then (B, A).

    Args:
        layout: Where they start.
        pose: Scene poses (B, 4).
        planner: Ways to goals.
        walls: Walls for ORCA.
        substeps: Per 0.1 s.
        body_radius: Of a person, metres.
        renew: Gives goals (B, A) to people at positions (B, A, 2) who have goals (B, A): a goal that is
            passed already is replaced.
    """
    position, goal = layout.start, layout.goal
    velocity: Tensor | None = None
    top_speed = layout.pref_speed * TOP_SPEED_RATIO
    walks = torch.ones_like(layout.mask) if layout.stand is None else layout.stand <= 0
    radius = None
    if layout.radius is not None:
        robot = torch.zeros_like(layout.mask) if layout.kind is None else layout.kind == ROBOT
        radius = ORCA.radii(layout.radius, robot, layout.mask)
    scenes, agents = goal.shape
    map_id, poses = layout.map_id.repeat_interleave(agents), pose.repeat_interleave(agents, 0)
    surroundings = planner.bank.walls_of_people(layout.map_id, pose, agents)
    trace = [position.unsqueeze(2)]
    for _ in range(OBS_LEN - 1):
        direction = planner.direction(position.flatten(0, 1), goal.flatten(), map_id, poses)
        wanted = direction.view(scenes, agents, 2) * (layout.pref_speed * walks).unsqueeze(2)
        if velocity is None:  # people are on their way already
            velocity = wanted
        near = walls.near(position.flatten(0, 1), map_id, poses, ORCA.wall_reach(top_speed, radius).flatten())
        action = orca_velocity(position, velocity, wanted, top_speed, layout.mask, ORCA, near, None, radius)
        action = limit_speed(action, top_speed) * walks.unsqueeze(2)
        steps = TRACE_PER_STEP * substeps
        path = walk(position, action, STEP_SECONDS, steps, surroundings, body_radius)
        path = path[:, :, substeps - 1 :: substeps]
        velocity, position = (path[:, :, -1] - position) / STEP_SECONDS, path[:, :, -1]
        goal = renew(path, goal)
        trace.append(path)
    return torch.cat(trace, dim=2), goal


def standing(layout: Layout) -> Tensor:
    """Return the first positions (B, A, 29, 2) of people who have stood still."""
    return layout.start.unsqueeze(2).expand(-1, -1, PAST_LEN, -1).clone()


def recorded(layout: Layout) -> Tensor:
    """Return recorded positions every 0.1 s (B, A, 29, 2), linearly between those every 0.4 s.

    Raises:
        UserError: The scenario has none.
    """
    if layout.history is None:
        raise UserError("warm_start recorded: this scenario has no recorded histories; use orca or static")
    planes = layout.history.flatten(0, 1).transpose(1, 2)
    dense = F.interpolate(planes, size=PAST_LEN, mode="linear", align_corners=True)
    return dense.transpose(1, 2).view(*layout.history.shape[:2], PAST_LEN, 2)
