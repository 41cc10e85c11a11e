"""Hand-made scene batches for tests."""

from collections.abc import Sequence
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of, scene_batch
from pedzoo.maps.bank import MapBank
from pedzoo.models.base import Forecaster

STEPS = 8


def make_batch(
    sizes: Sequence[int],
    goal: bool = True,
    partly: bool = False,
    dtype: torch.dtype = torch.float32,
    padding: float = float("nan"),
    steps: int = STEPS,
    seed: int = 0,
    maps: MapBank | None = None,
) -> TensorDict:
    """Return scenes of ``sizes`` people who walk with a random, wavering velocity.

    Args:
        sizes: People in each scene.
        goal: With ``window_end`` goals.
        partly: Some people leave, and one is lost from sight for two steps.
        dtype: Of all positions.
        padding: What stands in empty slots: code that reads it fails the test.
        steps: Future steps.
        seed: Of every person's walk.
        maps: Floor plans; None for none.
    """
    random = torch.Generator().manual_seed(seed)
    scenes, people = len(sizes), max(sizes)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=random, dtype=torch.float64).to(dtype)

    mask = torch.arange(people) < torch.tensor(sizes).unsqueeze(1)
    speed = 0.5 * torch.nn.functional.normalize(normal(scenes, people, 1, 2), dim=-1)
    moved = speed + 0.06 * normal(scenes, people, 8 + steps, 2)
    xy = 4 * normal(scenes, people, 1, 2) + moved.cumsum(2)
    known = torch.ones(scenes, people, 8 + steps, dtype=torch.bool)
    if partly:
        known[0, 0, 8 + steps // 2 :] = False
        known[-1, 0, 9:11] = False
        known[-1, 1, 8:] = False
    for step in range(8, 8 + steps):
        # as recordings do: where a person is not seen stands their last known position
        xy[:, :, step] = torch.where(known[:, :, step, None], xy[:, :, step], xy[:, :, step - 1])
    xy[~mask] = padding
    history, future = xy.split((8, steps), 2)
    speed = speed.norm(dim=-1) / 0.4
    goals = {}
    if goal:
        to_goal = torch.nn.functional.normalize(xy[:, :, -1] - history[:, :, -1], dim=-1)
        goals = {"goal": xy[:, :, -1], "desired_velocity": speed * to_goal}
    return scene_batch(
        maps=MapBank() if maps is None else maps,
        map_id=torch.full((scenes, 1), -1),
        pose=geometry.identity_pose(scenes).to(dtype),
        history=history,
        valid=known[..., :8] & mask[..., None],
        mask=mask,
        pref_speed=speed,
        future=future,
        future_valid=known[..., 8:] & mask[..., None],
        **goals,
    )


def changed(batch: TensorDict, **agents: Tensor) -> TensorDict:
    """Return a copy of a batch with other values for its people."""
    copy = cast("TensorDict", batch.clone())
    for key, value in agents.items():
        agents_of(copy)[key] = value
    return copy


def on_plan(batch: TensorDict, bank: MapBank, row: int = 0, pose: Tensor | None = None) -> TensorDict:
    """Return a copy of a batch whose scenes are on the floor plan ``row`` of a bank."""
    copy = changed(batch)
    copy.set_non_tensor("maps", bank)
    copy["map_id"] = torch.full_like(batch["map_id"], bank.grids[row].map_id)
    if pose is not None:
        copy["scene_pose"] = pose
    return copy


def of_people(batch: TensorDict, key: str) -> Tensor:
    """Return ``key`` of all people of a batch (P, ...), in the order of scenes."""
    agents = agents_of(batch)
    return agents[key][agents["mask"]]


def random_weights(model: Forecaster, seed: int = 0) -> Forecaster:
    """Draw all parameters anew, those that start at zero included, and return the model."""
    random = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            noise = torch.randn(parameter.shape, generator=random, dtype=torch.float64)
            parameter.copy_(0.3 * noise)
    return model
