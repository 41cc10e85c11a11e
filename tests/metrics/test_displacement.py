"""Displacement metrics by hand, published numbers of baselines, and which inputs a model uses."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of, scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import input_rows
from pedzoo.maps.bank import MapBank
from pedzoo.metrics import forecast as d
from pedzoo.metrics.forecast import ForecastScore, calibration_error, places
from pedzoo.metrics.inputs import alone, among_strangers
from pedzoo.models.architectures.bent_line import BentLine
from pedzoo.models.architectures.constant_velocity import ConstantVelocity
from pedzoo.models.architectures.straight_line import StraightLine
from pedzoo.models.base import Forecaster, for_all_samples
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.store import find, names

Kind = tuple[Callable[..., tuple[Tensor, Tensor]], Callable[..., Tensor]]

# one scene, two samples, two people, two steps; per person ADE of sample 0: 2 and 5, of sample 1: 3 and 1
ERROR = torch.tensor([[[[1.0, 3.0], [4.0, 6.0]], [[2.0, 4.0], [0.5, 1.5]]]])
KNOWN = torch.ones(1, 2, 2, dtype=torch.bool)

# ADE per scene: sample 0 costs 7, sample 1 costs 4: (3 + 1) / 2; per agent: (2 + 1) / 2
# FDE per scene: 3 + 6 against 4 + 1.5; per agent: 3 and 1.5
# the final error of the best by ADE: 3 of sample 0, and 1.5 of sample 1; of 2 m the first one is a miss
BY_HAND: list[tuple[Kind, float, float]] = [
    ((d.average, d.mean_over_samples), (2 + 5 + 3 + 1) / 4, (2 + 4 + 3 + 0.5) / 4),
    ((d.final, d.mean_over_samples), (3 + 6 + 4 + 1.5) / 4, (3 + 4) / 2),
    ((d.next_step, d.mean_over_samples), (1 + 4 + 2 + 0.5) / 4, (1 + 4 + 2 + 0.5) / 4),
    ((d.average, d.min_per_scene), 2.0, (3 + 0.5) / 2),  # 6 against 3.5
    ((d.final, d.min_per_scene), 2.75, 3),  # person 0 alone: sample 0
    ((d.average, d.min_per_agent), 1.5, (2 + 0.5) / 2),
    ((d.final, d.min_per_agent), 2.25, 3),
    ((d.final_of_best, d.mean_over_samples), (3 + 1.5) / 2, 3.0),
    ((d.missed, d.mean_over_samples), 0.5, 1.0),
]
"""An error and how samples are reduced, its value, and that where person 1's second step is not known."""


def value(kind: Kind, error: Tensor, valid: Tensor) -> float:
    above, below = d.scene_sums(error, valid, *kind)
    assert above.dtype == torch.float64 and above.shape == below.shape == error.shape[:1]
    return float(above.sum() / below.sum())


@pytest.mark.parametrize(("kind", "expected", "partly"), BY_HAND)
def test_values_by_hand(kind: Kind, expected: float, partly: float) -> None:
    """Also of futures that are known in part, beside padding, which counts for nothing; of nothing none."""
    assert value(kind, ERROR, KNOWN) == pytest.approx(expected)
    valid = torch.tensor([[[True, True], [True, False]]])
    assert value(kind, ERROR, valid) == pytest.approx(partly)
    error = torch.cat((ERROR, torch.full((1, 2, 1, 2), math.nan)), dim=2)
    padded = torch.cat((KNOWN, torch.zeros(1, 1, 2, dtype=torch.bool)), dim=1)
    assert value(kind, error, padded) == pytest.approx(expected)
    assert math.isnan(value(kind, ERROR, ~KNOWN))


def test_the_samples_that_are_best_by_ade_and_by_fde_may_differ() -> None:
    error = torch.tensor([[[[0.0, 5.0]], [[4.0, 4.0]]]])  # one person: sample 0 has ADE 2.5, sample 1 FDE 4
    known = torch.ones(1, 1, 2, dtype=torch.bool)
    for over in (d.min_per_scene, d.min_per_agent):
        assert value((d.average, over), error, known) == 2.5
        assert value((d.final, over), error, known) == 4.0


def test_errors_are_distances_of_summed_displacements() -> None:
    history = torch.tensor([[[[9.0, 9.0], [1.0, 1.0]]]])
    future = torch.tensor([[[[2.0, 1.0], [3.0, 1.0]]]])
    prediction = torch.tensor([[[[[1.0, 0.0], [1.0, 0.0]]], [[[1.0, 3.0], [1.0, 1.0]]]]])
    error = d.displacement_error(prediction, history, future)
    assert torch.allclose(error, torch.tensor([[[[0.0, 0.0]], [[3.0, 4.0]]]]))


def test_sample_distance_by_hand() -> None:
    """Three samples of one person walk 0, 1 and 3 m per step: pairs are 1, 3, 2 apart, then 2, 6, 4."""
    prediction = torch.zeros(1, 3, 2, 2, 2)
    prediction[0, 1, 0, :, 0], prediction[0, 2, 0, :, 0] = 1.0, 3.0
    prediction[0, :, 1] = torch.randn(3, 2, 2)  # padding
    mask = torch.tensor([[True, False]])
    for given, expected in ((prediction, 2 + 4), (torch.ones(1, 3, 2, 2, 2), 0), (prediction[:, :1], 0)):
        total, count = d.sample_distance(given, mask)
        assert (float(total), float(count)) == (pytest.approx(expected), 2)


class TwoWays(Forecaster):
    """Walks (0, 0) as its mode, and (0, 0) or (0, 1) per step as its samples."""

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Any = None) -> Tensor:
        """Return every other sample on the second way."""
        scenes, people = cast("Tensor", batch["agents", "mask"]).shape
        walk = torch.zeros(scenes, samples, people, steps, 2)
        walk[:, 1::2, :, :, 1] = 1.0
        return walk


def scene(future: list[tuple[float, float]]) -> TensorDict:
    people = {
        "history": torch.zeros(1, 1, 2, 2),
        "future": torch.tensor([[future]]),
        "future_valid": torch.ones(1, 1, len(future), dtype=torch.bool),
        "mask": torch.ones(1, 1, dtype=torch.bool),
    }
    return TensorDict({"agents": TensorDict(people, batch_size=(1, 1))}, batch_size=(1,))


def test_scores_add_up_over_batches_and_processes_in_float64() -> None:
    """In float32 a hundred times 1 beside 2^25 is nothing."""
    score, other = ForecastScore(0), ForecastScore(0)
    score.update(TwoWays(), scene([(float(2**25), 0.0)]))
    for _ in range(50):
        for one in (score, other):
            one.update(TwoWays(), scene([(0.0, 1.0)]))
    score.merge_state(other)  # what processes do at the end
    assert score.compute()["ade_m"] * 101 == pytest.approx(2**25 + 100, abs=0.01)


def test_score_keeps_mode_samples_and_best_apart() -> None:
    score = ForecastScore(2)
    score.update(TwoWays(), scene([(0.0, 1.0), (0.0, 2.0)]))
    best = [f"min_{error}_2_{who}_m" for who in ("scene", "agent") for error in ("ade", "fde")]
    expected = dict.fromkeys([*best, "fde_of_min_ade_2_agent_m", "miss_rate_2"], 0.0)
    expected |= {"ade_m": 1.5, "fde_m": 2.0, "next_step_m": 1.0, "sample_distance_m": 1.5}
    expected |= {"ade_sampled_m": 0.75, "fde_sampled_m": 1.0}
    result = score.compute()
    assert 0 <= result.pop("calibration_error") <= 0.5
    assert result == pytest.approx(expected)
    score.reset()
    score.update(ConstantVelocity(), scene([(0.0, 1.0), (0.0, 2.0)]))
    result = score.compute()
    assert (result["ade_m"], result["min_ade_2_scene_m"], result["sample_distance_m"]) == (1.5, 1.5, 0.0)
    alone = ForecastScore(0)
    alone.update(TwoWays(), scene([(0.0, 1.0)]))
    assert alone.compute() == {"ade_m": 1.0, "fde_m": 1.0, "next_step_m": 1.0}


# -- trivial baselines on ETH/UCY: ADE and FDE as two independent scripts computed them

BASELINES = {
    "window_end": [ConstantVelocity(), StraightLine("window_end"), BentLine("window_end")],
    "destination": [StraightLine("destination")],
}
PUBLISHED = {
    ("eth", 8): (0.668, 1.356, 0.233, 0.0, 0.207, 0.0, 0.479, 0.594),
    ("hotel", 8): (0.258, 0.477, 0.066, 0.0, 0.085, 0.0, 0.160, 0.226),
    ("univ", 8): (0.311, 0.667, 0.103, 0.0, 0.078, 0.0, 0.411, 0.710),
    ("zara1", 8): (0.253, 0.541, 0.084, 0.0, 0.065, 0.0, 0.291, 0.481),
    ("zara2", 8): (0.207, 0.448, 0.070, 0.0, 0.051, 0.0, 0.230, 0.395),
    ("zara1", 12): (0.431, 0.960, 0.152, 0.0, 0.120, 0.0, 0.428, 0.714),
}


@pytest.mark.parametrize(("fold", "pred_len"), list(PUBLISHED))
def test_baselines_equal_the_published_tables(shared: Path, fold: str, pred_len: int) -> None:
    result = []
    for goal, models in BASELINES.items():
        data = TrajectoryDataModule(fold, str(shared / "data"), pred_len=pred_len, goal=cast("Any", goal))
        batches = list(data.test_dataloader())
        for model in models:
            score = ForecastScore(1)
            for batch in batches:
                score.update(model, batch)
            metrics = score.compute()
            result += [metrics["ade_m"], metrics["fde_m"]]
            assert metrics["min_ade_1_scene_m"] == pytest.approx(metrics["ade_m"])
    assert result == pytest.approx(PUBLISHED[fold, pred_len], abs=0.00051)


def test_calibration_by_hand() -> None:
    """Samples behind the truth, before it, and on both sides of it; a person walks along x."""
    history = torch.stack((torch.arange(8.0), torch.zeros(8)), -1).view(1, 1, 8, 2)
    known = torch.ones(1, 1, 1, dtype=torch.bool)

    def error(*truths: tuple[float, float], turn: float = 0.0) -> float:
        frame = torch.tensor([math.cos(turn), math.sin(turn)])
        counts = torch.zeros(2, 21)
        ends = torch.stack((torch.arange(20.0), torch.arange(20.0)), -1).view(1, 20, 1, 2)
        for truth in truths:
            place = torch.tensor(truth).view(1, 1, 1, 2)
            turned = [rotate(one, frame) for one in (ends, history, place)]
            counts = counts + places(turned[0], turned[1], turned[2], known)
        return float(calibration_error(counts))

    # all samples behind: the distribution function is 0 up to the last class, 1 / 20, 2 / 20, ... too low
    behind = sum(k / 20 for k in range(1, 20)) / 19
    assert error((30.0, 30.0)) == pytest.approx(behind)
    assert error((-5.0, -5.0)) == pytest.approx(behind)
    assert error((30.0, 30.0), turn=1.0) == pytest.approx(behind)
    # people walk to where they are last seen, whatever they did before
    hook = torch.stack((torch.zeros(8), torch.arange(8.0)), -1)
    hook[1], hook[6] = torch.tensor([9.0, 0.0]), torch.tensor([-9.0, 0.0])
    here = torch.tensor([1.0, 2.0]).view(1, 1, 1, 2)
    turned = places(here - torch.tensor([5.0, 1.0]), hook.view(1, 1, 8, 2), here, known)
    assert turned[:, :-1].nonzero().tolist() == [[0, 19], [1, 0]]
    same = places(here, history, here, known)  # half are ahead, and half are to the side
    assert same[:, :-1].nonzero().tolist() == [[0, 9], [0, 10], [1, 9], [1, 10]]
    # one truth between each pair of neighbours is as calibrated as can be
    assert error(*((k + 0.5, k + 0.5) for k in range(-1, 20))) < 0.03
    # a single guess: half are ahead, half behind
    single = sum(abs(0.5 - k / 20) for k in range(1, 20)) / 19
    assert error((30.0, 30.0), (-5.0, -5.0)) == pytest.approx(single)


@pytest.mark.parametrize(
    ("shape", "given"),
    [((3, 2, 4, 1, 2), r"\(3, 2, 4, 1, 2\)"), ((3, 4, 8, 2), r"\(3, 4, 8, 2\)"), (None, "NoneType")],
)
def test_predictions_of_another_shape_are_refused(shape: tuple[int, ...] | None, given: str) -> None:
    """One step for all eight, or no axis of samples, would be stretched to wrong errors."""
    history, future = torch.zeros(3, 4, 8, 2), torch.zeros(3, 4, 8, 2)
    prediction = cast("Tensor", None if shape is None else torch.zeros(shape))
    with pytest.raises(UserError, match=rf"a model returned {given}: expected .* here \(3, 'K', 4, 8, 2\)"):
        d.displacement_error(prediction, history, future)


# Inputs


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


def test_strangers_stand_where_others_of_somebody_stood() -> None:
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
