"""Policies walk whole episodes, and everything that metrics and pictures need is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from pedzoo.errors import UserError
from pedzoo.models.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.policy import Policy, load_policy

AT_ONCE = {"grid": 64, "bullet": 16}
"""Scenes run together: pybullet asks about one after the other, so more of them bring nothing."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Rollout:
    """E episodes of A people, on a trace of T points every 0.1 s after the warm start.

    Attributes:
        trace: Positions (E, A, T, 2), metres.
        present: Who is there, the episode still running (E, A, T) bool.
        agent_contact: A body was touched in that 0.1 s (E, A, T) bool; false where nobody is.
        wall_contact: A wall was (E, A, T) bool.
        reached: Goals reached until then (E, A, T) long.
        late: A goal was not reached in time (E, A) bool.
        failed: The policy gave no number (E,) bool.
        mask: Who was there at the beginning (E, A) bool.
        past: The warm start (E, A, 29, 2), its last point is where the episode begins.
        pref_speed: The speed that people like (E, A), m/s.
        way: Length of the way to the first goal (E, A), metres.
        map_id: Floor plan (E,) long.
        pose: Scene poses (E, 4).
        goals: Goals that everybody had to reach.
    """

    trace: Tensor
    present: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    late: Tensor
    failed: Tensor
    mask: Tensor
    past: Tensor
    pref_speed: Tensor
    way: Tensor
    map_id: Tensor
    pose: Tensor
    goals: int


def rollout(
    policy: str,
    scenario: str,
    world: str = "bullet",
    episodes: int = 20,
    seed: int = 0,
    deterministic: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> tuple[Rollout, PedestrianEnv]:
    """Return what ``policy`` did in the first ``episodes`` scenes of a seed, and the environment.

    Args:
        policy: Its name with settings.
        scenario: Its name with settings.
        world: ``bullet`` or ``grid``.
        episodes: E.
        seed: Of the scenes.
        deterministic: Without noise.
        progress: Called with the policy, episodes done and episodes in all.
        settings: More of `pedzoo.make_env`.

    Raises:
        UserError: An unknown name or setting, or a decision step that the policy cannot serve.
    """
    if episodes < 1:
        raise UserError(f"episodes {episodes}: expected at least 1")
    walks = load_policy(policy)
    runs = -(-episodes // AT_ONCE.get(world, 1))
    settings = {"decision_dt": walks.decision_dt, **settings}
    if settings["decision_dt"] != walks.decision_dt:
        raise UserError(
            f"{policy} decides every {walks.decision_dt} s, not every {settings['decision_dt']} s"
        )
    env = make_env(scenario, num_envs=-(-episodes // runs), world=world, seed=seed, **settings)
    env.policy_name = policy
    walks.bind(env.bank)
    parts, done = [], 0
    with torch.no_grad(), set_exploration_type(_exploration(deterministic)):
        while done < episodes:
            part = _first(run(walks, env), episodes - done)
            parts.append(part)
            done += len(part.failed)
            if progress:
                progress(policy, done, episodes)
    return _joined(parts), env


def run(policy: Policy | Walker, env: PedestrianEnv) -> Rollout:
    """Return one episode of every scene of ``env``, from its reset to the end of the last one."""
    now = env.reset()
    start = env.state
    alive = torch.ones(env.batch_size, dtype=torch.bool)
    steps: list[TensorDict] = []
    while alive.any():
        there = now["agents", "mask"] & alive.unsqueeze(1)
        result = env.step(policy(now))
        after: Any = result["next"]
        info = after["agents", "info"].select("trace", "agent_contact", "wall_contact", "reached", "late")
        steps.append(info.set("present", there.unsqueeze(-1).expand_as(info["agent_contact"])))
        alive = alive & ~after["done"][:, 0]
        now = step_mdp(result)
    points = {
        key: torch.cat([step[key] for step in steps], dim=2)
        for key in ("trace", "present", "agent_contact", "wall_contact", "reached")
    }
    for key in ("agent_contact", "wall_contact"):
        points[key] = points[key] & points["present"]
    return Rollout(
        **points,
        late=env.state.late,
        failed=env.state.failed,
        mask=start.mask,
        past=start.past,
        pref_speed=start.pref_speed,
        way=start.way,
        map_id=start.map_id,
        pose=start.pose,
        goals=env.scenario.goals,
    )


def _exploration(deterministic: bool) -> ExplorationType:
    return ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM


def _first(part: Rollout, episodes: int) -> Rollout:
    """Return at most so many episodes."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    return Rollout(**{key: value[:episodes] if key != "goals" else value for key, value in values.items()})


def _joined(parts: list[Rollout]) -> Rollout:
    """Join rollouts of the same environment; shorter ones stand still, absent, until the longest ends."""
    longest = max(part.trace.shape[2] for part in parts)

    def grown(value: Tensor, name: str) -> Tensor:
        missing = longest - value.shape[2]
        last = value[:, :, -1:].expand(*value.shape[:2], missing, *value.shape[3:])
        return torch.cat((value, torch.zeros_like(last) if value.dtype == torch.bool else last), dim=2)

    joined: dict[str, Any] = {"goals": parts[0].goals}
    for field in fields(Rollout):
        if field.name == "goals":
            continue
        values = [getattr(part, field.name) for part in parts]
        if field.name in ("trace", "present", "agent_contact", "wall_contact", "reached"):
            values = [grown(value, field.name) for value in values]
        joined[field.name] = torch.cat(values)
    return Rollout(**joined)
