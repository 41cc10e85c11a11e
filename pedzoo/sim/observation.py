"""Observations of agents: the scene batch of a state, its specs, and recorded windows as states."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn import functional as F
from torchrl.data import Categorical, Composite, NonTensor, Unbounded
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core.batch import agents_of, maps_of, scene_batch
from pedzoo.core.types import OBS_LEN
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP, State

_NUMBERS = ("heading", "pref_speed", "top_speed", "radius", "goal_since")
"""What states and observations have of every agent, (B, A) and (B, A, 1)."""


def observed(state: State, guidance: Guidance, maps: MapBank) -> TensorDict:
    """Return the scene batch (B,) of a state and its guidance: all that a policy decides from."""
    return scene_batch(
        maps=maps,
        map_id=state.map_id.unsqueeze(1),
        pose=state.pose,
        history=state.history,
        valid=state.valid,
        mask=state.mask,
        velocity=state.velocity,
        kind=state.kind,
        group=state.group,
        goal=guidance.goal,
        desired_velocity=guidance.desired_velocity,
        remaining_path=guidance.distance.unsqueeze(-1),
        **{name: getattr(state, name).unsqueeze(-1) for name in _NUMBERS},
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
    history, scene = agents["history"], torch.zeros_like(batch["map_id"][:, 0])
    frame, place = maps_of(batch).walls_of_scenes(scene - 1, batch["scene_pose"])
    numbers = {name: agents[name][..., 0] for name in ("heading", "radius")}
    return State.of(
        dense(history),
        agents["mask"],
        agents["pref_speed"][..., 0],
        **numbers,
        **{name: agents[name] for name in ("velocity", "kind", "group")},
        key=key,
        map_id=batch["map_id"][:, 0],
        row=scene - 1,
        wall_frame=frame,
        wall_place=place,
        pose=batch["scene_pose"],
        controlled=controlled,
        observed_points=(agents["valid"].sum(2) - 1) * TRACE_PER_STEP + 1,
        later_goals=torch.full_like(agents["kind"], -1).unsqueeze(2),
        goal_point=destination,
        remaining_path=(destination - history[:, :, -1]).norm(dim=-1),
    )


def observation_spec(scenes: int, agents: int, trace_points: int, maps: MapBank) -> Composite:
    """Return the spec of observations of B scenes, A people and S trace points per decision on ``maps``."""
    b, ba = (scenes,), (scenes, agents)
    bas = *ba, trace_points
    info = {"trace": real(*bas, 2), "agent_contact": flag(*bas), "wall_contact": flag(*bas)}
    info |= {"reached": whole(*bas), "overdue": flag(*ba), "remaining_path": real(*ba)}
    people = {name: real(*ba, 2) for name in ("velocity", "goal", "desired_velocity")}
    people |= {name: real(*ba, 1) for name in (*_NUMBERS, "remaining_path")}
    people |= {name: whole(*ba) for name in ("id", "kind", "group")}
    people |= {name: flag(*ba) for name in ("mask", "controlled")}
    people |= {"history": real(*ba, OBS_LEN, 2), "valid": flag(*ba, OBS_LEN)}
    return Composite(
        agents=Composite(people | {"info": Composite(info, shape=ba)}, shape=ba),
        maps=NonTensor(shape=torch.Size(b), example_data=maps),
        map_id=whole(*b, 1),
        scene_pose=real(*b, 4),
        scene_key=whole(*b, 1),
        time=real(*b, 1),
        failed=flag(*b, 1),
        shape=b,
    )


def done_spec(scenes: int) -> Composite:
    """Return the spec of the ends of scenes."""
    ends = dict.fromkeys(("done", "terminated", "truncated"), flag(scenes, 1))
    return Composite(ends, shape=(scenes,))


def real(*shape: int) -> TensorSpec:
    """Return the spec of real numbers."""
    return Unbounded(shape=torch.Size(shape), dtype=torch.float32)


def whole(*shape: int) -> TensorSpec:
    """Return the spec of whole numbers."""
    return Unbounded(shape=torch.Size(shape), dtype=torch.int64)


def flag(*shape: int) -> TensorSpec:
    """Return the spec of truth values."""
    return Categorical(2, shape=torch.Size(shape), dtype=torch.bool)
