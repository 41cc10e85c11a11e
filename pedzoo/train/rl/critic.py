"""The critic of reinforcement learning: the reward that each person can still expect."""

import math
from typing import Any, ClassVar, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of, maps_of
from pedzoo.core.geometry import direction_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.models.blocks.people import ego_frame
from pedzoo.models.blocks.people.approach import RelativePooling
from pedzoo.models.blocks.people.crowd import Crowd

_RING = 8
"""Directions in which walls are looked for."""

_RADIUS = 0.5
"""Metres at which they are."""

_FAR = 1.0
"""Metres: farther walls are all alike."""


class Critic(TensorDictModuleBase):
    """One decentralised network for all people: each person's value from their surroundings.

    In each person's own frame it sees their velocity, goal and desired velocity, others relative to them
    (`RelativePooling`), the distance to walls here and on a ring, and the length of the remaining path,
    which the policy does not see. Untrained it gives the reward of a person alone who walks that path at the
    preferred speed: the first updates already show which people were held up.
    """

    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose"]
    out_keys: ClassVar[list[Any]] = [("agents", "value")]

    def __init__(self, gamma: float, hidden_dim: int = 64, pool_dim: int = 32) -> None:
        """Create the parameters; ``gamma`` is the discount of a decision of 0.4 s."""
        super().__init__()
        self.gamma = gamma
        self.others = RelativePooling(hidden_dim, pool_dim)
        seen = 3 * 2 + 3 + 1 + _RING  # vectors; speed and way; walls
        self.net = nn.Sequential(
            nn.Linear(seen + pool_dim, hidden_dim),
            nn.Tanh(),
            nn.Linear(hidden_dim, hidden_dim),
            nn.Tanh(),
            nn.Linear(hidden_dim, 1),
        )
        last = cast("nn.Linear", self.net[-1])
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        angle = torch.arange(_RING) * (2 * math.pi / _RING)
        ring = torch.cat((torch.zeros(1, 2), _RADIUS * direction_of(angle)))
        self.register_buffer("ring", ring, persistent=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's value (N, A, 1), metres of progress; 0 where no person is."""
        batch = cast("TensorDict", tensordict)
        agents = agents_of(batch)
        crowd = Crowd.of(agents["mask"])
        history, speed = crowd.pack(agents["history"]), crowd.pack(agents["pref_speed"])
        position, moved = history[:, -1], history.diff(dim=1)
        goal = crowd.pack(agents["goal"]) - position
        way = crowd.pack(agents["info", "remaining_path"]).unsqueeze(-1)
        frame = ego_frame.heading(moved, goal)
        vectors = torch.stack(
            (crowd.pack(agents["velocity"]), crowd.pack(agents["desired_velocity"]), goal / 4.0), 1
        )
        alone = self.alone(way, speed)
        features = (
            geometry.unrotate(vectors, frame.unsqueeze(1)).flatten(1),
            speed,
            way / 10.0,
            alone,
            self._walls(position, frame, batch, crowd),
            self.others(position, moved[:, -1], frame, crowd),
        )
        value = alone + self.net(torch.cat(features, -1))
        tensordict["agents", "value"] = crowd.unpack(value)
        return tensordict

    def alone(self, way: Tensor, speed: Tensor) -> Tensor:
        """Return the discounted reward, metres, of walking ``way`` (P, 1), metres, at ``speed`` (P, 1)."""
        step = STEP_SECONDS * speed.clamp_min(0.1)
        if self.gamma == 1:
            return way
        return step * (1 - self.gamma ** (way / step)) / (1 - self.gamma)

    def _walls(self, position: Tensor, frame: Tensor, batch: TensorDict, crowd: Crowd) -> Tensor:
        """Return the distances (P, 1 + 8) to walls at a person and around, in their frame."""
        around = geometry.rotate(self.get_buffer("ring"), frame.unsqueeze(1))
        points = position.unsqueeze(1) + around
        map_id, pose = batch["map_id"][crowd.scene, 0], batch["scene_pose"][crowd.scene]
        return maps_of(batch).signed_distance(points, map_id, pose).clamp(-_FAR, _FAR) / _FAR
