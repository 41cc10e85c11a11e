"""Which inputs a forecaster uses: how far its forecast moves when one is taken away, and what that costs."""

from collections.abc import Mapping
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.forecast import Sums, average, displacement_error
from pedzoo.models.base import Forecaster

NEAR = 2.0
"""Metres: others are taken away from people who have somebody so near."""

_AT_ONCE = 256  # scenes in a batch of one for every person


@torch.no_grad()
def input_use(
    model: Forecaster, batch: TensorDict, generator: torch.Generator | None = None, control: bool = True
) -> dict[str, tuple[Tensor, Mapping[str, Sums]]]:
    """Return how the most likely forecasts of a batch differ without each input of a model.

    These are distances (P, T) between the places of both forecasts, and by scene (B,) sums and numbers of
    people of: ``shift_m``, the mean distance; ``ade_m`` and ``ade_without_m``; ``gain_m``, what the second is
    above the first; all in metres. Inputs are taken away so:

    * ``others``: each person is alone in the scene; of people with somebody within `NEAR`.
    * ``others of another scene``: a control. Other people stand where theirs were; this must not help.
    * ``goal``, ``desired velocity``: those of a person who walks straight on.
    * ``map``: free floor everywhere.
    * ``noise``: one random sample, drawn by ``generator``, beside the most likely forecast.

    Without ``control`` there are no others of another scene, which take the most time, and no noise.
    """
    batch, agents, mask = batch.copy(), agents_of(batch).copy(), cast("Tensor", batch["agents", "mask"])
    batch.batch_size, agents.batch_size = mask.shape[:1], mask.shape  # Lightning loses them in 64-true
    batch.set("agents", agents)
    steps = agents["future"].shape[2]
    whole = model.mode(batch, steps)[:, 0]

    def compared(taken: Tensor, people: Tensor) -> tuple[Tensor, Mapping[str, Sums]]:
        shift = (whole - taken).cumsum(-2).norm(dim=-1)
        error = displacement_error(torch.stack((whole, taken), 1), agents["history"], agents["future"])
        errors, there = average(error, agents["future_valid"])
        there = there & people
        ade, without = errors.where(there.unsqueeze(1), 0).double().sum(2).unbind(1)
        count = there.sum(1)
        return shift[people], {
            "shift_m": (shift.mean(-1).where(people, 0).double().sum(1), people.sum(1)),
            "ade_m": (ade, count),
            "ade_without_m": (without, count),
            "gain_m": (without - ade, count),
        }

    near = _near(agents["history"][:, :, -1], mask)
    result = {"others": compared(alone(model, batch, steps), near)}
    if control:
        result["others of another scene"] = compared(among_strangers(model, batch, steps), near)
    for case, taken in without(batch, model.needs).items():
        result[case] = compared(model.mode(taken, steps)[:, 0], mask)
    if control and model.stochastic:
        result["noise"] = compared(model.sample(batch, 1, steps, generator)[:, 0], mask)
    return result


def _near(place: Tensor, mask: Tensor) -> Tensor:
    """Return who has somebody within `NEAR` (B, A) bool, of people at places (B, A, 2)."""
    distance = torch.cdist(place, place).masked_fill(~mask.unsqueeze(1), torch.inf)
    distance.diagonal(dim1=1, dim2=2).fill_(torch.inf)
    return mask & (distance.amin(2) < NEAR)


def alone(model: Forecaster, batch: TensorDict, steps: int) -> Tensor:
    """Return the most likely futures (B, A, T, 2) of people who are alone in the scene: displacements."""
    mask = cast("Tensor", batch["agents", "mask"])
    scene, slot = mask.nonzero(as_tuple=True)
    people = agents_of(batch)[scene, slot].unsqueeze(1)
    batches = cast("TensorDict", batch[scene]).exclude("agents").set("agents", people)
    return _of_people(model, batches, steps, 0 * slot, mask)


def among_strangers(model: Forecaster, batch: TensorDict, steps: int) -> Tensor:
    """Return the most likely futures (B, A, T, 2) of people among the others of another scene.

    Each person stands where somebody of that scene did, and that one's others stand around.
    """
    mask = cast("Tensor", batch["agents", "mask"])
    scene, slot = mask.nonzero(as_tuple=True)
    other = (scene + max(len(batch) // 2, 1)) % len(batch)  # windows next to each other share their people
    place, rows = mask[other].long().argmax(1), torch.arange(len(scene), device=mask.device)
    batches = cast("TensorDict", batch[other]).clone()
    person = cast("TensorDict", agents_of(batch)[scene, slot])
    agents = agents_of(batches)
    moved = person["history"][:, -1] - agents["history"][rows, place, -1]
    for key in ("history", "future", "goal"):
        if (value := agents.get(key, None)) is not None:
            agents.set(key, value + moved.view(-1, *(1,) * (value.dim() - 2), 2))
    agents[rows, place] = person
    for key in ("map_id", "scene_pose"):
        batches.set(key, batch.get(key)[scene])
    return _of_people(model, batches, steps, place, mask)


def without(batch: TensorDict, needs: frozenset[str]) -> dict[str, TensorDict]:
    """Return copies of a batch without a map, or with goal or desired velocity of walking straight on."""
    result, agents = {}, agents_of(batch)
    if "goal" in needs:
        history, steps = agents["history"], agents["future"].shape[2]
        step = history[:, :, -1] - history[:, :, -2]
        straight = {"goal": history[:, :, -1] + steps * step, "desired_velocity": step / STEP_SECONDS}
        for key, value in straight.items():
            result[key.replace("_", " ")] = batch.copy().set("agents", agents.copy().set(key, value))
    if "map" in needs:
        result["map"] = batch.copy().set("map_id", torch.full_like(batch["map_id"], -1))
    return result


def _of_people(model: Forecaster, batches: TensorDict, steps: int, slot: Tensor, mask: Tensor) -> Tensor:
    """Return the futures (B, A, T, 2) of people from scenes (P,) of their own, in which they have a slot."""
    future = torch.cat([model.mode(part, steps)[:, 0] for part in batches.split(_AT_ONCE)])
    result = future.new_zeros(*mask.shape, *future.shape[2:])
    result[mask] = future[torch.arange(len(slot), device=slot.device), slot]
    return result
