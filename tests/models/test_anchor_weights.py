"""Shipped weights with anchors: turned, moved and permuted scenes have the same futures."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from helpers.batches import changed, make_batch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of
from pedzoo.models.blocks.anchored.forecaster import AnchorForecaster
from pedzoo.models.zoo.loading import load

WEIGHTS = ("anchors.zara1_pred12", "anchor_mlp.zara1_pred12", "anchor_net.zara1_pred12")
STEPS = 12


def futures(model: AnchorForecaster, batch: TensorDict) -> Tensor:
    """Return the 20 modes and the best guess (1, 21, A, 12, 2) as positions, metres."""
    both = model.candidates(batch, 20, STEPS), model.mode(batch, STEPS)
    return torch.cat(both, 1).detach().cumsum(3)


def farthest(first: Tensor, second: Tensor) -> float:
    return float((first - second).norm(dim=-1).max())


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize("people", [1, 2, 50, 200])
def test_turned_moved_and_permuted_scenes_have_the_same_futures(name: str, people: int) -> None:
    model = cast("AnchorForecaster", load(name))
    batch = make_batch((people,), goal=False)
    agents = agents_of(batch)
    usual = futures(model, batch)
    pose = torch.tensor([[1.1, 1.0, 30.0, -20.0]])
    there = geometry.move_to_scene(agents["history"], pose)
    turned = changed(batch, history=there, velocity=geometry.turn_to_scene(agents["velocity"], pose))
    assert farthest(futures(model, turned), geometry.turn_to_scene(usual, pose)) < 5e-3
    order = torch.randperm(people, generator=torch.Generator().manual_seed(1))
    permuted = cast("TensorDict", batch.clone())
    permuted["agents"] = agents[:, order]
    assert farthest(futures(model, permuted), usual[:, :, order]) < 1e-3
    # of a network that answers the same to everything this would hold, too
    assert farthest(usual[:, :, :1], usual[:, :, -1:]) > 0.1 or people == 1
