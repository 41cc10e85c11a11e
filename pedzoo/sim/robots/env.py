"""Robots among people as a TorchRL environment, by name: a policy moves the robots, people walk inside."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import pad
from torchrl.data import Bounded, Composite
from torchrl.envs.utils import ExplorationType, make_composite_from_td, set_exploration_type

from pedzoo.core.adapters import put, tensordict_of
from pedzoo.core.batch import ROBOT, actions_of, agents_of, other_agents
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
from pedzoo.sim.robots.rewards import Outcome, Terms, terms_of, weighted_sum
from pedzoo.sim.robots.scenes import RobotScenes, RobotView, with_robots
from pedzoo.sim.robots.sensors import Reading, Sensor
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.sim.state import Events, State

SENSES = ("goal", "odometry", "people")
"""Default sensors."""

GAP = 0.1
"""Metres that ways keep from walls beyond the radius of the widest robot, at least."""

INFO = ("active", "success", "person_contact", "robot_contact", "wall_contact", "timeout", "failed")
"""Keys of ``robots/info``; see `Outcome`."""

EndsAt = Literal["any", "agent", "none"]
"""Which contacts end a robot's episode: with anything, with people and other robots, or none."""


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
        reward: Terms,
        num_envs: int = 1,
        decision_dt: float = 0.2,
        ends_at: EndsAt = "any",
        time_limit: float | None = None,
        **settings: Any,
    ) -> None:
        """Take the parts; `pedzoo.make_robot_env` makes them from their names, and says what they are.

        ``prepared`` is what `RobotScenes.prepare` returned. Robots decide every ``decision_dt`` seconds. They
        have ``time_limit`` seconds; None: as people, 20 s per goal or four times as long as the way to it
        takes at top speed. ``settings`` are those of `PedestrianEnv`: ``seed``, ``warm_start``, ...

        Raises:
            UserError: A setting is out of range, two sensors have one entry, or intervals do not fit.
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
        self._sensors: list[tuple[Sensor, int]] = []
        self._readings: dict[str, Tensor] = {}  # of the last decisions, the oldest first
        entries: dict[str, Reading] = {}
        for sensor in sensors:
            name, late = type(sensor).__name__, round(sensor.delay / decision_dt)
            if twice := entries.keys() & sensor.readings.keys():
                raise UserError(f"sensor {name}: {', '.join(sorted(twice))} is an entry of two sensors")
            if abs(late * decision_dt - sensor.delay) > 1e-6:
                raise UserError(
                    f"sensor {name}: delay {sensor.delay:g} s: expected a multiple of the {decision_dt:g} s "
                    "between two decisions"
                )
            entries |= sensor.readings
            self._sensors.append((sensor, late))
        shape = (num_envs, self.robots)
        self._body = TensorDict(self.fleet._asdict(), (self.robots,), device=self.device).expand(shape)
        self._set_specs(entries, *shape)

    def _set_specs(self, entries: Mapping[str, Reading], *shape: int) -> None:
        points = round(self.decision_dt / TRACE_SECONDS)
        observation = specs.observation_spec(shape[0], self.prepared.people, points, self.bank)
        observation["robots"] = Composite(
            observation=Composite({name: one.spec(*shape) for name, one in entries.items()}, shape=shape),
            body=make_composite_from_td(self._body),
            carrot=specs.real(*shape, 2),
            info=Composite({name: specs.flag(*shape) for name in INFO}, shape=shape),
            shape=shape,
        )
        done, ends = specs.done_spec(shape[0]), ("done", "terminated", "truncated")
        done["robots"] = Composite({name: specs.flag(*shape, 1) for name in ends}, shape=shape)
        self.observation_spec, self.done_spec = observation.to(self.device), done.to(self.device)
        limits = torch.tensor([body.limits for body in self.scenes.bodies]).unbind(-1)
        low, high = (limit.expand(*shape, 2).clone() for limit in limits)
        entry = {"action": Bounded(low, high, torch.Size((*shape, 2))), "reward": specs.real(*shape, 1)}
        self.action_spec, self.reward_spec = (
            Composite(robots=Composite({name: one}, shape=shape), shape=shape[:1]).to(self.device)
            for name, one in entry.items()
        )

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
        late = over & self.state.overdue[:, -self.robots :]
        put(cast("TensorDict", observation["robots"]), _ends(over.unsqueeze(-1), late.unsqueeze(-1)))
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
            agents_of(seen)["command"] = pad(command, (0, 0, people, 0))
            # how the robots' policy explores is no matter of people's
            with set_exploration_type(ExplorationType.RANDOM):
                velocity = actions_of(self._people(seen))
            after, guidance, events = kernel.step(state, velocity, self.physics, self.rules)
            result = self._outcome(state, after, events)
            after = after._replace(controlled=after.controlled & ~pad(result.ended, (people, 0)))
            outcome = outcome.then(result) if part else result
            happened.append(events)
            taken.append((velocity, state, after))
            state = after
        if bool((state.failed & ~before.failed).any()):
            # of the first part that failed: what comes later moves nobody
            self._warn(*next(one for one in taken if bool((one[2].failed & ~one[1].failed).any())))
        self._scenes = scenes._replace(state=state, guidance=guidance)
        over_time = [torch.cat(values, 2) for values in list(zip(*happened, strict=True))[:4]]
        events = Events(*over_time, *happened[-1][4:])
        observation = self._observation(state, guidance, events, outcome)
        reward = weighted_sum(self._reward, first, self.view(state, guidance), events.trace, outcome)
        over = ~state.controlled[:, people:]
        late = outcome.timeout | outcome.failed | (over & state.overdue[:, people:])
        ends = _ends(over.unsqueeze(-1), late.unsqueeze(-1))
        put(cast("TensorDict", observation["robots"]), ends | {"reward": reward.unsqueeze(-1)})
        put(observation, _ends(over.all(1, keepdim=True), late.any(1, keepdim=True)))
        return observation

    def _outcome(self, before: State, after: State, events: Events) -> Outcome:
        """Return what a decision of people came to for robots, of the scenes before and after it."""
        last = slice(-self.robots, None)
        active = before.controlled[:, last]
        touched = active & events.agent_contact[:, last].any(-1)
        wall = active & events.wall_contact[:, last].any(-1)
        person = touched
        if self.robots > 1:  # of which kind is the nearest body on the way
            away = events.trace[:, last].unsqueeze(2) - events.trace.unsqueeze(1)
            gap = torch.linalg.vector_norm(away, dim=-1).amin(-1)
            gap = gap - before.radius.unsqueeze(1) - before.radius[:, last].unsqueeze(2)
            others = other_agents(before.mask, self.robots)
            nearest = gap.masked_fill(~others, torch.inf).argmin(-1)
            person = touched & (before.kind.gather(1, nearest) != ROBOT)
        late = after.overdue[:, last]
        if self._time_limit is not None:
            late = (after.clock >= self._time_limit - 1e-3).unsqueeze(1)
        hit = {"any": touched | wall, "agent": touched, "none": torch.zeros_like(touched)}[self._ends_at]
        failed = active & after.failed.unsqueeze(1)
        success = active & (events.reached[:, last, -1] >= self.scenes.robot_goals) & ~hit
        timeout = active & (late | ~after.mask[:, last]) & ~success & ~hit & ~failed
        ended = active & (success | hit | timeout | failed)
        return Outcome(active, success, person, touched & ~person, wall, timeout, failed, ended)

    def _observation(
        self, state: State, guidance: Guidance, happened: Events | None = None, outcome: Outcome | None = None
    ) -> TensorDict:
        batch, robots = super()._observation(state, guidance, happened), self._body.batch_size
        view, rows = self.view(state, guidance), None
        if happened is None:  # only scenes that begin are looked at again
            assert self._scenes is not None
            rows = self._begun.nonzero().view(-1)
            view = self.view(*self._scenes.select(rows))
        for sensor, late in self._sensors if rows is None or len(rows) else ():
            for name, now in sensor.observe(view).items():
                now = now.expand(late + 1, *now.shape)
                last = self._readings.get(name, now)
                last = torch.cat((last[1:], now[:1])) if rows is None else last.index_copy(1, rows, now)
                self._readings[name] = last
        # a caller may write into what it gets
        seen = {name: last[0].clone() for name, last in self._readings.items()}
        outcome = outcome or Outcome.none(state.controlled[:, -self.robots :])
        flags = {name: getattr(outcome, name) for name in INFO}
        group = {
            "observation": tensordict_of(seen, robots, self.device),
            "info": tensordict_of(flags, robots, self.device),
            "body": self._body,
            "carrot": guidance.carrot[:, -self.robots :],
        }
        put(batch, {"robots": tensordict_of(group, robots, self.device)})
        return batch


def _ends(over: Tensor, late: Tensor) -> dict[str, Tensor]:
    """Return which episodes are over (...) bool, and which of them are so because it is ``late``."""
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
    reward: Mapping[str, float] | None = None,
    physics: str | None = None,
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
            `pedzoo.sim.robots.rewards.DEFAULT_WEIGHTS`.
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
        terms_of(reward),
        num_envs,
        **settings,
    )


def clearance_of(bodies: Sequence[RobotBody]) -> float:
    """Return the metres that planned ways keep from walls, so that all robots fit."""
    return max(CLEARANCE, *(body.radius + GAP for body in bodies))
