"""Which inputs a model uses: by hand, on models that use one input, and on all shipped weights."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of, scene_batch
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import input_rows
from pedzoo.maps.bank import MapBank
from pedzoo.metrics.inputs import alone, among_strangers
from pedzoo.models.base import Forecaster, for_all_samples
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.store import find, names

FLOORS = {"others": 0.005, "goal": 0.05, "noise": 0.005}
"""Metres: what the absence of an input moves in the mean, at least, where a card claims the input."""


class Crowded(Forecaster):
    """Walks to the mean of the others and, if it has one, of the goal; needs no training."""

    stochastic = False

    def __init__(self, goal: bool = False) -> None:
        super().__init__()
        self.needs = frozenset(["goal"] * goal)

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        agents = agents_of(batch)
        place, mask = agents["history"][:, :, -1], agents["mask"].unsqueeze(-1)
        others = ((place * mask).sum(1, keepdim=True) - place) / (mask.sum(1, keepdim=True) - 1).clamp(min=1)
        aim = agents["goal"] - place if self.needs else torch.zeros_like(place)
        step = torch.where(mask.sum(1, keepdim=True) > 1, others - place, 0) + aim
        return for_all_samples(step.unsqueeze(2).expand(-1, -1, steps, 2), batch, 1)


class Blind(Crowded):
    """Walks straight on."""

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        moved = agents_of(batch)["velocity"] * 0.4
        return for_all_samples(moved.unsqueeze(2).expand(-1, -1, steps, 2), batch, 1)


def scenes() -> TensorDict:
    """Return two scenes: people at 0 and 1 m, and at 10, 13 and 16 m, who stand."""
    place = torch.tensor([[[0.0, 0], [1, 0], [0, 0]], [[10.0, 0], [13, 0], [16, 0]]])
    history = place.unsqueeze(2).expand(2, 3, 8, 2)
    mask = torch.tensor([[True, True, False], [True] * 3])
    valid = mask.unsqueeze(2).expand(2, 3, 8)
    return scene_batch(
        maps=MapBank(), map_id=torch.full((2, 1), -1), pose=torch.tensor([[0.0, 1, 0, 0]] * 2),
        history=history, valid=valid, mask=mask, pref_speed=torch.ones(2, 3, 1),
        future=history, future_valid=valid,
    )  # fmt: skip


def test_people_alone_see_no_others() -> None:
    assert not alone(Crowded(), scenes(), 2).any()


def test_strangers_stand_where_the_others_of_somebody_there_stood() -> None:
    taken = among_strangers(Crowded(), scenes(), 1)[:, :, 0, 0]
    # in the second scene the first person's others are 3 and 6 m ahead, in the first 1 m ahead
    assert taken.tolist() == [[4.5, 4.5, 0], [1, 1, 1]]


@pytest.mark.parametrize("model, moves", [(Crowded(), True), (Blind(), False)])
def test_only_a_model_that_sees_others_is_moved_by_their_absence(model: Forecaster, moves: bool) -> None:
    rows = use(model, "none")
    assert list(rows) == ["others", "others of another scene"]
    for row in rows.values():
        assert (row["metrics"]["shift_m"] > 0) == (row["metrics"]["largest_shift_m"] > 0) == moves
        gain = row["metrics"]["ade_without_m"] - row["metrics"]["ade_m"]
        assert row["metrics"]["gain_m"] == pytest.approx(gain, abs=1e-6)
        assert row["n"] > 0


def test_goals_are_an_input_of_models_that_need_them() -> None:
    rows = use(Crowded(goal=True), "window_end")
    assert list(rows)[2:] == ["goal", "desired velocity"]
    assert rows["goal"]["metrics"]["shift_m"] > 0.1 and not rows["desired velocity"]["metrics"]["shift_m"]


def use(model: Forecaster, goal: Any) -> dict[str, dict[str, Any]]:
    """Return the rows of a model on the embedded recordings, by what is taken away."""
    rows = input_rows("mine", model, TrajectoryDataModule(fold="embedded", goal=goal))
    return {row["case"]["without"]: row for row in rows}


PAPER = [name for name in names() if name.partition(".")[0] in ("sgan", "sgan_goal", "sgan_goal_map")]


@pytest.mark.parametrize("name", PAPER)
def test_cards_of_the_papers_models_tell_of_inputs_that_are_used(name: str) -> None:
    entry = find(name)
    assert entry is not None
    reports = [report for report in entry.card.evaluations if report["command"] == "inputs"]
    assert reports, f"{name}: python tools/zoo/train_zoo.py measure --only {name}"
    for row in reports[0]["rows"]:
        floor = FLOORS.get(row["case"]["without"], 0.0)
        assert row["metrics"]["shift_m"] >= floor, row


@pytest.mark.parametrize("name", ["sgan.zara1", "sgan_goal.zara1"])
def test_shipped_weights_see_others_on_the_embedded_recordings(name: str) -> None:
    model = load(name)
    row = use(model, model.goal_protocol)["others"]
    assert row["metrics"]["shift_m"] > FLOORS["others"]
