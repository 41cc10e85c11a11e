"""What ``info`` says of robots, under the names that CrowdNav and SocNavGym have for it."""

from __future__ import annotations

from typing import Any, cast

import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.batch import ROBOT, agents_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.robot_parts.env import RobotEnv

PERSONAL_SPACE = 0.45
"""Metres between bodies of which people keep free what they can (Hall 1966; SocNavGym)."""

FLAGS = {
    "SUCCESS": "success",
    "COLLISION_HUMAN": "person_contact",
    "COLLISION_ROBOT": "robot_contact",
    "COLLISION_WALL": "wall_contact",
    "TIMEOUT": "timeout",
    "FAILED": "failed",
}
"""What a decision came to, and what `pedzoo.sim.robot_parts.outcome.Outcome` calls it."""

Info = dict[str, NDArray[Any]]


class RobotTotals:
    """Adds up what robots (B, R) have done since their episodes began."""

    def __init__(self, env: RobotEnv) -> None:
        """Take the environment, whose next observation is that of a reset."""
        self._env = env
        nothing = torch.zeros(env.batch_size[0], env.robots, device=env.device)
        self._shortest, self._seconds, self._length, self._personal = (nothing.clone() for _ in range(4))
        self._gap = torch.full_like(nothing, torch.inf)
        self._place = nothing.unsqueeze(-1).expand(-1, -1, 2)

    def begin(self, seen: TensorDictBase, scenes: Tensor) -> None:
        """Begin anew in some ``scenes`` (B,) bool of which ``seen`` is the first observation."""
        agents, last, row = agents_of(seen), slice(-self._env.robots, None), scenes.view(-1, 1)
        way = cast("Tensor", agents["info", "remaining_path"])[:, last]
        self._shortest = torch.where(row, way, self._shortest)
        self._seconds, self._length, self._personal = (
            torch.where(row, 0.0, total) for total in (self._seconds, self._length, self._personal)
        )
        here = cast("Tensor", agents["history"])[:, last, -1]
        self._place = torch.where(row.unsqueeze(-1), here, self._place)
        gap = self._gaps(seen, here.unsqueeze(2)).amin(-1)
        self._gap = torch.where(row, gap, self._gap)

    def add(self, seen: TensorDictBase) -> None:
        """Add the decision of which ``seen`` is the observation; robots that had ended do not move."""
        active = cast("Tensor", seen["robots", "info", "active"])
        trace = cast("Tensor", agents_of(seen)["info", "trace"])[:, -self._env.robots :]
        way = torch.cat((self._place.unsqueeze(2), trace), 2)
        steps = torch.linalg.vector_norm(way[:, :, 1:] - way[:, :, :-1], dim=-1).sum(-1)
        seconds = TRACE_SECONDS * trace.shape[2]
        gap = self._gaps(seen, trace).amin(-1)
        self._seconds = self._seconds + seconds * active
        self._length = self._length + torch.where(active, steps, 0.0)
        self._personal = self._personal + seconds * (active & (gap < PERSONAL_SPACE))
        self._gap = torch.where(active, gap, self._gap)
        self._place = trace[:, :, -1]

    def info(self, seen: TensorDictBase) -> Info:
        """Return what ``info`` says (B, R)."""
        flags = cast("TensorDictBase", seen["robots", "info"])
        result = {name: cast("Tensor", flags[key]) for name, key in FLAGS.items()}
        success, top_speed = result["SUCCESS"], self._env.fleet.top_speed
        fastest = self._shortest / top_speed
        hits = result["COLLISION_HUMAN"] | result["COLLISION_ROBOT"] | result["COLLISION_WALL"]
        result |= {
            "COLLISION": hits,
            "is_success": success,
            "TIME_TO_REACH_GOAL": self._seconds,
            "PATH_LENGTH": self._length,
            "SPL": success * self._shortest / self._length.maximum(self._shortest).clamp_min(1e-6),
            "STL": success * fastest / self._seconds.maximum(fastest).clamp_min(1e-6),
            "MINIMUM_DISTANCE_TO_HUMAN": self._gap,
            "PERSONAL_SPACE_COMPLIANCE": 1 - self._personal / self._seconds.clamp_min(TRACE_SECONDS),
        }
        return {name: value.cpu().numpy().copy() for name, value in result.items()}

    def _gaps(self, seen: TensorDictBase, mine: Tensor) -> Tensor:
        """Return how near people's bodies came (B, R, S) on robots' ways (B, R, S, 2), metres."""
        agents = agents_of(seen)
        radius = cast("Tensor", agents["radius"])[..., 0]
        person = agents["mask"] & (agents["kind"] != ROBOT)
        theirs = cast("Tensor", agents["info", "trace"])[:, :, -mine.shape[2] :]
        apart = torch.linalg.vector_norm(mine.unsqueeze(2) - theirs.unsqueeze(1), dim=-1)
        bodies = radius[:, -self._env.robots :].unsqueeze(2) + radius.unsqueeze(1)
        gap = apart - bodies.unsqueeze(-1)
        return gap.masked_fill(~person[:, None, :, None], torch.inf).amin(2)
