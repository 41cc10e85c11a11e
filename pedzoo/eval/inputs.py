"""Which inputs a forecaster uses: how far its forecast moves when one is taken away, and what that costs."""

from collections.abc import Callable, Mapping
from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datamodule import STAGES, TrajectoryDataModule
from pedzoo.data.recordings import Split
from pedzoo.eval.forecast import BlockSums
from pedzoo.metrics.forecast import Sums, average, displacement_error
from pedzoo.models.base import Forecaster

NEAR = 2.0
"""Metres: others are taken away from people who have somebody so near."""

_AT_ONCE = 256  # scenes in a batch of one for every person


def input_use(
    name: str,
    model: Forecaster,
    data: TrajectoryDataModule,
    seed: int = 0,
    split: Split = "test",
    progress: Callable[[str, int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """Return a row for each input of a model: its most likely forecast with the input and without it.

    * ``others``: each person is alone in the scene; of people with somebody within `NEAR`.
    * ``others of another scene``: a control. Other people stand where theirs were; this must not help.
    * ``goal``, ``desired velocity``: those of a person who walks straight on.
    * ``map``: free floor everywhere.
    * ``noise``: one random sample beside the most likely forecast.

    Metrics, metres: ``shift_m`` is the mean distance between the places of both forecasts, and
    ``largest_shift_m`` the largest one; ``ade_m`` and ``ade_without_m``; ``gain_m`` is what the second is
    above the first. Intervals are over time, see `BlockSums`.

    Args:
        name: Of the rows.
        model: The model.
        data: The data; their options are the protocol.
        seed: Of the noise.
        split: Which part of the fold.
        progress: Called with the name, batches done and batches in all.
    """
    data.setup(STAGES[split])
    loader = getattr(data, f"{split}_dataloader")()
    generator = torch.Generator().manual_seed(seed)
    blocks: dict[str, BlockSums] = {}
    totals: dict[str, dict[str, Tensor]] = {}
    largest: dict[str, float] = {}
    for i, (draw, batch) in enumerate(zip(loader.sampler, loader, strict=True)):
        for case, (shift, sums) in _compared(model, batch, generator).items():
            blocks.setdefault(case, BlockSums(data.sets[split])).add(draw.scenes, sums)
            largest[case] = max(largest.get(case, 0.0), float(shift.amax()) if shift.numel() else 0.0)
            total = totals.setdefault(case, {})
            for key, pair in sums.items():
                total[key] = total.get(key, 0) + torch.stack([value.double().sum() for value in pair])
        if progress:
            progress(name, i + 1, len(loader))
    rows = []
    for case, total in totals.items():
        means = {key: float(above / below.clamp(min=1)) for key, (above, below) in total.items()}
        metrics = means | {"largest_shift_m": largest[case]}
        count, ci95 = int(total["shift_m"][1]), blocks[case].intervals()
        rows.append({"name": name, "case": {"without": case}, "n": count, "metrics": metrics, "ci95": ci95})
    return rows


@torch.no_grad()
def _compared(
    model: Forecaster, batch: TensorDict, generator: torch.Generator
) -> dict[str, tuple[Tensor, Mapping[str, Sums]]]:
    """Return for each input the shifts of people (P, T), and sums and counts (B,) of the metrics."""
    agents, mask = agents_of(batch), cast("Tensor", batch["agents", "mask"])
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
    result = {
        "others": compared(alone(model, batch, steps), near),
        "others of another scene": compared(among_strangers(model, batch, steps), near),
    }
    for case, taken in without(batch, model.needs).items():
        result[case] = compared(model.mode(taken, steps)[:, 0], mask)
    if model.stochastic:
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
    return _of_people(model, batch[scene].exclude("agents").set("agents", people), steps, 0 * slot, mask)


def among_strangers(model: Forecaster, batch: TensorDict, steps: int) -> Tensor:
    """Return the most likely futures (B, A, T, 2) of people among the others of another scene.

    Each person stands where somebody of that scene did, and that one's others stand around.
    """
    mask = cast("Tensor", batch["agents", "mask"])
    scene, slot = mask.nonzero(as_tuple=True)
    other = (scene + max(len(batch) // 2, 1)) % len(batch)  # windows next to each other share their people
    place, rows = mask[other].long().argmax(1), torch.arange(len(scene), device=mask.device)
    batches, person = batch[other].clone(), agents_of(batch)[scene, slot]
    agents = agents_of(batches)
    moved = person["history"][:, -1] - agents["history"][rows, place, -1]
    for key in ("history", "future", "goal"):
        if (value := agents.get(key, None)) is not None:
            agents[key] = value + moved.view(-1, *(1,) * (value.dim() - 2), 2)
    agents[rows, place] = person
    for key in ("map_id", "scene_pose"):
        batches[key] = batch[key][scene]
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
