"""CrowdNav's crowds as environments: people do not see the robot, so their walks are computed once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.utils import make_composite_from_td

from pedzoo.core.bodies import HOLONOMIC, Fleet, RobotBody, speed_and_turn
from pedzoo.core.errors import as_integer, unknown
from pedzoo.core.geometry import closest_fraction, direction_of, unrotate
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import build
from pedzoo.sim.crowdnav.settings import CROWDNAV, CROWDNAV_PP, RADIUS, TIME_STEP, Setting
from pedzoo.sim.observation import done_spec, flag, real
from pedzoo.sim.robot_parts.reward import USUAL
from pedzoo.train.robots.crowdnav_crowds import walked

SETTINGS = {"crowdnav": CROWDNAV, "crowdnav_pp": CROWDNAV_PP}
"""Crowds by name."""

TICKS = 5
"""Parts of a step in which wheels follow a command."""

FIRST = 10_000
"""Seeds of crowds in training; those of CrowdNav's test begin at 1000."""


class CrowdNavEnv(EnvBase):
    """The crowds of `pedzoo.sim.crowdnav.settings`, and one robot in each that people do not see.

    So their ways are computed once, for ``crowds`` crowds. Keys, actions and rewards are those of
    `pedzoo.sim.robot_parts.env.RobotEnv`; what ends an episode is CrowdNav's. One more term of the reward,
    ``intrusion``, takes the seconds that a robot stands where people will be within the setting's foresight.
    """

    def __init__(
        self,
        num_envs: int,
        setting: Setting = CROWDNAV,
        people: int | None = None,
        crowds: int = 4096,
        robot: str = "disc",
        reward: Mapping[str, float] | None = None,
        first: int = FIRST,
    ) -> None:
        """Walk the people.

        Args:
            num_envs: B.
            setting: Which crowd, and what the robot sees of it.
            people: N, in each crowd; None: as the setting says.
            crowds: How many crowds there are to be met.
            robot: A body with settings; it faces its goal at first.
            reward: Weights; see `pedzoo.sim.robot_parts.reward.USUAL`.
            first: Seed of the first crowd; the others follow.
        """
        super().__init__(batch_size=torch.Size([num_envs]))
        self.decision_dt, self.robots = TIME_STEP, 1
        self.weights = dict(USUAL if reward is None else reward)
        self._random, self._first = torch.Generator().manual_seed(0), 0
        if unknown_terms := self.weights.keys() - {*USUAL, "intrusion"}:
            raise unknown("reward", min(unknown_terms), [*USUAL, "intrusion"])
        self.setting = setting if people is None else replace(setting, people=people)
        self.crowds = walked(self.setting, range(first, first + crowds))
        shape = (num_envs, 1)
        self.fleet = Fleet.of([build(ROBOTS, robot, RobotBody)])
        self._body = TensorDict(self.fleet._asdict(), (1,)).expand(shape)
        self._crowd = torch.zeros(num_envs, dtype=torch.long)
        self._clock = torch.zeros_like(self._crowd)
        self._robot, self._moving = torch.zeros(num_envs, 2), torch.zeros(num_envs, 2)
        self._heading, self._turn = torch.zeros(num_envs), torch.zeros(num_envs)
        self._set_specs(shape, self.setting.people)

    def _set_specs(self, shape: tuple[int, int], people: int) -> None:
        sizes = {"goal": 2, "waypoint": 2, "velocity": 2}
        sizes |= dict.fromkeys(("remaining_path", "turn_rate", "radius", "heading"), 1)
        seen = Composite({name: real(*shape, size) for name, size in sizes.items()}, shape=shape)
        seen["people"], seen["people_mask"] = real(*shape, people, 5), flag(*shape, people)
        info = Composite({name: flag(*shape) for name in INFO}, shape=shape)
        body = make_composite_from_td(self._body)
        ends = {name: flag(*shape, 1) for name in ("done", "terminated", "truncated")}
        one = shape[:1]
        self.observation_spec = Composite(
            robots=Composite(observation=seen, info=info, body=body, shape=shape), shape=one
        )
        self.action_spec = Composite(robots=Composite(action=real(*shape, 2), shape=shape), shape=one)
        self.reward_spec = Composite(robots=Composite(reward=real(*shape, 1), shape=shape), shape=one)
        done = done_spec(*one)
        done["robots"] = Composite(ends, shape=shape)
        self.done_spec = done

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
        self._robot = torch.where(anew[:, None], self.crowds.start[self._crowd], self._robot)
        self._moving = torch.where(anew[:, None], 0.0, self._moving)
        way = self._goal() - self._robot
        self._heading = torch.where(anew, torch.atan2(way[:, 1], way[:, 0]), self._heading)
        self._turn = torch.where(anew, 0.0, self._turn)
        return self._observation(torch.zeros(3, *self.batch_size, dtype=torch.bool))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        velocity = self._driven(cast("Tensor", tensordict["robots", "action"]))
        people, moves = self._people()
        away, apart = people - self._robot[:, None], (moves - velocity[:, None]) * TIME_STEP
        gap = (away + closest_fraction(away, apart)[..., None] * apart).norm(dim=-1).amin(1)
        gap = gap - RADIUS - self.fleet.radius
        later = self.crowds.ahead(self._crowd, self._clock, self.setting.foresight)
        apart = (later - self._robot[:, None, None]).norm(dim=-1) - RADIUS - self.fleet.radius
        left = self._left()
        self._robot = self._robot + TIME_STEP * velocity
        self._clock = self._clock + 1
        arrived = self._left() < self.fleet.radius
        hit = gap < 0
        events = torch.stack((arrived & ~hit, hit, (self._clock >= self.crowds.steps) & ~arrived & ~hit))
        near = self.setting.discomfort_dist
        terms = {
            "progress": left - torch.where(arrived, 0.0, self._left()),
            "success": events[0].float(),
            "collision": -hit.float(),
            "discomfort": -(near - gap.clamp_min(0)).clamp_min(0) / near * TIME_STEP,
            "intrusion": (apart < 0).flatten(1).any(1) * -TIME_STEP,
            "time": torch.full_like(gap, -TIME_STEP),
        }
        reward = torch.stack([weight * terms[name] for name, weight in self.weights.items()]).sum(0)
        result = self._observation(events)
        robots = cast("TensorDict", result["robots"])
        robots["reward"] = reward[:, None, None]
        done = events.any(0)
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
        tick, now = TIME_STEP / TICKS, (self._moving * self._ahead()).sum(-1)
        more, more_turn = fleet.acceleration * tick, fleet.turn_acceleration * tick
        place = torch.zeros_like(self._robot)
        for _ in range(TICKS):
            now = now + (speed - now).clamp(-more, more)
            self._turn = self._turn + (turn - self._turn).clamp(-more_turn, more_turn)
            self._heading = self._heading + 0.5 * tick * self._turn
            place = place + tick * now[:, None] * self._ahead()
            self._heading = self._heading + 0.5 * tick * self._turn
        self._moving = now[:, None] * self._ahead()
        return place / TIME_STEP

    def _ahead(self) -> Tensor:
        return direction_of(self._heading)

    def _left(self) -> Tensor:
        return (self._goal() - self._robot).norm(dim=-1)

    def _goal(self) -> Tensor:
        return self.crowds.goal[self._crowd]

    def _people(self) -> tuple[Tensor, Tensor]:
        """Return where people are and their velocities (B, N, 2)."""
        return self.crowds.place[self._crowd, self._clock], self.crowds.velocity[self._crowd, self._clock]

    def _observation(self, events: Tensor) -> TensorDict:
        """Return what robots sense; discs face one way all the time."""
        shape, ahead = (*self.batch_size, 1), self._ahead()
        goal, zero = self._goal() - self._robot, torch.zeros(*shape, 1)
        place, velocity = self._people()
        away = place - self._robot[:, None]
        reach = self.setting.sensor_range or math.inf
        mask = away.norm(dim=-1) - RADIUS - self.fleet.radius <= reach
        place, velocity = (unrotate(value, ahead.unsqueeze(1).expand_as(value)) for value in (away, velocity))
        goal, moving = unrotate(goal, ahead), unrotate(self._moving, ahead)
        rows = torch.cat((place, velocity, torch.full_like(place[..., :1], RADIUS)), -1)
        seen = {"goal": goal, "waypoint": goal, "velocity": moving}
        seen |= {"people": rows * mask.unsqueeze(-1), "people_mask": mask}
        seen = {name: value.unsqueeze(1) for name, value in seen.items()}
        seen |= {"remaining_path": self._left()[:, None, None], "radius": zero + self.fleet.radius}
        seen |= {"turn_rate": self._turn[:, None, None], "heading": self._heading[:, None, None]}
        info = dict(zip(INFO, torch.cat((torch.ones_like(events[:1]), events)).unsqueeze(-1), strict=True))
        group = {"observation": TensorDict(seen, shape), "info": TensorDict(info, shape), "body": self._body}
        return TensorDict({"robots": TensorDict(group, shape)}, self.batch_size)


INFO = ("active", "success", "person_contact", "timeout")
"""What is said of a decision."""
