"""Weights in training walk: what is logged and when, by many processes too, and training does not notice."""

import copy
import json
import math
import pickle
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import lightning as L
import pytest
import torch
from helpers.training import LIGHTNING_MARKS, SHORT, environment, last, quiet_trainer
from lightning.pytorch.callbacks import Callback, LambdaCallback, ModelCheckpoint
from torch import Tensor, nn

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.eval.comparison import row
from pedzoo.eval.rollout import rollout
from pedzoo.metrics import closed_loop
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.train.module import PlainModule
from pedzoo.train.run import rows_of
from pedzoo.train.validation import METRICS, ClosedLoopValidation, share
from pedzoo.viz.video import read_video

FIT = ["fit", "--config", "sgan_goal", "--weights", "sgan_goal.zara1", "--data.fold", "embedded", *SHORT]
QUICK = ["--model.samples=2", "--model.generator.losses.best_k=2", "--rollout.episodes=2"]
SUCCESS = "rollout/door/success"
BEST = ["--monitor", SUCCESS, "--monitor_mode", "max"]

pytestmark = [pytest.mark.usefixtures("elsewhere"), *LIGHTNING_MARKS]


def measured(run: Path, name: str = SUCCESS) -> list[dict[str, str]]:
    """Return the rows of a run's CSV that have a value of ``name``."""
    return [row for row in rows_of(run / "metrics.csv") if name in row]


def history(run: Path) -> Iterator[dict[str, Any]]:
    """Yield what an offline run of Weights & Biases has logged, from its file: LevelDB's log of messages."""
    import wandb
    from wandb.proto import wandb_internal_pb2 as messages

    wandb.teardown()  # its process may still be writing
    (file,) = run.glob("wandb/offline-run-*/run-*.wandb")
    data, at, message = file.read_bytes(), 7, b""
    while at + 7 <= len(data):
        if (left := 32768 - at % 32768) < 7:
            at += left
            continue
        length, kind = struct.unpack("<HB", data[at + 4 : at + 7])
        message += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last part
            record = cast("Any", messages).Record.FromString(message)
            message = b""
            if record.WhichOneof("record_type") == "history":
                items = ((item.key or "/".join(item.nested_key), item) for item in record.history.item)
                yield {key: json.loads(item.value_json) for key, item in items}


def test_one_row_and_one_offline_run_have_both_kinds_of_metrics(elsewhere, tmp_path_factory, monkeypatch):
    """ADE, FDE and success of an epoch stand together; picture and video are really there."""
    import wandb

    wandb.teardown()
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.chdir(tmp_path_factory.mktemp("another"))
    wandb.setup()  # its process stays in that folder
    monkeypatch.chdir(elsewhere)
    assert main([*FIT, *QUICK, "--wandb", "offline", "--rollout.video", "true", *BEST]) == 0
    run = Path("runs/sgan_goal/embedded-seed0")
    (result,) = measured(run)
    assert 0 < float(result["val/ade"]) < 1 and float(result["val/fde"]) >= 0 and result["epoch"] == "0"
    assert {f"rollout/door/{name}" for name in METRICS} <= set(result)
    assert 0 <= float(result[SUCCESS]) <= 1
    assert (run / "checkpoints" / "best.ckpt").is_file()
    assert "- door" in (run / "config.yaml").read_text()

    logged = list(history(run))
    (together,) = (entry for entry in logged if SUCCESS in entry)
    for name in (SUCCESS, "val/ade", "val/fde"):
        assert together[name] == pytest.approx(float(result[name]))
    files = next(run.glob("wandb/offline-run-*/files"))
    seen = {key: value for entry in logged for key, value in entry.items() if key.startswith("rollout/door/")}
    assert (files / seen["rollout/door/ways/filenames"][0]).read_bytes().startswith(b"\x89PNG")
    frames, size = read_video(files / seen["rollout/door/video/videos"][0]["path"])
    assert frames > 20 and size[0] > 400


@pytest.mark.parametrize(
    ("physics", "scenarios"),
    [("compiled", ("door:width=0.9,people=3", "circle:people=2")), ("bullet", ("door",))],
)
def test_values_are_those_of_pedzoo_rollout(physics, scenarios):
    """The weights of the latest epoch walk, not those of an earlier one, and validate says the same again."""
    if physics == "bullet":
        pytest.importorskip("pybullet")
    options = [f"--rollout.physics={physics}", f"--rollout.scenarios={','.join(scenarios)}"]
    assert main([*FIT, *QUICK, "--trainer.max_epochs=2", "--model.lr=0.05", *options]) == 0
    run = Path("runs/sgan_goal/embedded-seed0")
    weights = str(last(run))
    assert main(["validate", "--ckpt_path", weights, "--json", "validate.json"]) == 0
    rows = json.loads(Path("validate.json").read_text())["rows"]
    assert "case" not in rows[0] and rows[0]["metrics"]["ade"] > 0
    for name, again in zip(scenarios, rows[1:], strict=True):
        first, second = measured(run, f"rollout/{name}/success")
        walked, env = rollout(weights, name, physics, 2)
        wanted = row(weights, walked)["metrics"]
        env.physics.close()
        for metric in METRICS:
            key = f"rollout/{name}/{metric}"
            assert float(second[key]) == pytest.approx(wanted.get(metric, math.nan), rel=1e-5, nan_ok=True)
        assert first[f"rollout/{name}/least_distance_m"] != second[f"rollout/{name}/least_distance_m"]
        assert again["case"]["scenario"] == name and again["case"]["physics"] == physics and again["n"] == 2
        assert again["metrics"] == pytest.approx({key: wanted[key] for key in METRICS if key in wanted})


class Noisy(SGAN):
    """Draws from torch's own generator, in validation and while walking."""

    def next_steps(self, batch: Any, noise: Any, steps: int, horizon: int) -> Tensor:
        result = super().next_steps(batch, noise, steps, horizon)
        return result + 1e-3 * torch.randn_like(result)


def make_module() -> PlainModule:
    torch.manual_seed(0)
    settings: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end", "residual": "bent_line"}
    model = Noisy.of(best_k=2, bottleneck_dim=4, map="patch", map_dropout=0.5, **settings)
    return PlainModule(model, samples=2)


def make_trainer(*callbacks: Callback, **options: Any) -> L.Trainer:
    limits = {"limit_train_batches": 2, "limit_val_batches": 1, "max_epochs": 2}
    return quiet_trainer(*callbacks, **limits | options)


def make_data() -> TrajectoryDataModule:
    return TrajectoryDataModule(goal="window_end", loading=Loading(batch_size=8, rotate=True))


def test_training_does_not_notice(tmp_path):
    """Weights, optimizer, random state and modes are bit-equal with and without rollouts."""
    ends: list[Any] = []
    noted: list[Any] = []

    def note(trainer: L.Trainer, module: L.LightningModule, *_: Any) -> None:
        noted[-1] += [torch.get_rng_state().tolist(), [part.training for part in module.modules()]]

    for callbacks in ([], [ClosedLoopValidation(["door", "circle:people=2"], episodes=1)]):
        module, watch = make_module(), LambdaCallback(on_train_batch_start=note, on_validation_end=note)
        noted.append([])
        trainer = make_trainer(*callbacks, watch)
        trainer.fit(module, make_data())
        assert (SUCCESS in trainer.callback_metrics) == bool(callbacks)
        optimizer = [v for s in trainer.optimizers[0].state.values() for v in s.values()]
        ends.append([*module.state_dict().values(), *optimizer, torch.get_rng_state()])
    assert noted[0] == noted[1] and len(noted[0]) >= 12
    assert len(ends[0]) > 20 and all(torch.equal(a, b) for a, b in zip(*ends, strict=True))


class Scripted(ClosedLoopValidation):
    """No person walks; the shares of success are given."""

    def __init__(self, script: list[float], **options: Any) -> None:
        super().__init__(["door"], **options)
        self.script = list(script)

    def check(self, model: Any, data: Any = None) -> None:
        """Every person may walk."""

    def _measure(self, *_: Any) -> dict[str, Tensor]:
        return {"success": torch.tensor(self.script.pop(0))}


@pytest.mark.parametrize(
    "check", [{"check_val_every_n_epoch": 1}, {"check_val_every_n_epoch": 2}, {"val_check_interval": 1}]
)
def test_the_best_checkpoint_is_of_an_epoch_that_was_measured(check, tmp_path):
    """Every second validation has a rollout; the last value stays visible and is not taken for a new one."""

    def fit(script: list[float], epochs: int, resume: Path | None = None) -> tuple[ModelCheckpoint, Scripted]:
        best = ModelCheckpoint(tmp_path, "best", monitor=SUCCESS, mode="max", enable_version_counter=False)
        last = ModelCheckpoint(tmp_path, "last", save_on_train_epoch_end=True, enable_version_counter=False)
        walks = Scripted(script, every=2)
        limits = {"max_epochs": epochs, "limit_train_batches": 1}
        make_trainer(walks, best, last, **limits, **check).fit(make_module(), make_data(), ckpt_path=resume)
        assert not walks.script
        return best, walks

    every = check.get("check_val_every_n_epoch", 1)
    fit([math.nan, 0.9, 0.5], 5 * every)
    assert torch.load(tmp_path / "best.ckpt", weights_only=True)["epoch"] == 3 * every - 1
    # a resumed run measures its first validation, the sixth in all, and then keeps the rhythm
    best, walks = fit([0.8, 0.95], 7 * every, resume=tmp_path / "last.ckpt")
    assert torch.load(tmp_path / "best.ckpt", weights_only=True)["epoch"] == 7 * every - 1
    assert best.best_model_score == pytest.approx(0.95) and walks.state_dict() == {"validations": 7}


def test_fast_dev_run_walks_one_episode(monkeypatch):
    walked: list[int] = []
    sums = closed_loop.closed_loop

    def counted(rollout: Any) -> Any:
        walked.append(len(rollout.failed))
        return sums(rollout)

    monkeypatch.setattr(closed_loop, "closed_loop", counted)
    assert main([*FIT, "--trainer.fast_dev_run", "true"]) == 0
    assert walked == [1] and not Path("runs").exists()


def test_environments_are_made_once_and_closed_whatever_happens():
    pytest.importorskip("pybullet")
    callback = ClosedLoopValidation(["door"], episodes=2, physics="bullet")
    backends: set[Any] = set()

    class End(Callback):
        def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
            backends.add(callback._envs["door"].physics)
            for copied in (copy.deepcopy(callback), pickle.loads(pickle.dumps(callback))):
                assert copied.names == callback.names and not copied._envs
            if trainer.current_epoch == 1:
                raise KeyError("something went wrong")

    with pytest.raises(KeyError, match="something went wrong"):
        make_trainer(callback, End(), num_sanity_val_steps=0).fit(make_module(), make_data())
    again = make_trainer(callback, End(), max_epochs=1, num_sanity_val_steps=0)  # it can be used again
    again.fit(make_module(), make_data())
    assert len(backends) == 2 and all(one._closed for one in backends) and not callback._envs


def test_a_model_that_gives_no_numbers_is_refused_at_the_start():
    module = make_module()
    cast("nn.Parameter", cast("SGAN", module.generator).decoder.output.bias).data.fill_(math.nan)
    with pytest.raises(UserError, match="Noisy gives no numbers in door"):
        make_trainer(ClosedLoopValidation(["door"])).fit(module, make_data())


def test_processes_share_all_episodes():
    for episodes in (1, 5, 16, 17):
        for processes in (1, 2, 3, 8):
            shares = [share(episodes, rank, processes) for rank in range(processes)]
            walked = [n for first, count in shares for n in range(first, first + count)]
            assert walked == list(range(episodes))
            assert max(count for _, count in shares) - min(count for _, count in shares) <= 1


def test_two_processes_train_and_walk_like_one(elsewhere):
    """Through the real command line: equal weights in both, one run folder, and one process's numbers."""
    words = [*FIT, *QUICK, "--rollout.episodes=3", "--trainer.accelerator", "cpu", "--trainer.devices", "2"]
    words += ["--trainer.strategy=ddp_find_unused_parameters_true"]
    words += ["--trainer.callbacks", "helpers.witness.Witness"]
    # all of it: whether 1 is one batch or the whole depends on the order of types that Python has kept of a
    # union of int and float, and so on what else was tested in this process
    words += ["--trainer.limit_val_batches=1.0"]
    command = [sys.executable, "-m", "pedzoo.cli.main", *words]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr and done.stdout.count("next: pedzoo forecast") == 1
    assert done.stdout.count("run folder:") == 1
    (run,) = Path("runs/sgan_goal").iterdir()
    weights = [torch.load(f"weights-{rank}.pt", weights_only=True) for rank in range(2)]
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0] if "score" not in key)
    assert {path.name for path in (run / "checkpoints").iterdir()} == {"best.ckpt", "last.ckpt"}

    alone = ["--trainer.devices", "1", "--trainer.strategy", "auto", "--trainer.callbacks", "null"]
    assert main(["validate", "--ckpt_path", str(last(run)), "--json", "one.json", *alone]) == 0
    forecast, walk = (row["metrics"] for row in json.loads(Path("one.json").read_text())["rows"])
    (both,) = measured(run)
    for prefix, metrics in (("val", forecast), ("rollout/door", walk)):
        assert len(metrics) > 5
        for key, value in metrics.items():
            assert float(both[f"{prefix}/{key}"]) == pytest.approx(value, rel=1e-5), key
