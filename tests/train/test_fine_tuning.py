"""Fine-tuning: trainings that begin with weights, what they take from them, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from helpers.runs import make_run
from helpers.training import SHORT, fitted
from safetensors.torch import save_file

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.spec import grouped
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.loading import save_weights
from pedzoo.train.run import rows_of
from pedzoo.train.settings import resumable_settings

NAME = "sgan_goal.zara1"
QUICK = [*SHORT, "--data.loading.batch_size=8", "--model.samples=2", "--rollout.scenarios=null"]
STILL = ["--model.lr", "0"]
"""Nothing is learnt: what a training ends with is what it began with."""


pytestmark = pytest.mark.usefixtures("elsewhere")


def fit(*options: str) -> Path:
    return fitted(*options, *QUICK)


def assert_same_weights(first: str, second: str) -> None:
    one, two = (pedzoo.load(name).state_dict() for name in (first, second))
    assert one.keys() == two.keys() and all(torch.equal(one[key], two[key]) for key in one)


def last(run: Path) -> str:
    return str(run / "checkpoints" / "last.ckpt")


@pytest.fixture
def stopped(refused):
    """Refuse what would begin a training; nothing is left behind by it."""

    def stopped(*words: str) -> str:
        before = set(Path().rglob("*"))
        said = refused("fit", *words, *QUICK)
        assert set(Path().rglob("*")) == before
        return said

    return stopped


def test_zoo_weights_bring_their_config_and_options_win():
    run = fit("--weights", NAME, "--data.fold", "embedded", *STILL)
    assert run == Path("runs/sgan_goal/embedded-seed0")
    assert_same_weights(last(run), NAME)
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert config["weights"] == NAME
    written = config["model"]["init_args"]["generator"]["init_args"]
    assert written == grouped(SGAN, pedzoo.load(NAME).config)
    assert config["model"]["init_args"]["final_lr"] == 0.01 and config["model"]["init_args"]["lr"] == 0
    assert config["data"]["goal"] == "window_end" and config["data"]["fold"] == "embedded"
    command = json.loads((run / "versions.json").read_text())["command"]
    assert command[:2] == ["pedzoo", "fit"] and command[command.index("--weights") + 1] == NAME


def test_fine_tuning_begins_where_the_weights_were():
    """Two iterations of a training from random weights are an order of magnitude worse."""
    ades = []
    for options in (
        ["--weights", NAME],
        ["--config", "sgan_goal"],
    ):
        run = fit(*options, "--data.fold", "embedded", "--model.lr", "1e-4")
        rows = rows_of(run / "metrics.csv")
        ades.append(next(float(row["val/ade"]) for row in rows if "val/ade" in row))
    assert ades[0] < 0.1 < 10 * ades[0] < ades[1]
    tuned, before = (
        pedzoo.load(name).state_dict() for name in (last(Path("runs/sgan_goal/embedded-seed0")), NAME)
    )
    # a person's pair with themselves wins in this pooling: others' places have gradients of rounding errors
    left = {key for key in before if torch.equal(tuned[key], before[key])}
    assert left <= {"pooling.embedding.weight"}


def test_a_checkpoint_brings_the_config_of_its_run():
    small = ["--model.generator.architecture.encoder_dim", "12", "--model.generator.losses.best_k", "3"]
    small += ["--seed_everything", "5"]
    first = fit("--config", "sgan_goal", "--data.fold", "embedded", *small)
    second = fit("--weights", last(first), *STILL)
    assert second == Path("runs/sgan_goal/embedded-seed5-2")
    assert_same_weights(last(first), last(second))
    steps = [torch.load(last(run), weights_only=True)["global_step"] for run in (first, second)]
    assert steps == [4, 4]  # of both optimizers, counted from the beginning


def test_a_fine_tuning_run_goes_on_without_its_first_weights():
    first = fit("--config", "sgan_nopool", "--data.fold", "embedded")
    second = fit("--weights", last(first))
    Path(last(first)).unlink()
    assert main(["fit", "--resume", str(second), "--trainer.max_epochs", "2"]) == 0
    assert torch.load(last(second), weights_only=True)["epoch"] == 1
    assert main(["validate", "--ckpt_path", last(second), "--rollout.scenarios", "null"]) == 0


def test_losses_and_the_goal_protocol_may_be_others():
    goal = ["--data.goal", "destination", "--model.generator.architecture.goal_protocol", "destination"]
    run = fit(
        "--weights", NAME, "--data.fold", "embedded", "--model.generator.losses.best_k", "2", *goal, *STILL
    )
    tuned = pedzoo.load(last(run))
    assert isinstance(tuned, SGAN) and tuned.goal_protocol == "destination" and tuned.losses.best_k == 2
    assert_same_weights(last(run), NAME)


def test_what_does_not_fit_is_refused_before_a_run_begins(stopped, elsewhere):
    fold = ["--data.fold", "embedded"]
    error = stopped("--weights", NAME, "--config", "sgan_goal_map", *fold)
    assert "another architecture (" in error and "map: None there, alexnet here" in error
    assert "leave out --config" in error
    error = stopped("--weights", NAME, "--model.generator.architecture.encoder_dim", "48", *fold)
    assert "encoder_dim: 32 there, 48 here" in error
    error = stopped("--weights", "sgan_goal.zara11", *fold)
    assert "did you mean 'sgan_goal.zara1'?" in error
    error = stopped("--weights", NAME, "--resume", "runs/x/y")
    assert "--weights begins a training and --resume goes on with one" in error
    for config in ([], ["--config", "closed_loop/approach_net_goal"]):
        error = stopped("--weights", "constant_velocity", *config, *fold)
        assert "--weights constant_velocity: expected a trained model" in error
    save_weights(SGAN(), elsewhere / "mine.safetensors", training={"config": "my_own"})
    error = stopped("--weights", "mine.safetensors", *fold)
    assert "they say my_own" in error and "add --config NAME" in error
    Path("own.py").write_text("raise SystemExit('this must not run')")
    config = {"architecture": "own.py:Mine", "init": {}, "training": {"config": "sgan"}}
    save_file({"x": torch.zeros(1)}, "trap.safetensors", {"config": json.dumps(config)})
    assert "no other file ever makes code run" in stopped("--weights", "trap.safetensors", *fold)
    assert "no weights at 'none.safetensors'" in stopped("--weights", "none.safetensors", *fold)


TRAP = "raise SystemExit('this must not run')"


def test_weights_name_no_dataset_in_a_file_of_code(stopped):
    Path("own.py").write_text(TRAP)
    protocol = {"fold": "own.py:Mine", "goal": "none"}
    save_weights(SGAN(), Path("trap.safetensors"), training={"config": "sgan"}, protocol=protocol)
    for more in ([], ["--config", "closed_loop/approach_net_goal"]):
        error = stopped("--weights", "trap.safetensors", *more)
        assert "'--data.fold=own.py:Mine' is in a file of code" in error and "--data.fold file.py" in error
    run = fit("--weights", "trap.safetensors", "--data.fold", "embedded")
    assert yaml.safe_load((run / "config.yaml").read_text())["data"]["fold"] == "embedded"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("data", "fold"), "own.py:Mine"),
        (("rollout", "scenarios"), ["door", "own.py:Mine:people=2"]),
        (("model", "init_args", "generator"), "trap.Mine"),
        (("data", "loading"), {"class_path": "trap.Mine"}),
        (("data",), "trap.yaml"),
    ],
)
def test_the_config_beside_a_checkpoint_makes_no_code_run(stopped, place, value, elsewhere, refused):
    best = make_run(elsewhere / "runs")
    config = elsewhere / "runs" / "sgan_goal" / "zara1-seed0" / "config.yaml"
    settings: Any = _whole_config()
    inner = settings
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    config.write_text(yaml.safe_dump(settings))
    for file in ("own.py", "trap.py"):
        Path(file).write_text(TRAP)
    Path("trap.yaml").write_text("class_path: trap.Mine")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(elsewhere)
        error = stopped("--weights", str(best))
        assert f"config '{config}': " in error and f"if it is yours, add --config {config}" in error
        assert f"config '{config}': " in refused("validate", "--ckpt_path", str(best))


def _whole_config() -> dict[str, Any]:
    """Return a configuration as fit leaves it."""
    return load_config("sgan_goal") | {"data": {"fold": "embedded", "goal": "window_end", "loading": {}}}


def test_the_config_beside_a_checkpoint_gives_no_orders(elsewhere, monkeypatch):
    first = fit("--config", "sgan_nopool", "--data.fold", "embedded")
    config = yaml.safe_load((first / "config.yaml").read_text())
    orders = {"callbacks": {"class_path": "trap.Mine"}, "logger": {"class_path": "trap.Mine"}}
    orders |= {"default_root_dir": "theirs", "profiler": "advanced", "plugins": "trap.Mine"}
    config |= {"wandb": "online", "runs": "theirs", "trainer": config["trainer"] | orders}
    (first / "config.yaml").write_text(yaml.safe_dump(config))
    Path("trap.py").write_text(TRAP)
    monkeypatch.syspath_prepend(elsewhere)
    second = fit("--weights", last(first), "--seed_everything", "3")
    written = yaml.safe_load((second / "config.yaml").read_text())
    assert second == Path("runs/sgan_nopool/embedded-seed3") and not Path("theirs").exists()
    assert written["wandb"] == "off" and written["runs"] == "runs"
    assert {key: written["trainer"][key] for key in orders} == dict.fromkeys(orders)
    assert main(["validate", "--ckpt_path", last(first), "--rollout.scenarios", "null"]) == 0


def _at(settings: Any, place: str, value: Any) -> dict[str, Any]:
    """Put a value at a place of settings, and return them."""
    inner, *above = settings, *place.split("/")[:-1]
    for key in above:
        inner = inner.setdefault(key, {})
    inner[place.rpartition("/")[2]] = value
    return settings


def _their_run(elsewhere: Path, settings: dict[str, Any]) -> Path:
    """Make a run of somebody's, and code that leaves a mark where it runs."""
    best = make_run(elsewhere / "theirs")
    best.rename(best.with_name("last.ckpt"))
    run = best.parents[1]
    (run / "config.yaml").write_text(yaml.safe_dump(settings))
    mark = f"open({str(elsewhere / 'it ran')!r}, 'w').close()\n"
    for name in ("own", "trap"):
        Path(f"{name}.py").write_text(f"{mark}class Mine:\n    pass\n")
    Path("trap.yaml").write_text("class_path: trap.Mine\ntrainer: {callbacks: [{class_path: trap.Mine}]}\n")
    return run


GENERATOR = "model/init_args/generator"
HOSTILE: list[tuple[str, Any]] = [
    ("data/fold", "own.py:Mine:all"),
    (GENERATOR, {"class_path": "own.py:Mine"}),
    ("trainer/callbacks", [{"class_path": "trap.Mine"}]),
    ("rollout/scenarios", ["door", "own.py:Mine:people=2"]),
    ("rollout/scenarios", [{"scenario": "own.py:Mine", "people": 2}]),
    ("config", "trap.yaml"),
]
ROBOTS: list[tuple[str, Any]] = [
    ("model/init_args/people", "orca:share=0.5+own.py:Mine"),
    ("model/init_args/scenarios", ["own.py:Mine"]),
]


@pytest.mark.parametrize(
    ("base", "place", "value"),
    [*(("sgan_goal", *one) for one in HOSTILE), *(("robot/ppo", *one) for one in ROBOTS)],
)
def test_the_config_of_a_resumed_run_makes_no_code_run(base, place, value, elsewhere, capsys):
    run = _their_run(
        elsewhere, _at(_whole_config() if base == "sgan_goal" else load_config(base), place, value)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(elsewhere)
        code = main(["fit", "--resume", str(run), "--trainer.enable_progress_bar", "false"])
    said = capsys.readouterr().err
    assert code == 2 and not Path("it ran").exists() and said.count("\n") == 1
    if place != "config":
        assert f"config '{run / 'config.yaml'}': " in said
        assert f"if it is yours, add --config {run / 'config.yaml'}" in said


@pytest.mark.parametrize(
    ("place", "value"),
    [
        *HOSTILE[:5],
        ("rollout/physics", "own.py:Mine"),
        ("rollout/scenarios", "door,own.py:Mine"),
        ("weights", "own.py:Mine:weights=a.ckpt"),
        ("model", "trap.Mine"),
        ("model/class_path", "trap.Mine"),
        ("model/class_path", "Mine"),
        ("model/class_path", "pedzoo.core.machine.subprocess.Popen"),
        ("model/class_path", ["trap.Mine"]),
        ("model/init_args.generator", {"class_path": "trap.Mine"}),
        ("model/init_args/generator+", {"class_path": "trap.Mine"}),
        ("model/dict_kwargs", {"a": {"class_path": "trap.Mine"}}),
        (f"{GENERATOR}/init_args/losses", "trap.yaml"),
        (f"{GENERATOR}/init_args/unknown", {"class_path": "trap.Mine"}),
        (f"{GENERATOR}/init_args/unknown", [[{"a": {"class_path": "trap.Mine"}}]]),
        ("data", "trap.yaml"),
        ("data/loading", {"class_path": "trap.Mine"}),
        ("data.fold", "own.py:Mine:all"),
        ("trainer", "trap.yaml"),
        ("trainer.callbacks", "trap.Mine"),
        ("trainer/callbacks+", "trap.Mine"),
        ("trainer/callbacks", "trap.Mine"),
        ("trainer/callbacks", "trap.yaml"),
        ("trainer/callbacks", {"class_path": "lightning.pytorch.callbacks.model_checkpoint.os.system"}),
        ("trainer/callbacks", {"class_path": "lightning.pytorch.callbacks.timer.timedelta"}),
        (
            "trainer/callbacks",
            {"class_path": "lightning.pytorch.callbacks.LambdaCallback", "init_args": {"setup": "os.abort"}},
        ),
        (
            "trainer/callbacks",
            {"class_path": "lightning.pytorch.callbacks.ModelCheckpoint", "init_args": {"dirpath": "home"}},
        ),
        ("trainer/logger", "CSVLogger"),
        ("trainer/logger", {"class_path": "lightning.pytorch.loggers.MLFlowLogger"}),
        ("trainer/plugins", ["trap.Mine"]),
        ("trainer/plugins", {"class_path": "lightning.pytorch.plugins.TorchCheckpointIO"}),
        ("trainer/profiler", {"class_path": "trap.Mine"}),
        ("trainer/strategy", "trap.Mine"),
        ("trainer/strategy", {"class_path": "lightning.pytorch.strategies.DDPStrategy"}
         | {"init_args": {"ddp_comm_hook": "trap.hook"}}),
        ("trainer/accelerator", "trap.Mine"),
        ("rollout", "trap.Mine"),
        ("rollout", {"class_path": "trap.Mine"}),
        ("base", "theirs.yaml"),
    ],
)  # fmt: skip
def test_settings_of_a_resumed_run_are_searched_for_code(place, value, elsewhere):
    settings = _at(_whole_config(), place, value)
    Path("theirs.yaml").write_text(yaml.safe_dump({"trainer": {"callbacks": [{"class_path": "trap.Mine"}]}}))
    Path("config.yaml").write_text(yaml.safe_dump(settings))
    with pytest.raises(UserError, match=r"^config 'config.yaml': "):
        resumable_settings(load_config("config.yaml"), Path("config.yaml"))


def test_what_is_no_code_goes_on(elsewhere):
    lightning = "lightning.pytorch.callbacks"
    stopping = {"class_path": f"{lightning}.EarlyStopping", "init_args": {"monitor": "rollout/door/success"}}
    settings = _at(_whole_config(), "trainer/callbacks", [stopping, {"class_path": f"{lightning}.Timer"}])
    settings["trainer"] |= {"strategy": "ddp", "devices": "auto", "precision": "bf16-mixed", "logger": True}
    file = Path("config.yaml")
    assert resumable_settings(settings, file) == settings
    assert "config" not in resumable_settings(settings | {"config": "trap.yaml"}, file)
