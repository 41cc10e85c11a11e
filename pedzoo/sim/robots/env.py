"""Robots among people as a TorchRL environment, by name: a policy moves the robots, people walk inside."""

from collections.abc import Mapping, Sequence
from typing import Any, cast, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs.utils import ExplorationType, make_composite_from_td, set_exploration_type

from pedzoo.core.adapters import tensordict_of
from pedzoo.core.batch import actions_of, agents_of
from pedzoo.core.bodies import RobotBody
from pedzoo.core.errors import UserError, known_arguments, unknown
from pedzoo.core.registry import ROBOTS, SENSORS
from pedzoo.core.spec import Spec, build
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.policies.load import crowd_of
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Crowd, Teams
from pedzoo.policies.walker import Walker
from pedzoo.sim import kernel
from pedzoo.sim import observation as specs
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import CLEARANCE, make_physics
from pedzoo.sim.observation import observed
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.robots.reward import EndsAt, Outcome, WeightedSum, outcome_of
from pedzoo.sim.robots.scenes import RobotScenes, with_robots
from pedzoo.sim.robots.sensor import Readings, RobotView, Sensor
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.sim.state import Events, State

SENSES = ("goal", "odometry", "people")
"""Default sensors."""

GAP = 0.1
"""Metres that ways keep from walls beyond the radius of the widest robot, at least."""

INFO = ("success", "person_contact", "robot_contact", "wall_contact", "timeout", "failed")
"""Keys of ``robots/info`` beside ``active``; see `Outcome`."""


class RobotEnv(PedestrianEnv):
    """A policy moves R robots; people are walked by another policy, which sees the robots as bodies.

    Keys under ``robots``, each (B, R, ...): ``action``, see `pedzoo.core.bodies.RobotBody`;
    ``observation``, whatever the sensors say; ``reward``; ``done``, ``terminated`` and ``truncated``;
    ``info`` with `Outcome`. The scene batch stands beside them, ``agents`` and so on, for policies that may
    see everything. ``agents/info/trace`` has the positions of all agents every 0.1 s of the last decision.

    A robot whose episode is over stands where it is. A scene is over when all of its robots are.

    Attributes:
        robots: R; the last R agents.
        scenes: What is walked in.
    """

    group = "robots"
    policy_name = "the robot's policy"

    def __init__(
        self,
        prepared: PreparedScenario,
        physics: Physics,
        people: Policy | Walker | Crowd,
        sensors: Sequence[Sensor],
        reward: WeightedSum,
        num_envs: int = 1,
        decision_dt: float = 0.2,
        ends_at: EndsAt = "any",
        time_limit: float | None = None,
        **settings: Any,
    ) -> None:
        """Take the parts; `pedzoo.make_robot_env` makes them from their names.

        Args:
            prepared: People and robots: what `RobotScenes.prepare` returned.
            physics: Moves them.
            people: Moves the people.
            sensors: What robots observe.
            reward: Of the robots.
            num_envs: B.
            decision_dt: Seconds between two decisions of the robots.
            ends_at: Which contacts end a robot's episode: ``any``, with an ``agent``, ``none``.
            time_limit: Seconds that robots have; None: as people, 20 s per goal or four times as long as the
                way to it takes at top speed.
            settings: As of `PedestrianEnv`: ``seed``, ``warm_start``, ``device``, ...

        Raises:
            UserError: A setting is out of range, or the intervals of people and robots do not fit.
        """
        if ends_at not in get_args(EndsAt):
            raise unknown("ends_at", ends_at, get_args(EndsAt))
        if time_limit is not None and not time_limit > 0:
            raise UserError(f"time_limit {time_limit}: expected seconds above 0")
        scenes = prepared.scenario
        assert isinstance(scenes, RobotScenes)
        self.robots, self.scenes = scenes.robots, scenes
        crowd = people if isinstance(people, list) else [(people, 1.0)]
        part = min(decision_dt, *(policy.decision_dt for policy, _ in crowd))
        self._parts = round(decision_dt / part)
        if abs(self._parts * part - decision_dt) > 1e-6:
            raise UserError(
                f"robots decide every {decision_dt:g} s and people every {part:g} s: expected a multiple"
            )
        super().__init__(prepared, physics, num_envs, decision_dt=part, **settings)
        self.decision_dt = decision_dt
        self.group_map = {"robots": [f"robot_{number}" for number in range(self.robots)]}
        self.fleet = scenes.fleet.to(self.device)
        self._people = Teams(people, _Commanded(part)).to(self.device)
        self._ends_at, self._time_limit, self._reward = ends_at, time_limit, reward
        self._readings = Readings(sensors, decision_dt)
        shape = (num_envs, self.robots)
        self._body = TensorDict(self.fleet._asdict(), (self.robots,), device=self.device).expand(shape)
        self._set_specs(*shape)

    def _set_specs(self, *shape: int) -> None:
        points = round(self.decision_dt / TRACE_SECONDS)
        full = specs.observation_spec(shape[0], self.prepared.people, points, self.bank)
        seen = {name: one.spec(*shape) for name, one in self._readings.entries.items()}
        full["robots"] = Composite(
            observation=Composite(seen, shape=shape),
            body=make_composite_from_td(self._body),
            info=Composite({name: specs.flag(*shape) for name in ("active", *INFO)}, shape=shape),
            shape=shape,
        )
        limits = torch.tensor([body.limits for body in self.scenes.bodies]).unbind(-1)
        low, high = (limit.expand(*shape, 2).clone() for limit in limits)
        entries = {
            "action": Bounded(low, high, torch.Size((*shape, 2))),
            "reward": specs.real(*shape, 1),
        }
        done = specs.done_spec(shape[0])
        ends = {name: specs.flag(*shape, 1) for name in ("done", "terminated", "truncated")}
        done["robots"] = Composite(ends, shape=shape)
        self.observation_spec, self.done_spec = full.to(self.device), done.to(self.device)
        for name, entry in entries.items():
            group = Composite({name: entry}, shape=shape)
            setattr(self, f"{name}_spec", Composite(robots=group, shape=shape[:1]).to(self.device))

    def view(self, state: State, guidance: Guidance) -> RobotView:
        """Return what sensors look at."""
        return RobotView(state, guidance, self.physics, self.robots)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        flags = None if tensordict is None else tensordict.get("_reset", None)
        if flags is None or self._scenes is None:
            flags = torch.ones(self.batch_size, dtype=torch.bool, device=self.device)
        self._begun = flags.view(-1)
        observation = super()._reset(tensordict, **kwargs)
        over = ~self.state.controlled[:, -self.robots :]
        self._set_ends(observation, over, over & self.state.overdue[:, -self.robots :])
        return observation

    def _opened(self, state: State) -> State:
        if self.scenes.present:
            return state
        there = torch.ones_like(state.mask)
        there[:, -self.robots :] = False
        return state._replace(
            mask=state.mask & there,
            controlled=state.controlled & there,
            person=torch.where(there, state.person, -1),
        )

    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        before, scenes = self.state, self._scenes  # the former refuses a step before `reset`
        assert scenes is not None
        guidance, people = scenes.guidance, self.prepared.people - self.robots
        first = self.view(before, guidance)
        command = self.fleet.commands(actions_of(tensordict, "robots"), first.heading)
        state, outcome, happened, taken = before, Outcome.none(before.controlled[:, people:]), [], []
        for part in range(self._parts):
            seen = observed(state, guidance, self.bank)
            agents_of(seen)["command"] = torch.nn.functional.pad(command, (0, 0, people, 0))
            # how the robots' policy explores is no matter of people's
            with set_exploration_type(ExplorationType.RANDOM):
                velocity = actions_of(self._people(seen))
            after, guidance, events = kernel.step(state, velocity, self.physics, self.rules)
            result = outcome_of(
                state, after, events, self.robots, self.scenes.robot_goals, self._time_limit, self._ends_at
            )
            ended = torch.nn.functional.pad(result.ended, (people, 0))
            after = after._replace(controlled=after.controlled & ~ended)
            outcome = outcome.then(result) if part else result
            happened.append(events)
            taken.append((velocity, state, after))
            state = after
        if bool((state.failed & ~before.failed).any()):
            # of the first part that failed: what comes later moves nobody
            self._warn(*next(part for part in taken if bool((part[2].failed & ~part[1].failed).any())))
        self._scenes = scenes._replace(state=state, guidance=guidance)
        over_time = [torch.cat(parts, 2) for parts in list(zip(*happened, strict=True))[:4]]
        together = Events(*over_time, *happened[-1][4:])
        observation = self._observation(state, guidance, together, outcome)
        reward = self._reward(first, self.view(state, guidance), together.trace, outcome)
        over = ~state.controlled[:, people:]
        late = outcome.timeout | outcome.failed | (over & state.overdue[:, people:])
        observation["robots", "reward"] = reward.unsqueeze(-1)
        self._set_ends(observation, over, late)
        ended, late = over.all(1).unsqueeze(1), late.any(1).unsqueeze(1)
        for name, value in _ends(ended, late).items():
            observation[name] = value
        return observation

    def _set_ends(self, observation: TensorDictBase, over: Tensor, late: Tensor) -> None:
        """Write which robots' episodes are over (B, R) bool, and which of them are so without an end."""
        robots = cast("TensorDict", observation["robots"])
        for name, value in _ends(over, late).items():
            robots[name] = value.unsqueeze(-1)

    def _observation(
        self, state: State, guidance: Guidance, happened: Events | None = None, outcome: Outcome | None = None
    ) -> TensorDict:
        batch, robots = super()._observation(state, guidance, happened), self._body.batch_size
        if happened is None:  # only scenes that begin are looked at again
            assert self._scenes is not None
            rows = self._begun.nonzero().view(-1)
            seen = self._readings(self.view(*self._scenes.select(rows)), rows)
        else:
            seen = self._readings(self.view(state, guidance))
        outcome = outcome or Outcome.none(state.controlled[:, -self.robots :])
        flags = {name: getattr(outcome, name) for name in ("active", *INFO)}
        group = {
            "observation": tensordict_of(seen, robots, self.device),
            "info": tensordict_of(flags, robots, self.device),
            "body": self._body,
        }
        batch["robots"] = tensordict_of(group, robots, self.device)
        return batch


def _ends(over: Tensor, late: Tensor) -> dict[str, Tensor]:
    return {"done": over, "terminated": over & ~late, "truncated": over & late}


class _Commanded(Policy):
    """Moves agents as ``agents/command`` (B, A, 2) says."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the commands as actions."""
        tensordict["agents", "action"] = agents_of(tensordict)["command"]
        return tensordict


@known_arguments(PedestrianEnv.__init__, RobotEnv.__init__)
def make_robot_env(
    scenario: str | Spec | PreparedScenario,
    robot: str | Spec | RobotBody | Sequence[str | RobotBody] = "disc",
    people: str | Policy | Walker | Crowd = "orca",
    num_envs: int = 1,
    sensors: str | Sensor | Sequence[str | Sensor] = SENSES,
    reward: Mapping[str, float] | WeightedSum | None = None,
    physics: str = "compiled",
    clearance: float | None = None,
    robot_goals: int = 1,
    present: bool = True,
    **settings: Any,
) -> RobotEnv:
    """Return an environment in which a policy moves robots among people who are walked inside.

    Args:
        scenario: Its name with settings, ``goals:map=plan.yaml,people=6``: so many people beside the robots.
            Or prepared scenes with robots, which environments may share: ``robot``, ``robot_goals``,
            ``present`` and ``clearance`` are theirs then.
        robot: Its name with settings, ``diff_drive:radius=0.35``, ``file.py:Class``, or a body; a list for
            several robots.
        people: The policy of the people, or its name, a mixed crowd, see
            `pedzoo.policies.load.load_policy`.
        num_envs: B, scenes that are run at once.
        sensors: Names with settings, ``lidar:beams=64``, ``file.py:Class``, or sensors: one, or a list.
        reward: Weights of terms by name, ``{"progress": 1, "collision": 5}``; None for
            `pedzoo.sim.robots.reward.DEFAULT_WEIGHTS`.
        physics: As in `pedzoo.make_env`.
        clearance: Metres that planned ways keep from walls; None: 0.25, or more for wide robots.
        robot_goals: Goals that each robot has to reach.
        present: Without it the robots are missing: the same people, in the same scenes.
        settings: More of `RobotEnv` and `PedestrianEnv`: ``seed``, ``decision_dt``, ``ends_at``, ...

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    body_radius = settings.setdefault("body_radius", BODY_RADIUS)
    if isinstance(scenario, PreparedScenario):
        prepared = scenario
    else:
        given = [robot] if isinstance(robot, str | Spec | RobotBody) else list(robot)
        bodies = [one if isinstance(one, RobotBody) else build(ROBOTS, one, RobotBody) for one in given]
        made = with_robots(scenario, bodies, robot_goals, present=present, body_radius=body_radius)
        prepared = made.prepare(clearance_of(bodies) if clearance is None else clearance)
    senses = [sensors] if isinstance(sensors, str | Sensor) else sensors
    return RobotEnv(
        prepared,
        make_physics(physics, prepared.bank, body_radius),
        crowd_of(people) if isinstance(people, str) else people,
        [one if isinstance(one, Sensor) else build(SENSORS, one, Sensor) for one in senses],
        reward if isinstance(reward, WeightedSum) else WeightedSum(reward),
        num_envs,
        **settings,
    )


def clearance_of(bodies: Sequence[RobotBody]) -> float:
    """Return the metres that planned ways keep from walls, so that all robots fit."""
    return max(CLEARANCE, *(body.radius + GAP for body in bodies))
