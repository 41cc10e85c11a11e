"""CrowdNav's crowds as environments in which robots learn: people do not see them, so they walk once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.utils import make_composite_from_td

from pedzoo.core.bodies import HOLONOMIC, Fleet, RobotBody, speed_and_turn
from pedzoo.core.errors import as_integer, unknown
from pedzoo.core.geometry import direction_of, unrotate
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import build
from pedzoo.policies.robots._base import ObservedPeople, Robot
from pedzoo.sim import crowdnav
from pedzoo.sim.crowdnav import CROWDNAV, CROWDNAV_PP, RADIUS, TIME_STEP, Setting
from pedzoo.sim.observation import done_spec, flag, real
from pedzoo.sim.robots.rewards import DEFAULT_WEIGHTS

SETTINGS = {"crowdnav": CROWDNAV, "crowdnav_pp": CROWDNAV_PP}
"""Crowds by name."""

TICKS = 5
"""Parts of a step in which wheels follow a command."""

INFO = ("active", "success", "person_contact", "timeout")
"""Keys of ``robots/info``."""


class Crowds(NamedTuple):
    """C crowds of N people for T steps of `TIME_STEP` until the time is up, who do not see the robot.

    Attributes:
        place: Where people are (C, T + 1, N, 2), metres.
        velocity: Theirs (C, T + 1, N, 2), m/s.
        start: Of the robot (C, 2), metres.
        goal: Of the robot (C, 2), metres.
    """

    place: Tensor
    velocity: Tensor
    start: Tensor
    goal: Tensor

    @classmethod
    def of_seeds(cls, setting: Setting, seeds: Sequence[int]) -> Crowds:
        """Return the crowds of cases; who replaces others keeps clear of the robot's start and goal alone."""
        state = crowdnav.cases(setting, seeds)
        states = [state.people]
        for _ in range(round((setting.time_limit - crowdnav.EARLY) / TIME_STEP)):
            velocity = crowdnav.people_velocity(setting, None, state.people, state.goal)
            people = crowdnav.walked(state.people, velocity)
            state = crowdnav.replaced(setting, state._replace(people=people))
            states.append(state.people)
        place, velocity = (torch.stack([one[part] for one in states], 1) for part in (0, 1))
        return cls(*(part.float() for part in (place, velocity, state.robot.position, state.robot.goal)))


class CrowdNavEnv(EnvBase):
    """Crowds with one robot each that people do not see: their ways are computed once, for C ``crowds``.

    Keys, actions and rewards are those of `pedzoo.sim.robots.env.RobotEnv`; what ends an episode is
    CrowdNav's. One more term of the reward, ``intrusion``, takes the seconds that a robot stands where people
    will be within the setting's foresight.
    """

    def __init__(
        self,
        num_envs: int,
        setting: Setting = CROWDNAV,
        people: int | None = None,
        crowds: int = 4096,
        robot: str = "disc",
        reward: Mapping[str, float] | None = None,
        first: int = 10_000,
    ) -> None:
        """Walk the people.

        Args:
            num_envs: B.
            setting: Which crowd, and what the robot sees of it.
            people: N, in each crowd; None: as the setting says.
            crowds: C.
            robot: A body with settings; it faces its goal at first.
            reward: Weights; see `pedzoo.sim.robots.rewards.DEFAULT_WEIGHTS`.
            first: Seed of the first crowd; the others follow.
        """
        super().__init__(batch_size=torch.Size([num_envs]))
        self.decision_dt, self.robots = TIME_STEP, 1
        self.weights = dict(DEFAULT_WEIGHTS if reward is None else reward)
        if unknown_terms := self.weights.keys() - {*DEFAULT_WEIGHTS, "intrusion"}:
            raise unknown("reward", min(unknown_terms), [*DEFAULT_WEIGHTS, "intrusion"])
        self._random, self._first = torch.Generator().manual_seed(0), 0
        self.setting = setting if people is None else replace(setting, people=people)
        seeds = torch.arange(first, first + crowds).split(512)
        parts = [Crowds.of_seeds(self.setting, part.tolist()) for part in seeds]
        self.crowds = Crowds(*(torch.cat(values) for values in zip(*parts, strict=True)))
        self.fleet = Fleet.of([build(ROBOTS, robot, RobotBody)])
        self._body = TensorDict(self.fleet._asdict(), (1,)).expand(num_envs, 1)
        self._crowd = self._clock = torch.zeros(num_envs, dtype=torch.long)
        self._position = self._moving = torch.zeros(num_envs, 2)
        self._heading = self._turn = torch.zeros(num_envs)
        self._set_specs(num_envs)

    def _set_specs(self, scenes: int) -> None:
        shape, done = (scenes, 1), done_spec(scenes)
        ends = {name: flag(*shape, 1) for name in ("done", "terminated", "truncated")}
        done["robots"] = Composite(ends, shape=shape)
        self.done_spec = done
        self.observation_spec = make_composite_from_td(self._observation(torch.zeros(3, scenes).bool()))
        for name, entry in (("action", real(*shape, 2)), ("reward", real(*shape, 1))):
            spec = Composite(robots=Composite({name: entry}, shape=shape), shape=shape[:1])
            setattr(self, f"{name}_spec", spec)

    def _set_seed(self, seed: int | None) -> None:
        number = 0 if seed is None else as_integer("seed", seed)
        self._random.manual_seed(number)
        # a validation begins with the first crowds, each epoch of a training with others
        self._first = int(torch.randint(len(self.crowds.place), (), generator=self._random)) if number else 0

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        flags = None if tensordict is None else tensordict.get("_reset", None)
        anew = torch.ones_like(self._crowd, dtype=torch.bool) if flags is None else flags.view(-1)
        count = len(self.crowds.place)
        crowd = (self._first + torch.arange(len(anew))) % count  # each one, while there are enough
        if flags is not None:
            crowd = torch.randint(count, crowd.shape, generator=self._random)
        self._crowd = torch.where(anew, crowd, self._crowd)
        self._clock = torch.where(anew, 0, self._clock)
        self._position = torch.where(anew[:, None], self.crowds.start[self._crowd], self._position)
        self._moving = torch.where(anew[:, None], 0.0, self._moving)
        self._heading = torch.where(anew, torch.atan2(*self._way().flip(1).unbind(1)), self._heading)
        self._turn = torch.where(anew, 0.0, self._turn)
        return self._observation(torch.zeros(3, len(anew)).bool())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        velocity = self._driven(cast("Tensor", tensordict["robots", "action"]))
        robot, people = self._met()
        gap = crowdnav.swept_clearance(robot, people, velocity, TIME_STEP).amin(1)
        steps, foresight = self.crowds.place.shape[1] - 1, torch.arange(1, 1 + self.setting.foresight)
        later = self.crowds.place[self._crowd[:, None], (self._clock[:, None] + foresight).clamp_max(steps)]
        apart = (later - self._position[:, None, None]).norm(dim=-1) - RADIUS - self.fleet.radius
        before = self._way().norm(dim=-1)
        self._position, self._clock = self._position + TIME_STEP * velocity, self._clock + 1
        left, hit = self._way().norm(dim=-1), gap < 0
        arrived = left < self.fleet.radius
        events = torch.stack((arrived & ~hit, hit, (self._clock >= steps) & ~arrived & ~hit))
        near = self.setting.discomfort_dist
        terms = {
            "progress": before - torch.where(arrived, 0.0, left),
            "success": events[0].float(),
            "collision": -hit.float(),
            "discomfort": -(near - gap.clamp_min(0)).clamp_min(0) / near * TIME_STEP,
            "intrusion": (apart < 0).flatten(1).any(1) * -TIME_STEP,
            "time": torch.full_like(gap, -TIME_STEP),
        }
        result, done = self._observation(events), events.any(0)
        robots = cast("TensorDict", result["robots"])
        reward = torch.stack([weight * terms[name] for name, weight in self.weights.items()]).sum(0)
        robots["reward"] = reward[:, None, None]
        for name, value in (("done", done), ("terminated", done & ~events[2]), ("truncated", events[2])):
            robots[name], result[name] = value[:, None, None], value[:, None]
        return result

    def _driven(self, action: Tensor) -> Tensor:
        """Return the velocities (B, 2) by which robots move in a step, and let them face and move so."""
        fleet = self.fleet
        command = fleet.commands(action, self._heading.unsqueeze(1))[:, 0]
        if int(fleet.drive) == HOLONOMIC:
            self._moving = command
            return command
        speed, turn = speed_and_turn(command.unbind(-1), fleet.drive, fleet.track)
        tick, now = TIME_STEP / TICKS, (self._moving * direction_of(self._heading)).sum(-1)
        more, more_turn = fleet.acceleration * tick, fleet.turn_acceleration * tick
        place = torch.zeros_like(self._position)
        for _ in range(TICKS):
            now = now + (speed - now).clamp(-more, more)
            self._turn = self._turn + (turn - self._turn).clamp(-more_turn, more_turn)
            self._heading = self._heading + 0.5 * tick * self._turn
            place = place + tick * now[:, None] * direction_of(self._heading)
            self._heading = self._heading + 0.5 * tick * self._turn
        self._moving = now[:, None] * direction_of(self._heading)
        return place / TIME_STEP

    def _way(self) -> Tensor:
        """Return the ways to the goals (B, 2), metres."""
        return self.crowds.goal[self._crowd] - self._position

    def _met(self) -> tuple[Robot, ObservedPeople]:
        """Return the robots, and all people of their crowds."""
        place, velocity = (part[self._crowd, self._clock] for part in self.crowds[:2])
        radius = torch.full_like(place[..., 0], RADIUS)
        own = self.fleet.radius.expand(len(place)), self.fleet.top_speed.expand(len(place))
        robot = Robot(self._position, self._moving, self.crowds.goal[self._crowd], *own)
        return robot, ObservedPeople(place, velocity, radius, torch.ones_like(radius, dtype=torch.bool))

    def _observation(self, events: Tensor) -> TensorDict:
        """Return what robots sense; discs face one way all the time."""
        robot, people = self._met()
        ahead, mask = direction_of(self._heading), crowdnav.in_range(self.setting, robot, people)
        place = people.position - self._position[:, None]
        place, velocity = (
            unrotate(value, ahead[:, None].expand_as(value)) for value in (place, people.velocity)
        )
        goal = unrotate(self._way(), ahead)
        rows = torch.cat((place, velocity, people.radius[..., None]), -1) * mask[..., None]
        numbers = {"remaining_path": self._way().norm(dim=-1), "radius": robot.radius}
        numbers |= {"turn_rate": self._turn, "heading": self._heading}
        seen = {"goal": goal, "waypoint": goal, "velocity": unrotate(self._moving, ahead)}
        seen |= {"people": rows, "people_mask": mask} | {name: one[:, None] for name, one in numbers.items()}
        info = torch.cat((torch.ones_like(events[:1]), events))
        group = {
            "observation": {name: value.unsqueeze(1) for name, value in seen.items()},
            "info": dict(zip(INFO, info.unsqueeze(-1), strict=True)),
            "body": self._body,
        }
        return TensorDict({"robots": TensorDict(group, (*self.batch_size, 1))}, self.batch_size)
