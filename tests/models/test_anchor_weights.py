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


def futures(model: AnchorForecaster, batch: TensorDict) -> tuple[Tensor, Tensor]:
    """Return the 20 modes (1, 20, A, 12, 2) and the best guess (1, 1, A, 12, 2) as positions, metres."""
    both = model.candidates(batch, 20, STEPS), model.mode(batch, STEPS)
    modes, guess = (path.detach().cumsum(3) for path in both)
    return modes, guess


def farthest(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> float:
    """Return the largest distance between equal futures, metres; modes that are as likely may swap."""
    modes, others = (both[0][0].movedim(0, 1) for both in (first, second))  # (A, 20, 12, 2)
    apart = (modes.unsqueeze(2) - others.unsqueeze(1)).norm(dim=-1).amax(-1)
    guess = (first[1] - second[1]).norm(dim=-1).max()
    return float(torch.stack((apart.amin(2).max(), apart.amin(1).max(), guess)).max())


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
    modes, guess = (geometry.turn_to_scene(path, pose) for path in usual)
    assert farthest(futures(model, turned), (modes, guess)) < 5e-3
    order = torch.randperm(people, generator=torch.Generator().manual_seed(1))
    permuted = cast("TensorDict", batch.clone())
    permuted["agents"] = agents[:, order]
    modes, guess = (path[:, :, order] for path in usual)
    assert farthest(futures(model, permuted), (modes, guess)) < 1e-3
    # no two people have the same futures, so this can fail
    assert people == 1 or farthest(futures(model, permuted), usual) > 0.1
