"""What agents see of their scenes: from a state to the scene batch, and from recorded windows to a state."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn import functional as F

from pedzoo.core.batch import agents_of, maps_of, scene_batch
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP, State


def observed(state: State, guidance: Guidance, maps: MapBank) -> TensorDict:
    """Return the scene batch (B,) of a state: every policy decides from it, wherever its agents walk.

    Args:
        state: The scenes.
        guidance: What the planner says to their agents.
        maps: The floor plans of their ``map_id``.
    """
    return scene_batch(
        maps=maps,
        map_id=state.map_id.unsqueeze(1),
        pose=state.pose,
        history=state.history,
        valid=state.valid,
        mask=state.mask,
        velocity=state.velocity,
        heading=state.heading.unsqueeze(-1),
        pref_speed=state.pref_speed.unsqueeze(-1),
        radius=state.radius.unsqueeze(-1),
        kind=state.kind,
        goal=guidance.goal,
        desired_velocity=guidance.desired_velocity,
        controlled=state.decides & ~state.failed.unsqueeze(1),
        id=state.person,
        key=state.key.unsqueeze(1),
        time=state.clock.unsqueeze(1),
    )


def dense(history: Tensor) -> Tensor:
    """Return positions every 0.1 s (B, A, 29, 2), linearly between those every 0.4 s (B, A, 8, 2)."""
    planes = history.flatten(0, 1).transpose(1, 2)
    between = F.interpolate(planes, size=PAST_LEN, mode="linear", align_corners=True)
    return between.transpose(1, 2).view(*history.shape[:2], PAST_LEN, 2)


def state_of(batch: TensorDict, destination: Tensor, controlled: Tensor, key: Tensor) -> State:
    """Return recorded windows as scenes that go on from where they end, in the open and without floor plans.

    Args:
        batch: Recorded windows (B,).
        destination: Where agents go (B, A, 2), metres: the goal, number 0.
        controlled: Which agents a policy moves from here on (B, A) bool.
        key: Keys of the scenes' draws (B,) long.
    """
    agents = agents_of(batch)
    history, mask = agents["history"], agents["mask"]
    none = torch.zeros_like(agents["kind"])
    frame, place = maps_of(batch).walls_of_scenes(none[:, 0] - 1, batch["scene_pose"])
    slots = torch.arange(mask.shape[1], device=mask.device).expand(mask.shape)
    return State.of(
        dense(history),
        mask,
        agents["pref_speed"][..., 0],
        key=key,
        map_id=batch["map_id"][:, 0],
        row=none[:, 0] - 1,
        wall_frame=frame,
        wall_place=place,
        pose=batch["scene_pose"],
        scene=none[:, 0],
        controlled=controlled,
        person=slots.where(mask, -1),
        observed_points=(agents["valid"].sum(2) - 1) * TRACE_PER_STEP + 1,
        velocity=agents["velocity"],
        heading=agents["heading"][..., 0],
        radius=agents["radius"][..., 0],
        kind=agents["kind"],
        goal_id=none,
        later_goals=torch.full_like(none, -1).unsqueeze(2),
        goal_point=destination,
        remaining_path=(destination - history[:, :, -1]).norm(dim=-1),
    )
