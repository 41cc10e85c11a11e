"""Baseline: the social force model (Helbing and Molnar, Phys. Rev. E 51, 1995), walls or not."""

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, agents_of, ids_of, is_person_sized, maps_of
from pedzoo.core.geometry import move_to_map, turn_to_scene
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.policies.base import deterministic
from pedzoo.policies.policy import Policy, drawn_vectors
from pedzoo.policies.social_force.borders import wall_points
from pedzoo.policies.social_force.forces import closer, wall_force
from pedzoo.policies.social_force.settings import SocialForceSettings
from pedzoo.policies.social_force.velocity import social_force_velocity


class SocialForce(Policy):
    """People accelerate along the planner's path, away from each other and away from walls.

    `SocialForceSettings` has symbols, units and sources of all parameters. Those of 1995, the default, are
    for open places and wide corridors: at 1.3 m/s a person does not get through a door narrower than 1.1 m.
    The preset ``indoor`` has softer walls. Forces have no memory and no foresight: where they cancel, people
    stop.
    """

    def __init__(self, settings: SocialForceSettings = SocialForceSettings()) -> None:
        """Take the settings."""
        super().__init__(settings.dt)
        self.settings = settings

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's velocity."""
        agents: Any = tensordict["agents"]
        mask, ids = agents["mask"], ids_of(tensordict)
        identity = randomness.join(tensordict["scene_key"], "social_force", ids)
        fluctuation = None
        if self.settings.fluctuation and not deterministic():
            step = (tensordict["time"] / TRACE_SECONDS).round().long()
            noise = drawn_vectors(tensordict, randomness.join(identity, step))
            fluctuation = self.settings.fluctuation * noise
        tensordict["agents", "action"] = social_force_velocity(
            agents["history"][:, :, -1],
            agents["velocity"],
            agents["desired_velocity"],
            agents["pref_speed"][..., 0],
            mask,
            self.settings,
            self.decision_dt,
            identity,
            self._walls(tensordict) if self.settings.walls else None,
            fluctuation,
            self._radius(agents),
        )
        return tensordict

    def _radius(self, agents: Any) -> Tensor:
        """Return the radii (B, A) that the others' forces see, metres.

        People who both give way stop some way into each other's potential, which begins at the centre. The
        potential of a body that gives no way begins at its surface.
        """
        radius = agents["radius"][..., 0]
        gives_no_way = ~agents["controlled"] & ((agents["kind"] == ROBOT) | ~is_person_sized(radius))
        return torch.where(gives_no_way, radius + 2 * BODY_RADIUS, radius)

    def _walls(self, tensordict: TensorDictBase) -> Callable[[Tensor, Tensor | None], Tensor]:
        """Return the walls' forces (2, N): a function of places (2, N) and rows (N,) of B * A people."""
        bank, settings = maps_of(tensordict), self.settings
        radius = cast("Tensor", agents_of(tensordict)["radius"])
        poses, ids = cast("Tensor", tensordict["scene_pose"]), cast("Tensor", tensordict["map_id"])
        wider, pose = radius.flatten() - BODY_RADIUS, poses.repeat_interleave(radius.shape[1], 0)
        row = bank.index(ids.flatten()).repeat_interleave(radius.shape[1])

        def force(place: Tensor, rows: Tensor | None) -> Tensor:
            mine = [part if rows is None else part.index_select(0, rows) for part in (pose, row, wider)]
            table = bank.walls.segments(settings.wall_reach, hollows=False, dtype=place.dtype)
            points = wall_points(table, move_to_map(place.T, mine[0]).T.contiguous(), mine[1])
            offset = closer(points.offset, mine[2])
            total = wall_force(offset, points.weight, settings.wall_strength, settings.wall_range)
            return turn_to_scene(total.T, mine[0]).T

        return force
