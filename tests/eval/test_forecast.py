"""The open-loop table: which rows, in which order, under which protocol, and what must repeat."""

import json
import math
from typing import Any, cast

import pytest
import torch
from helpers.batches import random_weights

from pedzoo.cli.main import main
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.eval.forecast import BlockSums, blocks, forecast, forecast_row
from pedzoo.metrics.forecast import ForecastScore, displacement_error, negative_log_likelihood
from pedzoo.metrics.ratios import ratio_interval
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.zoo.loading import load, save_weights
from tools.paper.forecast_pages import NATS
from tools.paper.forecasts import line_likelihood, log_density, strayed

SAMPLED = {
    *("ade_sampled_m", "fde_sampled_m", "sample_distance_m", "calibration_error"),
    *("fde_of_min_ade_3_agent_m", "miss_rate_3"),
    *(f"min_{name}_3_{over}_m" for name in ("ade", "fde") for over in ("scene", "agent")),
}


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> dict[str, str]:
    """Two models with random weights: ``plain`` without a goal, ``goal`` for destinations."""
    folder = tmp_path_factory.mktemp("weights")
    options: dict[str, dict[str, Any]] = {
        "plain": {"residual": "constant_velocity"},
        "goal": {"goal_dim": 4, "goal_protocol": "destination", "residual": "bent_line", "map": "patch"},
    }
    result = {}
    for name, given in options.items():
        result[name] = str(folder / f"{name}.safetensors")
        save_weights(random_weights(SGAN.of(**given)), result[name])
    return result


def make_data(goal: str = "none", batch_size: int = 256, **options: Any) -> TrajectoryDataModule:
    return TrajectoryDataModule(goal=cast("Any", goal), loading=Loading(batch_size=batch_size), **options)


def test_models_stand_between_the_baselines_under_one_protocol(weights: dict[str, str]) -> None:
    seen = []
    data = make_data("destination")
    names = [weights["plain"], weights["goal"]]
    report = forecast(names, data, samples=3, seed=5, progress=lambda *step: seen.append(step))
    rows = report["rows"]
    order = ["constant_velocity", *names, "straight_line", "bent_line", "anchors"]
    assert [row["name"] for row in rows] == order
    assert report["protocol"] == data.protocol | {"split": "test", "samples": 3}
    assert report["protocol"]["goal"] == "destination" and report["protocol"]["fold"] == "embedded"
    assert report["seeds"] == [5]
    batches = len(data.test_dataloader())
    assert seen == [(row["name"], i + 1, batches) for row in rows for i in range(batches)]
    for row in rows:
        assert row["n"] == len(data.sets["test"].rows)
        nats = {"nll_nats_per_step"} if row["name"] == "anchors" else set()
        assert set(row["metrics"]) == {"ade_m", "fde_m", "next_step_m"} | SAMPLED | nats
        assert all(0 <= value < 100 for key, value in row["metrics"].items() if key not in nats), row
        assert row["case"] == {}
    json.dumps(report, allow_nan=False)


def test_without_goals_there_are_no_lines_to_them(weights: dict[str, str]) -> None:
    rows = forecast([weights["plain"]], make_data(), samples=0)["rows"]
    assert [row["name"] for row in rows] == ["constant_velocity", weights["plain"]]
    assert all(set(row["metrics"]) == {"ade_m", "fde_m", "next_step_m"} for row in rows)
    (row,) = forecast(["constant_velocity"], make_data(), 0)["rows"]
    assert row["name"] == "constant_velocity"


def test_constant_velocity_by_hand() -> None:
    """One sample of a deterministic model is its mode, its best one too, and no sample differs."""
    data = make_data()
    row = forecast([], data, samples=3)["rows"][0]
    distances = []
    for batch in data.test_dataloader():
        agents = agents_of(batch)
        history, there = agents["history"], agents["mask"]
        step = history[:, :, 7] - history[:, :, 6]
        for k in range(8):
            reached = history[:, :, 7] + (k + 1) * step
            distances.append(torch.hypot(*(reached - agents["future"][:, :, k])[there].unbind(-1)))
    errors = torch.stack([torch.cat(distances[k::8]) for k in range(8)])
    metrics = row["metrics"]
    assert metrics["ade_m"] == pytest.approx(errors.mean().item(), rel=1e-5)
    assert metrics["fde_m"] == pytest.approx(errors[-1].mean().item(), rel=1e-5)
    assert metrics["next_step_m"] == pytest.approx(errors[0].mean().item(), rel=1e-5)
    assert metrics["sample_distance_m"] == 0.0
    for name in ("ade_sampled_m", "min_ade_3_scene_m", "min_ade_3_agent_m"):
        assert metrics[name] == metrics["ade_m"]
    for name in ("fde_sampled_m", "min_fde_3_scene_m", "min_fde_3_agent_m"):
        assert metrics[name] == metrics["fde_m"]


def test_samples_count_and_repeat_with_their_seed(weights: dict[str, str]) -> None:
    name, data = weights["plain"], make_data(batch_size=64)
    first, again, other = (forecast([name], data, 3, seed)["rows"][1]["metrics"] for seed in (0, 0, 1))
    assert first == again
    for key in ("ade_m", "fde_m", "next_step_m"):  # of the mode, which has no noise
        assert first[key] == other[key]
    for key in SAMPLED - {"miss_rate_3"}:
        assert first[key] != other[key]
    assert first["sample_distance_m"] > 1e-3
    assert first["min_ade_3_agent_m"] < first["min_ade_3_scene_m"] < first["ade_sampled_m"]
    among = forecast(["bent_line", name], make_data("window_end", batch_size=64), 3)["rows"]
    assert among[2]["metrics"] == first


def test_mode_and_samples_are_those_of_the_model(weights: dict[str, str]) -> None:
    data = make_data(batch_size=4096)
    metrics = forecast([weights["plain"]], data, 3, seed=2)["rows"][1]["metrics"]
    (batch,) = list(data.test_dataloader())
    agents, model = agents_of(batch), load(weights["plain"])
    with torch.no_grad():
        paths = {
            "ade_m": model.mode(batch, 8),
            "ade_sampled_m": model.sample(batch, 3, 8, torch.Generator().manual_seed(2)),
        }
    for name, path in paths.items():
        error = displacement_error(path, agents["history"], agents["future"]).transpose(1, 2)[agents["mask"]]
        assert metrics[name] == pytest.approx(error.mean().item(), rel=1e-5)


def test_lines_know_whether_the_goal_is_timed() -> None:
    timed, free = (
        {row["name"]: row["metrics"] for row in forecast([], make_data(goal), 0)["rows"]}
        for goal in ("window_end", "destination")
    )
    for name in ("straight_line", "bent_line"):
        assert timed[name]["fde_m"] < 1e-5 < free[name]["fde_m"]
    assert timed["bent_line"]["ade_m"] < timed["straight_line"]["ade_m"]
    assert timed["constant_velocity"] == free["constant_velocity"]


def test_any_split_is_counted_whole() -> None:
    data = make_data()
    for split in ("train", "val", "test"):
        report = forecast([], data, 0, split=split)
        assert report["protocol"]["split"] == split
        assert report["rows"][0]["n"] == len(data.sets[split].rows)


def test_unknown_positions_do_not_count(weights: dict[str, str]) -> None:
    partly = forecast([weights["plain"]], make_data(keep_people="present", min_people=1), 3)["rows"]
    complete = forecast([weights["plain"]], make_data(), 3)["rows"]
    for some, all_ in zip(partly, complete, strict=True):
        assert some["n"] > all_["n"]
        assert all(0 <= value < 100 for key, value in some["metrics"].items() if "nats" not in key)


def test_what_cannot_be_forecast_is_refused(weights: dict[str, str]) -> None:
    for names, goal, samples, message in (
        ([weights["goal"]], "none", 20, r"goal\.safetensors needs a goal.*trained on destination"),
        (["bent_line"], "none", 20, "bent_line needs a goal"),
        ([], "random_future", 20, "random_future goals are for training"),
        (["bent_lime"], "none", 20, "unknown model 'bent_lime': did you mean 'bent_line'"),
        ([], "none", -1, "samples -1: expected at least 0"),
    ):
        with pytest.raises(UserError, match=message):
            forecast(names, make_data(goal), samples)


def test_the_command_writes_what_the_function_returns(weights: dict[str, str], tmp_path, capsys) -> None:
    out = tmp_path / "out.json"
    argv = ["forecast", weights["goal"], "--data.fold", "embedded", "--data.goal", "window_end"]
    argv += ["--data.loading.batch_size", "256", "--samples", "3", "--seed", "4"]
    assert main([*argv, "--json", str(out)]) == 0
    written = json.loads(out.read_text())
    direct = forecast([weights["goal"]], make_data("window_end"), 3, 4)
    assert written["command"] == "forecast" and "torch" in written["versions"]
    assert {key: written[key] for key in direct} == json.loads(json.dumps(direct))
    printed = capsys.readouterr().out
    assert "goal window_end" in printed and "constant_velocity" in printed and "bent_line" in printed
    assert written["rows"][1]["case"] == {"note": "trained for destination goals"}


def test_the_command_asks_a_model_for_its_own_goal(weights: dict[str, str], tmp_path) -> None:
    out = tmp_path / "out.json"
    argv = ["forecast", weights["plain"], weights["goal"], "--samples", "1", "--json", str(out)]
    assert main([*argv, "--data.fold", "embedded"]) == 0
    written = json.loads(out.read_text())
    assert written["protocol"]["goal"] == "destination"
    assert all(row["case"] == {} for row in written["rows"])


def test_one_command_trains_and_tests_on_files_of_ones_own(tmp_path) -> None:
    """The table has the baselines, the centroids of these files, and the two models that were trained."""
    lines = ["frame,agent,x,y"]
    random = torch.Generator().manual_seed(0)
    for agent in range(24):
        start, speed = 12 * agent // 2, 0.3 + 0.3 * float(torch.rand((), generator=random))
        for step in range(30):
            wobble = float(torch.randn((), generator=random)) * 0.02
            lines.append(f"{start + step},{agent},{speed * step:.3f},{agent % 5 + wobble:.3f}")
    (tmp_path / "mine.csv").write_text("\n".join(lines))
    out = tmp_path / "out.json"
    argv = ["forecast", "--train", "anchor_mlp,anchor_net", "--data.files", str(tmp_path / "mine.csv")]
    argv += ["--data.dt", "0.4", "--data.split", "0.6,0.2,0.2", "--data.pred_len=12", "--samples", "20"]
    assert main([*argv, "--runs", str(tmp_path / "runs"), "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    names = [row["name"] for row in report["rows"]]
    assert (names[0], names[3]) == ("constant_velocity", "anchors") and len(names) == 4
    assert "anchor_mlp" in names[1] and "anchor_net" in names[2]
    assert report["protocol"]["fold"] == "files" and report["protocol"]["pred_len"] == 12
    for row in report["rows"][1:]:
        assert row["metrics"]["min_ade_20_agent_m"] < 1.0
        assert {"miss_rate_20", "calibration_error", "nll_nats_per_step"} <= set(row["metrics"])


def test_blocks_are_as_long_as_a_window_and_within_a_recording() -> None:
    """Seven windows are two blocks of three with the last one added, three are one, none are none."""
    assert blocks([7, 3, 0, 2], 3).tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3, 3]


def test_interval_of_three_blocks_is_that_of_their_sums() -> None:
    """Windows come in any order, and in two updates; two blocks have none."""
    data = TrajectoryDataModule()
    data.setup("test")
    sums = BlockSums(data.sets["test"])
    sums.block = torch.tensor([0, 0, 1, 2])
    sums.add(torch.tensor([3, 0]), {"ade_m": (torch.tensor([6.0, 1.0]), torch.tensor([2, 1]))})
    sums.add(torch.tensor([1, 2]), {"ade_m": (torch.tensor([3.0, 6.0]), torch.tensor([3, 2]))})
    expected = ratio_interval(torch.tensor([4.0, 6.0, 6.0]), torch.tensor([4, 2, 2]))
    assert expected and sums.intervals()["ade_m"] == pytest.approx(expected)
    fewer = BlockSums(data.sets["test"])
    fewer.block = torch.tensor([0, 0, 0, 1, 1])
    fewer.add(torch.arange(5), {"ade_m": (torch.rand(5), torch.ones(5))})
    assert fewer.intervals() == {}


def test_every_error_of_a_forecast_lies_in_its_interval() -> None:
    row = forecast_row("bent_line", load("bent_line"), TrajectoryDataModule(goal="window_end"), samples=3)
    assert set(row["ci95"]) >= {"ade_m", "min_ade_3_scene_m", "min_ade_3_agent_m", "next_step_m"}
    for name, (low, high) in row["ci95"].items():
        assert low < row["metrics"][name] < high, name


def test_sums_of_scenes_add_up_to_the_mean() -> None:
    data = TrajectoryDataModule(loading=Loading(batch_size=16))
    data.setup("test")
    score, total, people = ForecastScore(0), 0.0, 0
    for batch in data.test_dataloader():
        score.update(load("constant_velocity"), batch)
        errors, counts = score.latest["ade_m"]
        assert errors.shape == counts.shape == batch.batch_size
        total, people = total + float(errors.sum()), people + int(counts.sum())
    assert people == len(data.sets["test"].rows)
    assert score.compute()["ade_m"] == pytest.approx(total / people)


def test_sums_of_likelihoods_by_hand() -> None:
    """Over two steps each: -1 and 2 nats in one scene, 3 in the other, whose second person is absent."""
    known = torch.tensor([[[True, True], [True, True]], [[True, True], [False, False]]])
    sums = negative_log_likelihood(torch.tensor([[1.0, -2.0], [-3.0, math.nan]]), known)
    assert [values.tolist() for values in sums] == [[1.0, 3.0], [4, 2]]


def test_density_around_constant_velocity_is_that_of_torch() -> None:
    data = TrajectoryDataModule(pred_len=4)
    data.setup()
    scale, total, people = strayed(data), torch.zeros(4), 0
    for batch in data.train_dataloader():
        agents = agents_of(batch)
        last = agents["history"][:, :, -1:] - agents["history"][:, :, -2:-1]
        there = known_displacements(batch).all(-1)
        total += (true_displacements(batch) - last)[there].square().sum((0, 2))
        people += int(there.sum())
        oracle = torch.distributions.Normal(last.expand(-1, -1, 4, -1), scale.unsqueeze(-1))
        nats = oracle.log_prob(true_displacements(batch)).sum((2, 3))
        torch.testing.assert_close(log_density(batch, scale)[there], nats[there])
    torch.testing.assert_close(scale, (total / people / 2).sqrt().clamp_min(0.02))
    value, ends = line_likelihood(data)
    assert ends[NATS][0] < value < ends[NATS][1]
