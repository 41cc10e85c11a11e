"""Every shipped config trains on the embedded recordings; a model of one's own is tried on one batch."""

import json
from pathlib import Path
from textwrap import dedent, indent
from typing import Any

import pytest
import torch
import yaml
from helpers.batches import make_batch
from helpers.training import SHORT
from torch import nn

from pedzoo.cli.main import main
from pedzoo.core.configs import load_config, merged
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.spec import grouped
from pedzoo.metrics.realism.two_sample import TREES
from pedzoo.models.base import Forecaster, for_all_samples, true_displacements
from pedzoo.models.zoo.loading import load
from pedzoo.sim.make import make_scenario
from pedzoo.train.module import check_model, is_own
from pedzoo.train.settings import architecture_options


@pytest.mark.parametrize("name", config_names())
def test_config_trains(name, tmp_path, request, monkeypatch):
    monkeypatch.setitem(TREES, "max_iter", 5)
    if "sgan_goal_map" in name:
        request.getfixturevalue("alexnet")
    options = [*SHORT, "--runs", str(tmp_path)]
    if name.startswith("robot/"):  # without recordings
        options += ["--model.envs=4", "--model.episodes=2", "--model.minibatches=2"]
    else:
        options += ["--data.fold=embedded", "--rollout.episodes=1"]
    if "/" in name and not name.startswith("open_loop"):
        options.append("--model.steps=2")
    if name == "closed_loop/mdn_walker":
        options.append("--model.courses=[{scenario: hallway, scenes: 4}]")
    if name.startswith("closed_loop"):
        options.append("--rollout.scenarios=[hallway]")  # its own are many, and slow to prepare
    assert main(["fit", "--config", name, *options]) == 0
    (run,) = (tmp_path / name.replace("/", ".")).iterdir()
    assert (run / "checkpoints" / "best.ckpt").is_file()
    logged = (run / "metrics.csv").read_text().splitlines()[0]
    if name.startswith("robot/"):
        assert "val/success" in logged
        return
    assert "val/ade" in logged
    # networks with a goal walk, those with anchors in the loop alone
    plain = name.rpartition("/")[2]
    walks = (
        name.startswith("closed_loop/") or plain.startswith(("sgan_goal", "approach_net")) or plain == "sgan"
    )
    assert ("rollout/success" in logged) == walks


def test_closed_loop_configs_differ_in_what_people_see_alone():
    """The numbers of two controllers are compared: they were trained alike."""
    one, other = (
        load_config(f"closed_loop/{name}") for name in ("approach_net_goal_map", "approach_net_goal")
    )
    plan = {"map": "rings", "map_dim": 24}
    other["model"]["init_args"]["generator"]["init_args"]["architecture"] |= plan
    assert one | {"weights": ""} == other | {"weights": ""}
    assert all(make_scenario(name) for name in one["rollout"]["scenarios"])


@pytest.mark.parametrize("name", ["approach_net_goal_map", "approach_net_goal", "anchor_net_goal_map"])
def test_a_closed_loop_config_says_what_its_weights_say(name):
    """With these weights on the command line, as releases are made, it is the same training."""
    config = load_config(f"closed_loop/{name}")
    options = architecture_options(config["weights"], f"closed_loop/{name}")
    assert options[0] == "--model.generator"
    generator = json.loads(options[1])
    written = config["model"]["init_args"]["generator"]
    assert written["class_path"] == generator["class_path"]
    kind = type(load(config["weights"]))
    assert merged(grouped(kind, kind().config), written["init_args"]) == generator["init_args"]
    data = {"keep_people": "complete", "min_people": 2} | config["data"]
    assert {f"--data.{key}={value}" for key, value in data.items()} >= set(options[2:])


def test_a_run_of_a_config_with_a_base_keeps_all_of_it(tmp_path):
    """What a run saves says by itself what was trained, and goes on when the base has changed."""
    mine = tmp_path / "mine.yaml"
    mine.write_text("base: sgan\nmodel: {init_args: {lr: 1e-2, samples: 2}}\ndata: {fold: embedded}\n")
    assert main(["fit", "--config", str(mine), "--runs", str(tmp_path / "runs"), *SHORT]) == 0
    run = tmp_path / "runs" / "mine" / "embedded-seed0"
    saved = yaml.safe_load((run / "config.yaml").read_text())
    assert "base" not in saved and saved["data"]["loading"]["batch_size"] == 64
    options = saved["model"]["init_args"]
    assert (options["lr"], options["samples"], options["clip"]) == (0.01, 2, 2.0)
    assert options["generator"]["init_args"]["architecture"]["encoder_dim"] == 32


@pytest.mark.parametrize("name", config_names())
def test_a_config_trains_in_a_precision_or_refuses_it(name, tmp_path, request, capsys):
    if "sgan_goal_map" in name:
        request.getfixturevalue("alexnet")
    options = [
        f"--runs={tmp_path / 'runs'}",
        "--trainer.fast_dev_run=1",
        "--trainer.enable_progress_bar=false",
    ]
    if not name.startswith("robot/"):
        options += ["--data.fold=embedded", "--data.loading.batch_size=8", "--rollout.scenarios=[]"]
    plain = name.partition("/")[0] not in ("closed_loop", "robot") and "mdn_walker" not in name
    trains = {
        "bf16-mixed": plain and "anchor" in name,
        "64-true": plain and "map" not in name and name != "social_vrnn",
    } | ({"16-true": False} if name == "anchors" else {})
    for precision in trains:
        assert main(["fit", "--config", name, *options, "--trainer.precision", precision]) == (
            0 if trains[precision] else 2
        )
        said = capsys.readouterr().err
        told = f"--trainer.precision {precision}: this trains in 32-true" in said and said.count("\n") == 1
        assert told != trains[precision] and not (tmp_path / "runs").exists()


# A model of one's own


class _Line(Forecaster):
    """The last step times a learned number: all that a model must keep."""

    def __init__(self) -> None:
        super().__init__()
        self.config: dict[str, Any] = {}
        self.factor = nn.Parameter(torch.ones(()))

    def sample(self, batch: Any, samples: int, steps: int, generator: Any = None) -> Any:
        last = batch["agents", "history"].diff(dim=2)[:, :, -1:].expand(-1, -1, steps, -1)
        last = torch.where(batch["agents", "mask"][..., None, None], last, 0.0)
        return for_all_samples(self.factor * last, batch, samples)

    def loss(self, batch: Any, generator: Any = None) -> Any:
        truth = true_displacements(batch)
        error = (self.sample(batch, 1, truth.shape[2])[:, 0] - truth).square().sum(-1)
        return torch.where(batch["agents", "mask"].unsqueeze(-1), error, 0.0).sum()


def changed(name: str, value: Any) -> _Line:
    """Return a model with another method."""
    return type("Mine", (_Line,), {name: value})()


def test_a_sound_model_stays_as_it_is():
    model, batch = _Line(), make_batch((2, 3), goal=False)
    torch.manual_seed(3)
    before = torch.get_rng_state()
    check_model(model, batch, by_loss=True)
    assert torch.equal(torch.get_rng_state(), before)
    assert model.factor.grad is None and is_own(model) and not is_own(Forecaster())


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "sample",
            lambda self, batch: None,
            r"expected Mine.sample\(batch, samples, steps, generator=None\)",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: batch["agents", "history"] @ torch.zeros(3, 2),
            r"failed at test_configs\.py:\d+: RuntimeError: .*; agents: .*history \(2, 4, 8, 2\)",
        ),
        ("sample", Forecaster.sample, r"no Mine.sample\(.*: it returns displacements"),
        (
            "sample",
            lambda self, batch, k, t, g=None: torch.zeros(2, 4, t, 2),
            r"Mine.sample returned \(2, 4, 8, 2\): expected .* here \(2, 2, 4, 8, 2\); .*for_all_samples",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: _Line.sample(self, batch, k, t) / 0,
            "Mine.sample returned numbers that are not finite",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: batch["agents", "goal"],
            "reads what the batch has not: .*goal.* needs = frozenset",
        ),
        ("loss", lambda self, batch: 0, r"expected Mine.loss\(batch, generator=None\): too many positional"),
        ("loss", lambda self, batch, g=None: self.factor.expand(3), r"loss returned \(3,\): .* add .sum\(\)"),
        ("loss", lambda self, batch, g=None: self.factor / 0, "Mine.loss is inf on the first batch"),
        ("loss", lambda self, batch, g=None: self.factor.detach(), "no gradient of Mine.loss reaches"),
        (
            "loss",
            lambda self, batch, g=None: (self.factor - 1).sqrt(),
            "with respect to factor is not finite",
        ),
        ("parameters", None, ""),
    ],
)
def test_what_a_model_must_keep(name, value, message):
    batch = make_batch((4, 4), goal=False)
    if name == "parameters":
        model, message = _Line(), "_Line has no parameters to train"
        model.factor.requires_grad_(False)
    else:
        model = changed(name, value)
    with pytest.raises(UserError, match=message) as error:
        check_model(model, batch, by_loss=True)
    assert "\n" not in str(error.value)


def test_parameters_that_learn_nothing_are_named(capsys):
    model = _Line()
    model.other = nn.Linear(2, 2)
    check_model(model, make_batch((2, 3), goal=False), by_loss=True)
    assert "note: other.weight, other.bias of _Line get no gradient" in capsys.readouterr().err


FILE = """
    import torch
    from torch import nn
    from pedzoo.models.base import Forecaster


    class Mine(Forecaster):
        needs = frozenset({"goal"})

        def __init__(self):
            super().__init__()
            self.config = {}
            self.factor = nn.Parameter(torch.ones(()))

        def sample(self, batch, samples, steps, generator=None):
            return self.factor * torch.zeros(3)
"""


def test_fit_refuses_it_before_the_first_epoch(elsewhere, refused):
    Path("mine.py").write_text(dedent(FILE))
    plain = "model:\n  class_path: pedzoo.train.module.PlainModule\n"
    plain += indent("init_args: {samples: 1, generator: {class_path: mine.py:Mine}}", "  ")
    Path("mine.yaml").write_text(f"{plain}\ndata: {{fold: embedded}}\ntrainer: {{max_epochs: 1}}\n")
    fit = ["fit", "--config", "mine.yaml", "--trainer.enable_progress_bar=false"]
    assert "Mine needs them by 'any': set --data.goal window_end" in refused(*fit, "--data.goal", "none")
    assert "Mine.sample returned (3,): expected displ" in refused(*fit, "--data.goal", "destination")
