"""The planner's compiled loop: tensors on the CPU become arrays without a copy."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.carrot import BODY_CLEARANCE
from pedzoo.maps.guidance import Guidance
from pedzoo.maps.tables import Tables


def guide_compiled(
    bank: MapBank,
    tables: Tables,
    points: Tensor,
    goal_id: Tensor,
    row: Tensor,
    pose: Tensor,
    pref_speed: Tensor,
    seconds: float,
) -> Guidance:
    """Return what `Planner.guide_scenes` does."""
    from pedzoo.maps.compiled import guide

    carrot, desired, waypoint, goal = (torch.empty(*goal_id.shape, 2) for _ in range(4))
    made = Guidance(carrot, desired, waypoint, goal, torch.empty(goal_id.shape))
    given = (points.float(), goal_id, row, pose.float(), pref_speed.float())
    guide(
        *(value.detach().numpy() for value in given),
        seconds,
        BODY_CLEARANCE,
        *tables.arrays,
        *bank.map_arrays,
        *(value.numpy() for value in made),
    )
    return made
