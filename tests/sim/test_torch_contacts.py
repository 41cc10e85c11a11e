"""Contacts of the torch backend: many scenes at once are as each of them alone."""

from __future__ import annotations

import pytest
import torch

from pedzoo.sim.physics.torch import contacts_of


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
