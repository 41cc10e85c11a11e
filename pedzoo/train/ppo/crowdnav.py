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
from pedzoo.core.geometry import direction_of
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import build
from pedzoo.policies.robots._base import ObservedPeople, Robot, sensed
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
        self.weights, terms = (
            dict(DEFAULT_WEIGHTS if reward is None else reward),
            [*DEFAULT_WEIGHTS, "intrusion"],
        )
        if unknown_terms := self.weights.keys() - {*terms}:
            raise unknown("reward", min(unknown_terms), terms)
        self._random, self._first = torch.Generator().manual_seed(0), 0
        self.setting = setting if people is None else replace(setting, people=people)
        seeds = torch.arange(first, first + crowds).split(512)
        parts = [Crowds.of_seeds(self.setting, part.tolist()) for part in seeds]
        self.crowds = Crowds(*(torch.cat(values) for values in zip(*parts, strict=True)))
        self.fleet = Fleet.of([build(ROBOTS, robot, RobotBody)])
        self._body = TensorDict(self.fleet._asdict(), (1,)).expand(num_envs, 1)
        self._crowd = self._clock = torch.zeros(num_envs, dtype=torch.long)
        self._heading = self._turn = torch.zeros(num_envs)
        place, own = torch.zeros(num_envs, 2), (self.fleet.radius, self.fleet.top_speed)
        self._robot = Robot(place, place, place, *(number.expand(num_envs) for number in own))
        shape, self.done_spec = (num_envs, 1), done_spec(num_envs)
        ends = {name: flag(*shape, 1) for name in ("done", "terminated", "truncated")}
        self.done_spec["robots"] = Composite(ends, shape=shape)
        self.observation_spec = make_composite_from_td(self._observation(torch.zeros(3, num_envs).bool()))
        self.action_spec, self.reward_spec = (
            Composite(robots=Composite({name: entry}, shape=shape), shape=shape[:1])
            for name, entry in (("action", real(*shape, 2)), ("reward", real(*shape, 1)))
        )

    def _set_seed(self, seed: int | None) -> None:
        number = 0 if seed is None else as_integer("seed", seed)
        self._random.manual_seed(number)
        # a validation begins with the first crowds, each epoch of a training with others
        self._first = int(torch.randint(len(self.crowds.place), (), generator=self._random)) if number else 0

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        flags = None if tensordict is None else tensordict.get("_reset", None)
        anew = torch.ones_like(self._crowd, dtype=torch.bool) if flags is None else flags.view(-1)
        count, robot, row = len(self.crowds.place), self._robot, anew[:, None]
        crowd = (self._first + torch.arange(len(anew))) % count  # each one, while there are enough
        if flags is not None:
            crowd = torch.randint(count, crowd.shape, generator=self._random)
        self._crowd = torch.where(anew, crowd, self._crowd)
        self._clock = torch.where(anew, 0, self._clock)
        start, goal = self.crowds.start[self._crowd], self.crowds.goal[self._crowd]
        position = torch.where(row, start, robot.position)
        self._robot = robot._replace(
            position=position, velocity=robot.velocity.masked_fill(row, 0.0), goal=goal
        )
        ahead = goal - position
        self._heading = torch.where(anew, torch.atan2(ahead[:, 1], ahead[:, 0]), self._heading)
        self._turn = torch.where(anew, 0.0, self._turn)
        return self._observation(torch.zeros(3, len(anew)).bool())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        before, setting = self._robot, self.setting
        velocity = self._driven(cast("Tensor", tensordict["robots", "action"]))
        gap = crowdnav.swept_clearance(before, self._people(), velocity, TIME_STEP).amin(1)
        steps, foresight = self.crowds.place.shape[1] - 1, torch.arange(1, 1 + setting.foresight)
        later = self.crowds.place[self._crowd[:, None], (self._clock[:, None] + foresight).clamp_max(steps)]
        apart = (later - before.position[:, None, None]).norm(dim=-1) - RADIUS - self.fleet.radius
        position, self._clock = before.position + TIME_STEP * velocity, self._clock + 1
        self._robot = self._robot._replace(position=position)
        past, left = ((before.goal - place).norm(dim=-1) for place in (before.position, position))
        hit, arrived = gap < 0, left < self.fleet.radius
        events = torch.stack((arrived & ~hit, hit, (self._clock >= steps) & ~arrived & ~hit))
        near = setting.discomfort_dist
        terms = {
            "progress": past - torch.where(arrived, 0.0, left),
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
        fleet, robot = self.fleet, self._robot
        command = fleet.commands(action, self._heading.unsqueeze(1))[:, 0]
        if int(fleet.drive) == HOLONOMIC:
            self._robot = robot._replace(velocity=command)
            return command
        speed, turn = speed_and_turn(command.unbind(-1), fleet.drive, fleet.track)
        tick, now = TIME_STEP / TICKS, (robot.velocity * direction_of(self._heading)).sum(-1)
        more, more_turn = fleet.acceleration * tick, fleet.turn_acceleration * tick
        place = torch.zeros_like(command)
        for _ in range(TICKS):
            now = now + (speed - now).clamp(-more, more)
            self._turn = self._turn + (turn - self._turn).clamp(-more_turn, more_turn)
            self._heading = self._heading + 0.5 * tick * self._turn
            place = place + tick * now[:, None] * direction_of(self._heading)
            self._heading = self._heading + 0.5 * tick * self._turn
        self._robot = robot._replace(velocity=now[:, None] * direction_of(self._heading))
        return place / TIME_STEP

    def _people(self) -> ObservedPeople:
        """Return all people of the crowds."""
        place, velocity = (part[self._crowd, self._clock] for part in self.crowds[:2])
        radius = torch.full_like(place[..., 0], RADIUS)
        return ObservedPeople(place, velocity, radius, torch.ones_like(radius, dtype=torch.bool))

    def _observation(self, events: Tensor) -> TensorDict:
        """Return what robots sense; discs face one way all the time."""
        people = self._people()
        people = people._replace(mask=crowdnav.in_range(self.setting, self._robot, people))
        info = torch.cat((torch.ones_like(events[:1]), events))
        group = {
            "observation": sensed(self._robot, people, self._heading, self._turn),
            "info": dict(zip(INFO, info.unsqueeze(-1), strict=True)),
            "body": self._body,
        }
        return TensorDict({"robots": TensorDict(group, (*self.batch_size, 1))}, self.batch_size)
