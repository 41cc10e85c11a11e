"""How an episode gets its first 8 observed steps: rolled with ORCA, standing still, or recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.maps.bank import WallSegments
from pedzoo.policies.rule_based.orca import OrcaSettings, orca_velocity
from pedzoo.sim import kernel
from pedzoo.sim.observation import dense
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.rules import Rules
from pedzoo.sim.scenario import Layout
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP, State

WarmStart = Literal["orca", "static", "recorded"]

ORCA = OrcaSettings(radius=0.2, dt=STEP_SECONDS, max_obstacles=8)
"""The same for every row of a table and every policy."""


@torch.no_grad()
def rolled(state: State, physics: Physics, rules: Rules, walls: WallSegments) -> State:
    """Return the state after 7 steps with ORCA of people who begin to walk; reached goals are renewed.

    Robots, agents with wheels and agents that stand or wait where they start stay in place. The time
    of standing starts afterwards.

    Args:
        state: All agents where they start.
        physics: Moves them.
        rules: Of the scenes.
        walls: Walls for ORCA.
    """
    rules = replace(rules, ticks=TRACE_PER_STEP, leave=False, keep_goal=True, script=None, waits=None)
    agents, controlled, stands = state.mask.shape[1], state.controlled, state.stands
    walks = controlled & (stands <= 0) & (state.drive == HOLONOMIC) & (state.kind != ROBOT)
    state = state._replace(controlled=walks, stands=torch.zeros_like(stands))
    map_id, poses = state.map_id.repeat_interleave(agents), state.pose.repeat_interleave(agents, 0)
    guidance = rules.guidance(state)
    # people are on their way already
    velocity = torch.where(walks.unsqueeze(2), guidance.desired_velocity, 0.0)
    state, top_speed = state._replace(velocity=velocity, goal_point=guidance.goal_point), state.top_speed
    radius = ORCA.radii(state.radius, state.kind == ROBOT, state.controlled)
    for _ in range(OBS_LEN - 1):
        reach = ORCA.wall_reach(top_speed, radius).flatten()
        near = walls.near(state.position.flatten(0, 1), map_id, poses, reach)
        wanted = torch.where(walks.unsqueeze(2), guidance.desired_velocity, 0.0)
        action = orca_velocity(
            state.position, state.velocity, wanted, top_speed, state.mask, ORCA, near, None, radius
        )
        before = state.position
        state, guidance, _ = kernel.step(state, action, physics, rules)
        state = state._replace(velocity=(state.position - before) / STEP_SECONDS)
    return state._replace(controlled=controlled, stands=stands)


def standing(start: Tensor) -> Tensor:
    """Return the first positions (B, A, 29, 2) of people who have stood still at ``start`` (B, A, 2)."""
    return start.unsqueeze(2).expand(-1, -1, PAST_LEN, -1).clone()


def recorded(layout: Layout) -> Tensor:
    """Return recorded positions every 0.1 s (B, A, 29, 2), linearly between those every 0.4 s.

    Raises:
        UserError: The scenario has none.
    """
    if layout.history is None:
        raise UserError("warm_start recorded: this scenario has no recorded histories; use orca or static")
    return dense(layout.history)
