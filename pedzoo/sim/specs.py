"""What a `PedestrianEnv` promises about the shapes and types of its keys."""

from __future__ import annotations

import torch
from torchrl.data import Categorical, Composite, NonTensor, Unbounded
from torchrl.data.tensor_specs import TensorSpec

from pedzoo.core.types import OBS_LEN
from pedzoo.maps.bank import MapBank


def observation(scenes: int, agents: int, trace_points: int, maps: MapBank) -> Composite:
    """Return the spec of observations of B scenes, A people and S trace points per decision on ``maps``."""
    b, ba = (scenes,), (scenes, agents)
    info = Composite(
        trace=real(*ba, trace_points, 2),
        agent_contact=flag(*ba, trace_points),
        wall_contact=flag(*ba, trace_points),
        reached=whole(*ba, trace_points),
        overdue=flag(*ba),
        remaining_path=real(*ba),
        shape=ba,
    )
    people = Composite(
        id=whole(*ba),
        history=real(*ba, OBS_LEN, 2),
        valid=flag(*ba, OBS_LEN),
        velocity=real(*ba, 2),
        heading=real(*ba, 1),
        radius=real(*ba, 1),
        kind=whole(*ba),
        pref_speed=real(*ba, 1),
        goal=real(*ba, 2),
        desired_velocity=real(*ba, 2),
        mask=flag(*ba),
        controlled=flag(*ba),
        info=info,
        shape=ba,
    )
    return Composite(
        agents=people,
        maps=NonTensor(shape=torch.Size(b), example_data=maps),
        map_id=whole(*b, 1),
        scene_pose=real(*b, 4),
        scene_key=whole(*b, 1),
        time=real(*b, 1),
        failed=flag(*b, 1),
        shape=b,
    )


def action(scenes: int, agents: int) -> Composite:
    """Return the spec of actions: velocities in m/s. The dynamics shorten them to the agents' top speeds."""
    people = Composite(action=real(scenes, agents, 2), shape=(scenes, agents))
    return Composite(agents=people, shape=(scenes,))


def reward(scenes: int, agents: int) -> Composite:
    """Return the spec of the agents' rewards."""
    people = Composite(reward=real(scenes, agents, 1), shape=(scenes, agents))
    return Composite(agents=people, shape=(scenes,))


def done(scenes: int) -> Composite:
    """Return the spec of the ends of scenes."""
    names = ("done", "terminated", "truncated")
    return Composite({name: flag(scenes, 1) for name in names}, shape=(scenes,))


def real(*shape: int) -> TensorSpec:
    """Return the spec of real numbers."""
    return Unbounded(shape=torch.Size(shape), dtype=torch.float32)


def whole(*shape: int) -> TensorSpec:
    """Return the spec of whole numbers."""
    return Unbounded(shape=torch.Size(shape), dtype=torch.int64)


def flag(*shape: int) -> TensorSpec:
    """Return the spec of truth values."""
    return Categorical(2, shape=torch.Size(shape), dtype=torch.bool)
