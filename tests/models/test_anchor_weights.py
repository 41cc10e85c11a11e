"""Shipped weights with anchors: turned, moved and permuted scenes have the same futures."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from helpers.batches import changed, make_batch
from helpers.futures import farthest_futures, futures
from tensordict import TensorDict

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of
from pedzoo.models.blocks.anchored import AnchorForecaster
from pedzoo.models.zoo.loading import load

WEIGHTS = ("anchors.zara1_pred12", "anchor_mlp.zara1_pred12", "anchor_net.zara1_pred12")
STEPS = 12


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize("people", [1, 2, 50, 200])
def test_turned_moved_and_permuted_scenes_have_the_same_futures(name: str, people: int) -> None:
    model = cast("AnchorForecaster", load(name))
    batch = make_batch((people,), goal=False)
    agents = agents_of(batch)
    usual = futures(model, batch, STEPS)
    pose = torch.tensor([[1.1, 1.0, 30.0, -20.0]])
    there = geometry.move_to_scene(agents["history"], pose)
    turned = changed(batch, history=there, velocity=geometry.turn_to_scene(agents["velocity"], pose))
    modes, guess = (geometry.turn_to_scene(path, pose) for path in usual)
    assert farthest_futures(futures(model, turned, STEPS), (modes, guess)) < 5e-3
    order = torch.randperm(people, generator=torch.Generator().manual_seed(1))
    permuted = cast("TensorDict", batch.clone())
    permuted["agents"] = agents[:, order]
    modes, guess = (path[:, :, order] for path in usual)
    assert farthest_futures(futures(model, permuted, STEPS), (modes, guess)) < 1e-3
    # no two people have the same futures, so this can fail
    assert people == 1 or farthest_futures(futures(model, permuted, STEPS), usual) > 0.1
