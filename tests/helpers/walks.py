"""Walks: rollouts made by hand, people of a controller, and a policy that fails."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.envs import step_mdp

from pedzoo.core.geometry import identity_pose
from pedzoo.policies.controller.controller import Controller
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.state import State

Host = Callable[[int, NDArray[Any], NDArray[Any]], NDArray[Any]]
"""How a host moves people: the call, their places and the velocities that it was told give new places."""

BROKEN = '''
from pedzoo.policies.policy import Policy


class Broken(Policy):
    """Walks to the goal until, after 0.8 s, it has no number for a person in the first scene."""

    def __init__(self):
        super().__init__(0.4)
        self.in_keys = [*self.in_keys, "time"]

    def forward(self, tensordict):
        action = tensordict["agents", "desired_velocity"].clone()
        if tensordict["time"][0] > 0.6:
            action[0, 1] = float("nan")
        tensordict["agents", "action"] = action
        return tensordict
'''
"""A policy of a file."""


def made(path: Tensor, present: Tensor | None = None, **more: Any) -> Rollout:
    """Return the rollout of people who walk ``path`` (E, A, 1 + T, 2), metres, and reach no goal.

    All are there until the end unless ``present`` (E, A, T) says otherwise; ``more`` are fields of their
    own instead of those made up here.
    """
    episodes, agents, points = path.shape[0], path.shape[1], path.shape[2] - 1
    there = torch.ones(episodes, agents, points, dtype=torch.bool) if present is None else present
    people = torch.zeros(episodes, agents)
    fields = {
        "trace": path[:, :, 1:],
        "goal": path[:, :, -1:].expand(-1, -1, points, -1),
        "present": there,
        "controlled": there,
        "person": torch.arange(agents).view(1, -1, 1).expand(episodes, -1, points),
        "planned": torch.ones(episodes, agents, points),
        "agent_contact": torch.zeros_like(there),
        "wall_contact": torch.zeros_like(there),
        "reached": torch.zeros(episodes, agents, points, dtype=torch.long),
        "overdue": people.bool(),
        "failed": torch.zeros(episodes, dtype=torch.bool),
        "mask": ~people.bool(),
        "past": path[:, :, :1].expand(-1, -1, 29, -1),
        "pref_speed": people + 1.0,
        "first_path_length": people + 1.0,
        "radius": torch.full_like(people + 1.0, 0.15),
        "kind": torch.zeros_like(people, dtype=torch.long),
        "map_id": torch.full((episodes,), -1),
        "pose": identity_pose(episodes),
        "goals": 1,
    }
    return Rollout(**fields | more)


def straight(speed: float = 1.3, points: int = 200, start: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    """Return a path (1 + T, 2) along x at ``speed``, m/s."""
    x = start[0] + 0.1 * speed * torch.arange(points + 1, dtype=torch.float64)
    return torch.stack((x, torch.full_like(x, start[1])), dim=-1)


def as_desired(
    env: PedestrianEnv, steps: int, drift: tuple[float, float] = (0.0, 0.0)
) -> tuple[list[Any], list[State]]:
    """Return what is seen, and the states, before each decision and at the end.

    People walk where they desire, plus a velocity of ``drift``, m/s.
    """
    now: Any = env.reset()
    seen, states = [now.clone()], [env.state]
    for _ in range(steps):
        now["agents", "action"] = now["agents", "desired_velocity"] + torch.tensor(drift)
        now = step_mdp(env.step(now))
        seen.append(now.clone())
        states.append(env.state)
    return seen, states


def hosted(
    controller: Controller,
    start: NDArray[Any],
    goals: dict[int, Any],
    seconds: float,
    velocities: Any = None,
    host: Host | None = None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return where people are after every call (T + 1, N, 2), metres, and what was answered (T, N, 2), m/s.

    ``goals`` are those by call: {call: {person: goal}}; ``velocities`` those of the first call.
    """
    place, path, answers = start.copy(), [start], []
    for call in range(round(seconds / controller.dt)):
        answer = controller.step(dict(enumerate(place)), goals.get(call), velocities if call == 0 else None)
        velocity = np.array(list(answer.values()))
        place = place + controller.dt * velocity if host is None else host(call, place, velocity)
        path.append(place)
        answers.append(velocity)
    return np.array(path), np.array(answers)
