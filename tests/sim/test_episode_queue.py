"""Episodes made ahead: rows that begin anew have all fields of their new episode."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pedzoo.policies.load import load_policy
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.make import make_env

SCENES = 6


def env_of(physics: str = "compiled") -> PedestrianEnv:
    return make_env("goals:map=apartment.7,people=2,goals=1", num_envs=SCENES, physics=physics)


def until_one_ends(env: PedestrianEnv, batch: object) -> Tensor:
    """Walk until scenes end, and begin these anew: which did (B,) bool."""
    policy = load_policy("go_to_goal")
    with torch.no_grad():
        while True:
            before, batch = env.step_and_maybe_reset(policy(batch))
            ended = before["next", "done"][:, 0]
            if ended.any():
                return ended


@pytest.mark.parametrize("physics", ["compiled", "torch"])
def test_fields_that_are_the_same_in_all_episodes_are_not_copied(physics: str) -> None:
    env = env_of(physics)
    batch = env.reset()
    radius, past = env.state.radius, env.state.past
    assert not until_one_ends(env, batch).all()
    assert env.state.radius is radius
    assert env.state.past is not past
    env.reset()
    assert env.state.radius is radius


def test_changed_fields_are_those_of_the_new_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    env = env_of()
    batch = env.reset()
    begin = Episodes.begin

    def wider(self: Episodes, draws: object) -> object:
        state = begin(self, draws)  # type: ignore[arg-type]
        return state._replace(radius=state.radius + 0.1)

    monkeypatch.setattr(Episodes, "begin", wider)
    ended = until_one_ends(env, batch)
    expected = torch.where(ended, 0.25, 0.15).unsqueeze(1).expand(SCENES, 2)
    assert 0 < int(ended.sum()) < SCENES
    assert torch.allclose(env.state.radius, expected)
    env.reset()
    assert torch.allclose(env.state.radius, torch.full((SCENES, 2), 0.25))


def test_rows_begin_the_episodes_of_their_numbers() -> None:
    env = env_of()
    ended = until_one_ends(env, env.reset())
    other = make_env("goals:map=apartment.7,people=2,goals=1", num_envs=SCENES, first_episode=SCENES)
    other.reset()
    for name, mine, theirs in zip(env.state._fields, env.state, other.state, strict=True):
        assert torch.equal(mine[ended], theirs[ended]), name
