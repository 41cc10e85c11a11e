"""Policies for anybody's own simulator: positions of people by id in, velocities by id out."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pedzoo.batch import scene_batch
from pedzoo.draws import Draws
from pedzoo.errors import UserError
from pedzoo.geometry import identity_pose, limit_speed
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.guidance import Guidance
from pedzoo.maps.library import load_plan
from pedzoo.maps.planner import Planner
from pedzoo.models.roster import PREF_SPEED, Roster, as_points
from pedzoo.models.ways import Ways
from pedzoo.types import OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO

Id = TypeVar("Id", bound=Hashable)


class WalkingPolicy(Protocol):
    """What can be a controller: a `Walker`, or anything from `pedzoo.sim.policy.load_policy`."""

    decision_dt: float

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``agents/action``."""
        ...


class Controller:
    """Moves the people of a simulator that is not pedzoo's: call `step` with where everybody is.

    At every call positions are recorded. Every ``policy.decision_dt`` the policy decides, from the same
    scene batch that the environment makes: the last 8 positions 0.4 s apart, the planner's carrot and
    desired velocity. In between, people keep the velocity that was decided last. The caller moves them:
    walls stop nobody here, and positions need not be where the velocities lead.

    People come and go. Whoever is not named in a call is forgotten, and is new when they come back. For
    somebody new the policy decides at once; from then on they decide when all others do. They begin with a
    history as if they had walked here straight at their present velocity: models were trained on people in
    motion, so that a history on the spot reads as a person who stands, and who goes on standing. That
    present velocity is the one given to `step`, else their preferred speed along the planner's way.

    Nobody stops at a goal: they walk through it, and about it when they get no other.

    Noise is drawn by seed and id alone: whoever else is there, a person's stays the same.
    """

    def __init__(
        self,
        policy: WalkingPolicy,
        map: OccupancyGrid | str | Path | None = None,
        pref_speed: float | Mapping[Any, float] = PREF_SPEED,
        dt: float = STEP_SECONDS,
        seed: int = 0,
        deterministic: bool = False,
        clearance: float = 0.25,
        unknown: Unknown = "wall",
    ) -> None:
        """Take a policy and the floor plan that people walk on.

        Args:
            policy: Decides. Controllers on several floor plans may share one.
            map: The floor plan, its name (``apartment.7``) or its file; None for open space, where ways lead
                straight to the goal.
            pref_speed: The speed that people like, m/s: one for all, or by id (1.3 for those who are not
                in it). It is looked up when a person comes.
            dt: Seconds between two calls of `step`.
            seed: Of the noise: that of the environment's first scene of this seed, where ids are 0, 1, ...
            deterministic: Without noise.
            clearance: Metres that ways keep from walls.
            unknown: What unknown cells of the floor plan count as.

        Raises:
            UserError: There is no such floor plan, or a setting is out of range.
        """
        self._every = _times(policy.decision_dt, dt, "the policy decides")
        self._per_sample = _times(STEP_SECONDS, dt, "histories have a position")
        if getattr(policy, "execute_steps", 1) != 1:
            raise UserError(
                f"execute_steps {getattr(policy, 'execute_steps', 1)}: a controller decides anew for people "
                "who come and go: expected 1"
            )
        grid = load_plan(map) if isinstance(map, str | Path) else map
        bank = MapBank([] if grid is None else [grid], unknown)
        self.policy, self.dt, self.pref_speed, self.deterministic = policy, dt, pref_speed, deterministic
        self._maps, self._ways = bank, Ways(Planner(bank, clearance))
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Forget everybody and start anew with the noise of ``seed``; ways that are known stay known."""
        self._key = Draws.of(seed, torch.zeros(1, dtype=torch.long)).key
        self._calls = 0
        self._people = Roster.empty((OBS_LEN - 1) * self._per_sample + 1)

    @torch.no_grad()
    def step(
        self,
        positions: Mapping[Id, Any],
        goals: Mapping[Any, Any] | None = None,
        velocities: Mapping[Any, Any] | None = None,
    ) -> dict[Id, NDArray[np.float64]]:
        """Return the velocity (2,) of everybody, m/s, at most 1.3 times their preferred speed.

        Coordinates are those of the floor plan, metres: tuples, lists, arrays or tensors. A call that
        raises changes nothing.

        Args:
            positions: Where everybody is now, by id: any hashable values.
            goals: Where they are going. Needed when a person is new, and then when their goal changes;
                it counts from the next decision on. Goals of people who are not there are not looked at.
            velocities: How people are moving who are new; see the class.

        Raises:
            UserError: A value is not two finite numbers; a person has no goal, or one that is in a wall,
                outside the floor plan or out of reach; or the policy's answer is not finite.
        """
        people = self._people.now(positions, self.pref_speed)
        if not positions:
            self._people, self._calls = people, self._calls + 1
            return {}
        position = torch.empty_like(people.velocity)
        position[people.rows(positions)] = as_points(positions, "position").float()
        ways, people = self._ways.with_goals(people, position, _of(positions, goals))

        new = people.is_new
        past = torch.cat((people.past[:, 1:], position.unsqueeze(1)), dim=1)
        decide = new | (self._calls % self._every == 0)
        if decide.any():
            guidance = ways.guide(people, position)
            present = guidance.desired_velocity
            if given := _of(positions, velocities):
                present = present.index_put((people.rows(given),), as_points(given, "velocity").float())
            past = torch.where(new.view(-1, 1, 1), self._prolonged(position, present), past)
            people = people._replace(past=past)
            action = self._decided(people, guidance)
            people = people._replace(velocity=torch.where(decide.unsqueeze(1), action, people.velocity))
        else:
            people = people._replace(past=past)
        self._ways, self._people, self._calls = ways, people, self._calls + 1
        answer = people.velocity.double().numpy()
        return {one: answer[people.row[one]] for one in positions}

    def _prolonged(self, position: Tensor, velocity: Tensor) -> Tensor:
        """Return pasts (N, L, 2) of people who have come straight to where they are."""
        length = self._people.past.shape[1]
        ago = torch.arange(length - 1, -1, -1, dtype=position.dtype) * self.dt
        return position.unsqueeze(1) - velocity.unsqueeze(1) * ago.view(-1, 1)

    def _decided(self, people: Roster, guidance: Guidance) -> Tensor:
        """Return the policy's velocities (N, 2)."""
        batch, device = self._batch(people, guidance), people.past.device
        if isinstance(self.policy, nn.Module):
            device = next(self.policy.parameters(), people.past).device
        if device != people.past.device:
            batch = batch.to(device)
        kind = ExplorationType.DETERMINISTIC if self.deterministic else ExplorationType.RANDOM
        with set_exploration_type(kind):
            action = cast("Tensor", self.policy(batch)["agents", "action"])[0].to(people.past)
        broken = ~action.isfinite().all(1)
        if broken.any():
            raise UserError(
                f"the policy's velocity is not finite for {people.names(broken)}: are its weights damaged?"
            )
        return limit_speed(action, TOP_SPEED_RATIO * people.pref_speed)

    def _batch(self, people: Roster, guidance: Guidance) -> TensorDict:
        """Return the scene as the environment would observe it, one scene of N people."""
        size = (1, len(people.row))
        history = people.past[:, :: self._per_sample]
        everybody = torch.ones(size, dtype=torch.bool)
        return scene_batch(
            maps=self._maps,
            map_id=torch.tensor([[self._ways.map_id]]),
            pose=identity_pose(1),
            history=history.unsqueeze(0),
            valid=everybody.unsqueeze(-1).expand(*size, OBS_LEN),
            mask=everybody,
            velocity=((people.past[:, -1] - people.past[:, -2]) / self.dt).unsqueeze(0),
            pref_speed=people.pref_speed.view(*size, 1),
            goal=guidance.goal.unsqueeze(0),
            desired_velocity=guidance.desired_velocity.unsqueeze(0),
            id=people.number.unsqueeze(0),
            key=self._key.unsqueeze(1),
            time=torch.tensor([[self._calls * self.dt]]),
        )


def _of(present: Mapping[Any, Any], given: Mapping[Any, Any] | None) -> dict[Any, Any]:
    """Return what is given for people who are there."""
    return {one: value for one, value in (given or {}).items() if one in present}


def _times(whole: float, dt: float, what: str) -> int:
    """Return how many steps of ``dt`` are ``whole`` seconds.

    Raises:
        UserError: Not a whole number.
    """
    times = round(whole / dt) if 0 < dt < float("inf") else 0
    if times < 1 or abs(times * dt - whole) > 1e-6:
        raise UserError(
            f"dt {dt}: {what} every {whole:g} s, expected a whole part of that, such as {whole / 4:g}"
        )
    return times
