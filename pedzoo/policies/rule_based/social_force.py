"""Baseline: the social force model (Helbing and Molnar, Phys. Rev. E 51, 1995), walls or not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, agents_of, ids_of, maps_of, usual_body
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import move_to_map, turn_to_scene
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.policies.policy import Policy
from pedzoo.policies.social_force.borders import wall_points
from pedzoo.policies.social_force.forces import closer, wall_force
from pedzoo.policies.social_force.settings import Anisotropy, SocialForceSettings
from pedzoo.policies.social_force.velocity import social_force_velocity


class SocialForce(Policy):
    """People accelerate along the planner's way, away from each other and away from walls.

    `SocialForceSettings` has symbols, units and sources of all parameters. Those of 1995, the default, are
    for open places and wide corridors: their walls push so hard that somebody who walks at 1.3 m/s does not
    get through a door narrower than 1.1 m. The preset ``indoor`` has softer walls. Nothing is remembered from
    one decision to the next, and forces know no future: where they cancel, people stop.
    """

    def __init__(
        self,
        tau: float | None = None,
        walls: bool = True,
        dt: float = TRACE_SECONDS,
        preset: str = "1995",
        strength: float | None = None,
        sigma: float | None = None,
        step_time: float | None = None,
        wall_strength: float | None = None,
        wall_range: float | None = None,
        anisotropy: Anisotropy | None = None,
        view_angle: float | None = None,
        out_of_view: float | None = None,
        behind: float | None = None,
        top_speed_ratio: float | None = None,
        neighbor_dist: float | None = None,
        max_neighbors: int | None = None,
        fluctuation: float | None = None,
    ) -> None:
        """Set the parameters; what is not given is the preset's.

        Args:
            tau: Relaxation time, seconds.
            walls: Whether walls are avoided.
            dt: Seconds between decisions, at most ``tau``; forces are integrated in steps of 0.1 s or less.
            preset: ``1995`` for the paper's parameters, ``indoor`` for doors.
            strength: Of the potential around people (V0), m^2/s^2.
            sigma: Its range, metres.
            step_time: How far ahead of a walking person it reaches (Delta t), seconds of their way.
            wall_strength: Of the potential of walls (U0), m^2/s^2.
            wall_range: Its range (R), metres.
            anisotropy: How much less what is behind counts: ``view``, ``smooth`` or ``none``.
            view_angle: Half of the angle of sight for ``view`` (phi), degrees.
            out_of_view: Weight of what is out of sight for ``view`` (c).
            behind: Weight of who is straight behind for ``smooth`` (lambda).
            top_speed_ratio: Top speed, divided by the preferred one.
            neighbor_dist: Metres from which on others are ignored.
            max_neighbors: So many nearest others are heeded.
            fluctuation: Standard deviation of random accelerations, m/s^2.

        Raises:
            UserError: A setting is out of range.
        """
        names = SocialForceSettings.__dataclass_fields__
        given = {name: value for name, value in locals().items() if name in names and value is not None}
        super().__init__(dt)
        self.settings = SocialForceSettings.preset(preset, **given)
        if dt > self.settings.tau:
            raise UserError(
                f"social_force: dt {dt}: expected at most tau, {self.settings.tau} s: who holds a velocity "
                "for longer than it takes to change it follows no forces"
            )
        self._sees_walls = walls

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write everybody's velocity."""
        agents: Any = tensordict["agents"]
        mask, ids = agents["mask"], ids_of(tensordict)
        identity = randomness.join(tensordict["scene_key"], "social_force", ids)
        fluctuation = None
        if self.settings.fluctuation:
            step = (tensordict["time"] / TRACE_SECONDS).round().long()
            key = randomness.join(identity, step).unsqueeze(-1)
            key = randomness.join(key, torch.arange(2, device=key.device))
            # in the floor plan's frame: a turned and mirrored scene is walked alike
            noise = self.settings.fluctuation * randomness.normal(key)
            fluctuation = turn_to_scene(noise, cast("Tensor", tensordict["scene_pose"]))
        tensordict["agents", "action"] = social_force_velocity(
            agents["history"][:, :, -1],
            agents["velocity"],
            agents["desired_velocity"],
            agents["pref_speed"][..., 0],
            mask,
            self.settings,
            self.decision_dt,
            identity,
            self._walls(tensordict) if self._sees_walls else None,
            fluctuation,
            self._radius(agents),
        )
        return tensordict

    def _radius(self, agents: Any) -> Tensor:
        """Return the radii (B, A) that the others' forces see, metres.

        People who both give way stop some way into each other's potential, which begins at the centre. That
        of a body that gives no way begins where it would be touched.
        """
        radius = agents["radius"][..., 0]
        gives_no_way = ~agents["controlled"] & ((agents["kind"] == ROBOT) | ~usual_body(radius))
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
