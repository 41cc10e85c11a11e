"""Policies walk whole episodes; all values for metrics and pictures are recorded."""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar, cast

import torch
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError, at_least_one
from pedzoo.core.geometry import limit_speed
from pedzoo.core.machine import usable, usual_physics
from pedzoo.core.spec import Spec
from pedzoo.core.types import TOP_SPEED_RATIO
from pedzoo.policies.load import load_policy
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams
from pedzoo.policies.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, physics_class
from pedzoo.sim.rollout import RobotRollout, Rollout, joined, rollout_of
from pedzoo.sim.scenario import PreparedScenario, Scenario, planned
from pedzoo.sim.state import State

Progress = Callable[[str, int, int], None]
"""Called with the policy, episodes done and episodes in all."""

ShareDone = Callable[[float], None]
"""Called with the share of the work that is done."""

Episodes = TypeVar("Episodes", Rollout, RobotRollout)


def rollout(
    policy: str,
    scenario: str | Spec | PreparedScenario,
    physics: str | None = None,
    episodes: int = 20,
    seed: int = 0,
    deterministic: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> tuple[Rollout, PedestrianEnv]:
    """Return what a policy did in the first scenes of a seed, and the environment.

    Its physics, ``env.physics``, is still open: pictures are taken there.

    Args:
        policy: Its name with settings, or a mixed crowd, as of `pedzoo.policies.load.load_policy`.
        scenario: Its name with settings, or a prepared one.
        physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class``; None for the variable
            ``PEDZOO_PHYSICS``, or bullet, or compiled where there is no pybullet.
        episodes: E.
        seed: Of the scenes.
        deterministic: Without noise.
        progress: Called with the policy, episodes done and episodes in all.
        settings: More of `pedzoo.make_env`.

    Raises:
        UserError: An unknown name or setting, or a decision step that the policy cannot serve.
    """
    walks, env = prepare(policy, scenario, physics or usual_physics(), episodes, seed, **settings)
    parts = list(walk(walks, env, episodes, deterministic, progress))
    return joined(parts), env


def prepare(
    policy: str,
    scenario: str | Spec | Scenario | PreparedScenario,
    physics: str,
    episodes: int,
    seed: int = 0,
    **settings: Any,
) -> tuple[Policy | Walker, PedestrianEnv]:
    """Return a policy and the environment in which it decides as often as it can; errors as of `rollout`."""
    if not isinstance(policy, str):
        raise UserError(f"policy {policy!r:.200}: expected one name; pedzoo.evaluate takes several")
    episodes = at_least_one("episodes", episodes)
    walks = load_policy(policy)
    wanted = settings.pop("decision_dt", None)
    if wanted is not None and not math.isclose(wanted, walks.decision_dt):
        why = f"its setting dt says so, {policy}:dt=..."
        if isinstance(walks, Teams):
            why = "its fastest team does"
        elif isinstance(walks, Walker):
            why = "it was trained on that step"
        raise UserError(f"{policy} decides every {walks.decision_dt} s, not every {wanted} s: {why}")
    runs = -(-episodes // physics_class(physics).scenes_at_once)
    settings |= {"physics": physics, "seed": seed, "decision_dt": walks.decision_dt}
    if (device := settings.get("device", "cpu")) != "cpu":
        walks = walks.to(usable(device))
    env = make_env(scenario, num_envs=-(-episodes // runs), **settings)
    env.policy_name = policy
    return walks, env


def walk(
    policy: Policy | Walker,
    env: PedestrianEnv,
    episodes: int,
    deterministic: bool = False,
    progress: Progress | None = None,
) -> Iterator[Rollout]:
    """Yield the episodes of ``env``, as many at once as it has scenes, until there are ``episodes``."""
    tell = partial(progress, env.policy_name) if progress else lambda *_: None
    return in_parts(partial(run, policy, env), episodes, deterministic, lambda done: tell(done, episodes))


def walked(
    policy: str,
    scenario: PreparedScenario,
    physics: str,
    episodes: int,
    seed: int = 0,
    deterministic: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> Iterator[Rollout]:
    """Yield what `rollout` returns in parts: large crowds do not fit into memory at once."""
    walks, env = prepare(policy, scenario, physics, episodes, seed, **settings)
    try:
        yield from walk(walks, env, episodes, deterministic, progress)
    finally:
        env.physics.close()


def in_parts(
    run: Callable[[Callable[[int], None]], Episodes],
    episodes: int,
    deterministic: bool,
    tell: Callable[[int], None],
) -> Iterator[Episodes]:
    """Yield what ``run`` returns without gradients, until there are ``episodes``, the last part cut.

    ``run`` gets a function to call with the number of its episodes that are over, ``tell`` that of all.
    """
    done = 0
    while done < episodes:

        def ended(number: int, done: int = done) -> None:
            tell(min(done + number, episodes))

        exploration = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
        with torch.no_grad(), set_exploration_type(exploration):
            part = run(ended).episodes(slice(episodes - done))
        done += len(part.failed)
        yield part


def run(policy: Policy | Walker, env: PedestrianEnv, ended: Callable[[int], None] | None = None) -> Rollout:
    """Return one episode of every scene of ``env``; ``ended`` gets the number of those that are over."""
    now = env.reset()
    recorder = Recorder(env)
    while recorder.alive.any():
        result = env.step(policy(now))
        changed, agents = None, agents_of(result)
        if "unconstrained_action" in agents.keys():  # by how much a safety layer changed possible steps
            wanted, pref_speed = (
                cast("Tensor", agents[key]) for key in ("unconstrained_action", "pref_speed")
            )
            possible = limit_speed(wanted, TOP_SPEED_RATIO * pref_speed[..., 0])
            changed = env.decision_dt * (cast("Tensor", agents["action"]) - possible).norm(dim=-1)
        recorder.add(result["next"], changed=changed)
        if ended:
            ended(int((~recorder.alive).sum()))
        now = step_mdp(result)
    return recorder.rollout()


class Recorder:
    """Keeps one episode of every scene of an environment that has just begun them.

    Attributes:
        alive: Which episodes still run (B,) bool.
        state: The scenes after the latest decision.
        progress: Metres of the planner's ways that agents have covered (B, A), as long as episodes ran.
    """

    def __init__(self, env: PedestrianEnv) -> None:
        """Take the environment, after its `reset`."""
        self._env, self._start = env, env.state
        self.state = self._start
        self.alive = torch.ones(env.batch_size, dtype=torch.bool, device=env.device)
        self._overdue, self._failed = self.state.overdue, self.state.failed
        self.progress = _progress(self.state)
        self._steps: list[dict[str, Tensor]] = []

    def add(self, after: Any, done: Tensor | None = None, changed: Tensor | None = None) -> None:
        """Keep a decision; scenes that were over stay as they ended.

        Args:
            after: ``next`` of the environment's step.
            done: Which episodes end with it (B,) bool; None for what the environment says.
            changed: Metres by which a safety layer changed it (B, A); None without one.
        """
        before, self.state, alive = self.state, self._env.state, self.alive
        info, slots = after["agents", "info"], alive.unsqueeze(1)
        shape = info["reached"].shape
        # no agent walked where the policy gave no number
        present = (before.mask & slots & ~self.state.failed.unsqueeze(1)).unsqueeze(2).expand(shape)
        step = {"present": present, "controlled": present & before.controlled.unsqueeze(2)}
        step |= {key: info[key] for key in ("trace", "reached")}
        step |= {key: info[key] & present for key in ("agent_contact", "wall_contact")}
        step |= {key: getattr(before, key).unsqueeze(2).expand(shape) for key in ("person", "planned")}
        step["goal"] = before.goal_point.unsqueeze(2).expand(*shape, -1)
        if self._steps:
            for key in ("trace", "goal", "reached", "person", "planned"):
                running = alive.view(-1, *[1] * (step[key].dim() - 1))
                step[key] = torch.where(running, step[key], self._steps[-1][key][:, :, -1:])
        if changed is not None:
            step["changed"] = changed.unsqueeze(2).expand(shape)
        self._steps.append(step)
        self._overdue = torch.where(slots, self.state.overdue, self._overdue)
        self._failed = torch.where(alive, self.state.failed, self._failed)
        self.progress = torch.where(slots, _progress(self.state), self.progress)
        self.alive = alive & ~(after["done"][:, 0] if done is None else done)

    def rollout(self) -> Rollout:
        """Return the episodes, on the CPU."""
        stored = [{key: value.cpu() for key, value in step.items()} for step in self._steps]
        ends = {"overdue": self._overdue.cpu(), "failed": self._failed.cpu()}
        start, decision_dt = self._start.to("cpu"), self._env.decision_dt
        return rollout_of(self._env.scenario, start, stored, **ends, decision_dt=decision_dt)


def _progress(state: State) -> Tensor:
    """Return how far agents have come on the planner's ways to their goals (B, A), metres."""
    return state.planned - planned(state.remaining_path)
