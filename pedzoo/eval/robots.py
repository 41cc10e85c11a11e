"""Robots drive whole episodes among people; the same people walk for as long without them."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any, cast

import torch
from torch import Tensor
from torchrl.envs.utils import step_mdp

from pedzoo.core.bodies import RobotBody
from pedzoo.core.errors import at_least_one
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import Spec, build
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.rollout import Recorder, ShareDone, in_parts
from pedzoo.metrics.ratios import summarised
from pedzoo.metrics.robots import robot_metrics
from pedzoo.policies.load import load_robot_policy
from pedzoo.policies.robots._base import RobotPolicy
from pedzoo.sim.make import physics_class
from pedzoo.sim.robots.env import SENSES, RobotEnv, clearance_of, make_robot_env
from pedzoo.sim.robots.scenes import RobotScenes, with_robots
from pedzoo.sim.rollout import RobotRollout, joined
from pedzoo.sim.scenario import PreparedScenario


def robot_rollout(
    robot_policy: str,
    scenario: str | Spec,
    robot: str | Sequence[str] = "disc",
    people: str = "orca",
    physics: str = "compiled",
    episodes: int = 20,
    seed: int = 0,
    deterministic: bool = False,
    tell: ShareDone | None = None,
    **settings: Any,
) -> tuple[RobotRollout, RobotEnv]:
    """Return what a robot's policy did in the first scenes of a seed, and the environment.

    Its physics, ``env.physics``, is still open: pictures are taken there.

    Args:
        robot_policy: Its name with settings, as of `pedzoo.policies.load.load_robot_policy`.
        scenario: Its name with settings.
        robot: The body's name with settings, ``diff_drive:radius=0.35``; a list for several robots.
        people: Their policy's name with settings, or a mixed crowd.
        physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class``.
        episodes: E.
        seed: Of the scenes.
        deterministic: The robot's policy does not explore. People keep their noise.
        tell: Called with the share that is done.
        settings: More of `pedzoo.make_robot_env`: ``sensors`` (else those that the policy says it needs),
            ``decision_dt``, ``ends_at``, ...

    Raises:
        UserError: An unknown name or setting.
    """
    episodes = at_least_one("episodes", episodes)
    bodies = (robot,) if isinstance(robot, str) else tuple(robot)
    prepared = prepared_scenes(scenario, bodies, settings.pop("robot_goals", 1))
    alone = cast("RobotScenes", prepared.scenario).without_robots(prepared)
    runs = -(-episodes // physics_class(physics).scenes_at_once)
    policy = load_robot_policy(robot_policy)
    settings = {"sensors": getattr(policy, "sensors", SENSES)} | settings
    settings |= {"people": people, "physics": physics, "seed": seed, "num_envs": -(-episodes // runs)}
    env, alone = (make_robot_env(one, **settings) for one in (prepared, alone))
    env.policy_name = robot_policy
    run = partial(run_robots, policy.to(env.device), env, alone)
    share = tell or (lambda _: None)
    try:
        parts = list(in_parts(run, episodes, deterministic, lambda done: share(done / episodes)))
    finally:
        alone.physics.close()
    return joined(parts), env


def prepared_scenes(scenario: str | Spec, bodies: Sequence[str], robot_goals: int = 1) -> PreparedScenario:
    """Return the scenes of a scenario with robots, their ways found; errors as of `robot_rollout`.

    The latest ones are kept: all policies of a case use them, one after the other.
    """
    key = repr((scenario, bodies, robot_goals))
    if key not in _kept:
        _kept.clear()
        made = with_robots(scenario, [build(ROBOTS, body, RobotBody) for body in bodies], robot_goals)
        _kept[key] = made.prepare(clearance_of(made.bodies))
    return _kept[key]


_kept: dict[str, PreparedScenario] = {}


def run_robots(
    policy: RobotPolicy, env: RobotEnv, alone: RobotEnv, ended: Callable[[int], None] | None = None
) -> RobotRollout:
    """Return one episode of every scene of ``env``, beside that of ``alone``, which has no robots.

    ``ended`` is called after every decision with the number of episodes that are over.
    """
    now = env.reset()
    recorder, robots = Recorder(env), _RobotRecorder(env)
    decisions = torch.zeros_like(recorder.alive, dtype=torch.long)
    while recorder.alive.any():
        result = env.step(policy(now))
        decisions += recorder.alive
        robots.add(result["next"], recorder.alive)
        recorder.add(result["next"])
        if ended:
            ended(int((~recorder.alive).sum()))
        now = step_mdp(result)
    now = alone.reset()
    others, action = Recorder(alone), alone.action_spec.zero()
    for number in range(1, int(decisions.max()) + 1):  # for as many decisions
        result = alone.step(now.update(action))
        others.add(result["next"], decisions <= number)
        now = step_mdp(result)
    return RobotRollout(
        walked=recorder.rollout(),
        alone=others.rollout(),
        progress=recorder.progress.cpu(),
        progress_alone=others.progress.cpu(),
        goals=env.scenes.robot_goals,
        bodies=env.fleet.to("cpu"),
        **robots.fields(),
    )


_CONTACTS = dict.fromkeys(("person_contact", "robot_contact"), "agent_contact") | {
    "wall_contact": "wall_contact"
}
"""What `RobotRollout` calls contacts, and where the environment says when they were."""


class _RobotRecorder:
    """Records values that only robots have."""

    def __init__(self, env: RobotEnv) -> None:
        self._env = env
        self._parts = {"heading": [env.state.heading[:, -env.robots :].unsqueeze(-1)]}
        self._parts |= {name: [] for name in _CONTACTS}
        none = torch.zeros_like(env.state.mask[:, -env.robots :])
        self._ends = dict.fromkeys(("success", "timeout", "failed"), none)

    def add(self, after: Any, alive: Tensor) -> None:
        """Keep a decision of the episodes that are ``alive`` (B,) bool."""
        robots, runs = self._env.robots, alive.view(-1, 1, 1)
        flags, info = after["robots", "info"], after["agents", "info"]
        for name, where in _CONTACTS.items():
            self._parts[name].append(info[where][:, -robots:] & flags[name].unsqueeze(-1) & runs)
        for name, before in self._ends.items():
            self._ends[name] = before | (flags[name] & alive.unsqueeze(1))
        last = self._parts["heading"][-1][..., -1:]
        turned = self._env.state.heading[:, -robots:].unsqueeze(-1) - last
        turned = torch.where(runs, torch.atan2(turned.sin(), turned.cos()), 0.0)
        points = round(self._env.decision_dt / TRACE_SECONDS)
        part = last + turned * torch.arange(1, points + 1, device=last.device) / points
        self._parts["heading"].append(part)

    def fields(self) -> dict[str, Tensor]:
        """Return the fields of a `RobotRollout`."""
        result = self._ends | {name: torch.cat(some, -1) for name, some in self._parts.items()}
        return {name: value.cpu() for name, value in result.items()}


def robot_row(name: str, rollout: RobotRollout) -> dict[str, Any]:
    """Return the metrics of a robot's policy with their 95 % intervals, and what became of each robot.

    ``n`` are episodes, intervals are over episodes; `pedzoo.metrics.robots.LEGEND` says what metrics are.
    """
    metrics, intervals = summarised(robot_metrics(rollout))
    flags = {
        "success": rollout.success,
        "collision_person": rollout.person_contact.any(-1),
        "collision_robot": rollout.robot_contact.any(-1),
        "collision_wall": rollout.wall_contact.any(-1),
        "timeout": rollout.timeout,
        "failed": rollout.failed,
    }
    seconds, each = rollout.there.sum(-1) * TRACE_SECONDS, []
    for episode, robot in product(range(len(seconds)), range(rollout.robots)):
        known = {key: bool(value[episode, robot]) for key, value in flags.items()}
        known |= {"duration_s": round(float(seconds[episode, robot]), 1)}
        each.append({"episode": episode, "robot": robot, **known})
    where = {"name": name, "case": {}, "decision_dt_s": rollout.walked.decision_dt}
    numbers = {"n": len(rollout.walked.failed), "metrics": metrics, "ci95": intervals}
    return where | numbers | {"per_agent": each}
