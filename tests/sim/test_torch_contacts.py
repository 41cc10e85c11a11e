"""Contacts of the torch backend: many scenes at once as each alone, the compiled loop as torch."""

from __future__ import annotations

import pytest
import torch

from pedzoo.sim.arrival import arrived
from pedzoo.sim.make import make_env
from pedzoo.sim.physics.torch import contacts_of
from pedzoo.sim.physics_parts.compiled import events_compiled
from pedzoo.sim.step_result import MotionInput


@pytest.mark.parametrize(("scenes", "agents"), [(40, 5), (7, 1), (6, 3)])
def test_scenes_together_have_the_contacts_of_each_alone(scenes: int, agents: int) -> None:
    draw = torch.Generator().manual_seed(0)
    path = 2 * torch.rand(2, 3, 4, scenes, agents, generator=draw)
    present = torch.rand(scenes, agents, generator=draw) > 0.2
    radius = 0.1 + 0.1 * torch.rand(scenes, agents, generator=draw)
    together = contacts_of(path, None, present, radius).agent
    alone = [contacts_of(path[:, :, :, [i]], None, present[[i]], radius[[i]]).agent for i in range(scenes)]
    assert torch.equal(together, torch.cat(alone))
    assert together.any() == (agents > 1)
    assert not together[~present].any()


@pytest.mark.parametrize("scenario", ["goals:map=apartment.7,people=5", "circle:people=5"])
def test_the_compiled_loop_finds_the_events_that_torch_finds(scenario: str) -> None:
    env = make_env(scenario, num_envs=40, physics="torch")
    env.reset()
    draw = torch.Generator().manual_seed(1)
    away = 0.3 * torch.randn(40, 5, 2, generator=draw)
    near = env.state.position[:, :1] + away  # close together
    state = env.state._replace(
        mask=torch.rand(40, 5, generator=draw) > 0.2, radius=0.1 + 0.2 * torch.rand(40, 5, generator=draw)
    )
    state = state._replace(goal_point=near + 0.5 * torch.randn(40, 5, 2, generator=draw))
    walk = 0.03 * torch.randn(2, 16, 40, 5, generator=draw)
    path = near.movedim(-1, 0).unsqueeze(1) + walk.cumsum(1)
    wanted = torch.rand(40, 5, generator=draw) > 0.3
    inputs = MotionInput(torch.zeros(2, 4, 40, 5), state.mask, 4, None, wanted, None)
    agent, wall, reached = events_compiled(env.bank, path, state, inputs)
    walls = env.bank.walls_of_state(state.wall_frame, state.wall_place)
    steps = path.unflatten(1, (4, 4))
    gap = None if walls is None else walls.half_planes(steps, state.radius)[0]
    expected = contacts_of(steps, gap, state.mask, state.radius)
    assert torch.equal(agent, expected.agent) and 0 < agent.float().mean() < 1
    assert torch.equal(wall, expected.wall) and wall.any() == (walls is not None)
    assert torch.equal(reached, arrived(path, state.goal_point, inputs)) and reached.any()
