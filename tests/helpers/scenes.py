"""Scene batches of agents who have come straight to where they are, and scenarios that tests share."""

from functools import lru_cache
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from pedzoo.core.batch import scene_batch
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.policies.policy import Policy
from pedzoo.sim.make import prepare_scenario
from pedzoo.sim.scenario import PreparedScenario


@lru_cache(maxsize=24)
def prepared(name: str) -> PreparedScenario:
    """Return a scenario with its floor plans and ways, which take time to find."""
    return prepare_scenario(name)


def scene(
    position: Any,
    velocity: Any,
    desired: Any,
    radius: Any = None,
    kind: Any = None,
    controlled: Any = None,
    maps: MapBank | None = None,
    pref_speed: Any = None,
) -> TensorDict:
    """Return scenes (B, A) of agents who have come straight to where they are.

    None stands for 1.3 m/s as the speed that they like.
    """
    position, velocity, desired = (
        torch.as_tensor(values, dtype=torch.float32) for values in (position, velocity, desired)
    )
    if position.dim() == 2:
        position, velocity, desired = position[None], velocity[None], desired[None]
    there = torch.ones(position.shape[:2], dtype=torch.bool)
    ago = 0.4 * torch.arange(7.0, -1.0, -1.0).view(8, 1)
    bank = MapBank() if maps is None else maps
    map_id = bank.grids[0].map_id if bank.grids else -1
    return scene_batch(
        maps=bank,
        map_id=torch.full((len(there), 1), map_id),
        pose=identity_pose(len(there)),
        history=position.unsqueeze(2) - ago * velocity.unsqueeze(2),
        valid=there.unsqueeze(2).expand(-1, -1, 8),
        mask=there,
        velocity=velocity,
        pref_speed=torch.full((*there.shape, 1), pref_speed or 1.3),
        radius=None if radius is None else torch.as_tensor(radius).expand(there.shape).unsqueeze(-1),
        kind=None if kind is None else torch.as_tensor(kind).expand(there.shape),
        goal=position + 3.2 * desired,
        desired_velocity=desired,
        controlled=None if controlled is None else torch.as_tensor(controlled).expand(there.shape),
        key=torch.zeros(len(there), 1, dtype=torch.long),
        time=torch.zeros(len(there), 1),
    )


class Watch(Policy):
    """Walks straight to the goal, at a factor of the desired velocity, and keeps what it saw."""

    def __init__(self, dt: float = 0.4, factor: float = 1.0) -> None:
        super().__init__(dt)
        self.factor = factor
        self.seen: list[Any] = []

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.seen.append(tensordict.clone())
        tensordict["agents", "action"] = tensordict["agents", "desired_velocity"] * self.factor
        return tensordict
