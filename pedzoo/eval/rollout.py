"""Policies walk whole episodes, and everything that metrics and pictures need is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from pedzoo.core import renamed
from pedzoo.core.errors import UserError
from pedzoo.core.machine import usable
from pedzoo.core.spec import Spec
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.load import load_policy
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, physics_class
from pedzoo.sim.rollout import Rollout, joined, rollout_of
from pedzoo.sim.scenario_parts.scenario import PreparedScenario, Scenario
from pedzoo.sim.state import State

Progress = Callable[[str, int, int], None]


@renamed.takes_world
def rollout(
    policy: str,
    scenario: str | Spec,
    physics: str = "bullet",
    episodes: int = 20,
    seed: int = 0,
    deterministic: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> tuple[Rollout, PedestrianEnv]:
    """Return what ``policy`` did in the first ``episodes`` scenes of a seed, and the environment.

    Its physics, ``env.physics``, is still open: pictures are taken there.

    Args:
        policy: Its name with settings, or a mixed crowd, as of `pedzoo.policies.load.load_policy`.
        scenario: Its name with settings.
        physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class``.
        episodes: E.
        seed: Of the scenes.
        deterministic: Without noise.
        progress: Called with the policy, episodes done and episodes in all.
        settings: More of `pedzoo.make_env`.

    Raises:
        UserError: An unknown name or setting, or a decision step that the policy cannot serve.
    """
    walks, env = prepare(policy, scenario, physics, episodes, seed, **settings)
    parts = list(walk(walks, env, episodes, deterministic, progress))
    return joined(parts), env


@renamed.takes_world
def prepare(
    policy: str,
    scenario: str | Spec | Scenario | PreparedScenario,
    physics: str,
    episodes: int,
    seed: int = 0,
    **settings: Any,
) -> tuple[Policy | Walker, PedestrianEnv]:
    """Return a policy and the environment in which it decides as often as it can; errors as of `rollout`."""
    if episodes < 1:
        raise UserError(f"episodes {episodes}: expected at least 1")
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
    done = 0
    while done < episodes:

        def tell(ended: int, done: int = done) -> None:
            if progress:
                progress(env.policy_name, min(done + ended, episodes), episodes)

        exploration = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
        with torch.no_grad(), set_exploration_type(exploration):
            part = run(policy, env, tell).episodes(slice(episodes - done))
        done += len(part.failed)
        yield part


def run(policy: Policy | Walker, env: PedestrianEnv, ended: Callable[[int], None] | None = None) -> Rollout:
    """Return one episode of every scene of ``env``, from its reset to the end of the last one.

    Args:
        policy: Decides.
        env: The scenes.
        ended: Called after every decision with the number of episodes that are over.
    """
    now = env.reset()
    start = before = env.state
    alive = torch.ones(env.batch_size, dtype=torch.bool, device=env.device)
    overdue, failed = start.overdue, start.failed
    steps: list[dict[str, Tensor]] = []
    while alive.any():
        result = env.step(policy(now))
        after: Any = result["next"]
        state = env.state
        steps.append(_kept(after, before, state, alive, steps[-1] if steps else None))
        overdue = torch.where(alive.unsqueeze(1), state.overdue, overdue)
        failed = torch.where(alive, state.failed, failed)
        alive = alive & ~after["done"][:, 0]
        if ended:
            ended(int((~alive).sum()))
        before, now = state, step_mdp(result)
    kept = [{key: value.cpu() for key, value in step.items()} for step in steps]
    over = overdue.cpu(), failed.cpu()
    return rollout_of(env.scenario, start.to("cpu"), kept, *over, env.decision_dt)


def _kept(
    after: Any, before: State, state: State, alive: Tensor, last: dict[str, Tensor] | None
) -> dict[str, Tensor]:
    """Return what is kept of one decision: scenes that were over before it stay as they ended."""
    info = after["agents", "info"]
    points = info["reached"].shape[2]
    # where the policy gave no number nobody walked
    there = before.mask & (alive & ~state.failed).unsqueeze(1)
    kept = {key: info[key] for key in ("trace", "agent_contact", "wall_contact", "reached")}
    kept["present"] = there.unsqueeze(2).expand(-1, -1, points)
    kept["controlled"] = kept["present"] & before.controlled.unsqueeze(2)
    kept["goal"] = before.goal_point.unsqueeze(2).expand(-1, -1, points, -1)
    for key in ("person", "planned"):
        kept[key] = getattr(before, key).unsqueeze(2).expand(-1, -1, points)
    for key in ("agent_contact", "wall_contact"):
        kept[key] = kept[key] & kept["present"]
    if last is not None:
        for key in ("trace", "goal", "reached", "person", "planned"):
            running = alive.view(-1, *[1] * (kept[key].dim() - 1))
            kept[key] = torch.where(running, kept[key], last[key][:, :, -1:])
    return kept
