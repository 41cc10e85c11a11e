"""Run folders: whole files whatever happens, and one process at a time."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.training import FIT, LAST, RUN, assert_same_end, environment, last

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.train.run import MetricsFile, RunFolder, WholeCheckpoints, rows_of

pytestmark = [
    pytest.mark.usefixtures("elsewhere"),
    pytest.mark.filterwarnings("ignore:.*SLURM auto-requeueing"),
]


def resume(epochs: int) -> int:
    return main(["fit", "--resume", str(RUN), "--trainer.max_epochs", str(epochs)])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_a_write_that_fails_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "checkpoints" / "last.ckpt"
    saver = WholeCheckpoints()
    saver.save_checkpoint({"epoch": 1}, path)
    before = contents(tmp_path)

    def full(self: Path, data: memoryview) -> int:
        with self.open("wb") as file:
            file.write(data[:10])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", full)
        with pytest.raises(UserError, match=r"cannot write '.*/last\.ckpt': No space left on device"):
            saver.save_checkpoint({"epoch": 2}, path)
    assert contents(tmp_path) == before
    saver.save_checkpoint({"epoch": 3}, path)
    assert torch.load(path) == {"epoch": 3}


@pytest.mark.parametrize("moment", ["fsync", "replace"])
def test_a_process_killed_while_it_writes_leaves_the_old_file(moment, tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("old")
    code = f"""
import os, signal
from pathlib import Path
from pedzoo.core.paths import write_atomically
os.{moment} = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
write_atomically(Path({str(path)!r}), b"new")
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert path.read_text() == "old"


@pytest.mark.parametrize("file", ["last.ckpt", "config.yaml"])
def test_a_run_goes_on_after_it_was_cut_off_in_a_write(file, monkeypatch):
    assert main(FIT) == 0
    replace, before = os.replace, (RUN / "config.yaml").read_bytes()

    class CutError(BaseException):
        pass

    def cut(source: Any, target: Any) -> None:
        if Path(target).name == file:
            raise CutError
        replace(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", cut)
        with pytest.raises(CutError):
            resume(3)
    assert torch.load(LAST)["epoch"] == 0
    if file == "config.yaml":
        assert (RUN / file).read_bytes() == before
    (LAST.parent / ".last.99.part.ckpt").write_bytes(b"of a process that was killed")
    assert resume(2) == 0 and torch.load(LAST)["epoch"] == 1
    assert [path.name for path in LAST.parent.iterdir() if path.name.startswith(".")] == []


def test_a_run_goes_on_with_the_data_that_it_began_with(refused, capsys):
    assert main(FIT) == 0
    before = contents(RUN)
    capsys.readouterr()
    for option, value, old in (
        ("data.fold", "zara1", "embedded"),
        ("data.clock", "true", "benchmark"),
        ("data.hold_out", "zara2", "null"),
        ("data.files", "a.csv,b.csv", "null"),
        ("seed_everything", "3", "0"),
    ):
        for name in ("a.csv", "b.csv"):
            Path(name).write_text("frame,agent,x,y\n")
        error = refused("fit", "--resume", str(RUN), f"--{option}", value, "--trainer.max_epochs", "2")
        assert f"--{option} {value}: the run '{RUN}' goes on with {old}, with which it began" in error
        assert contents(RUN) == before
    settings = (RUN / "config.yaml").read_text()
    lines = [line for line in settings.splitlines() if not line.startswith("  hold_out:")]
    (RUN / "config.yaml").write_text("\n".join(lines))  # of a version without this setting
    refused("fit", "--resume", str(RUN), "--data.hold_out", "zara2")
    others = ["--data.loading.batch_size", "4", "--model.lr", "2e-3"]
    capsys.readouterr()
    assert main(["fit", "--resume", str(RUN), "--trainer.max_epochs", "2", *others]) == 0
    assert torch.load(LAST)["epoch"] == 1
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: goes on")]
    assert sorted(said) == [
        "note: goes on with --data.loading.batch_size 4, it was 8",
        "note: goes on with --model.lr 0.002, it was 0.001",
        "note: goes on with --trainer.max_epochs 2, it was 1",
    ]
    assert main(["fit", "--resume", str(RUN), "--trainer.max_epochs", "3"]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: goes on")]
    assert said == ["note: goes on with --trainer.max_epochs 3, it was 2"]


def test_a_checkpoint_that_is_damaged_is_refused_in_one_line(capsys):
    assert main(FIT) == 0
    whole, config = torch.load(LAST, weights_only=True), (RUN / "config.yaml").read_bytes()
    state = dict(whole["state_dict"])
    weight = next(key for key, value in state.items() if value.ndim == 2)
    for damage in (
        {"optimizer_states": None},
        {"optimizer_states": []},
        {"optimizer_states": [{}] * 2},
        {"loops": {}},
        {"loops": None},
        {"epoch": "one", "loops": {"fit_loop": 3}},
        {"state_dict": state | {weight: state[weight][:1]}},
        {"state_dict": {key: value for key, value in state.items() if key != weight}},
        {"state_dict": state | {weight: 3}},
        {"callbacks": {"RunRecorder": 3, "ModelCheckpoint": []}, "pytorch-lightning_version": 3},
    ):
        left = {key: value for key, value in (whole | damage).items() if value is not None}
        torch.save(left, LAST)
        capsys.readouterr()
        assert resume(2) == 2, damage
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and ("checkpoint" in said or str(LAST) in said), damage
        assert (RUN / "config.yaml").read_bytes() == config


def test_an_absent_logger_leaves_no_folder(monkeypatch, refused):
    monkeypatch.setattr("pedzoo.core.errors.find_spec", lambda name: None)
    for wandb in ("offline", "online"):
        assert "--wandb needs wandb, not installed here" in refused(*FIT, "--wandb", wandb)
        assert not Path("runs").exists()


def test_options_with_which_a_run_cannot_go_on_are_not_kept(capsys):
    assert main([*FIT, "--trainer.max_epochs", "3"]) == 0
    config, record = ((RUN / name).read_bytes() for name in ("config.yaml", "versions.json"))
    capsys.readouterr()
    assert resume(1) == 2
    assert "current_epoch=2, but you have set Trainer(max_epochs=1)" in capsys.readouterr().err
    assert ((RUN / "config.yaml").read_bytes(), (RUN / "versions.json").read_bytes()) == (config, record)


@pytest.mark.parametrize(
    ("options", "near"),
    [
        (["--monitor", "val/adee"], "val/ade"),  # known from the sanity check
        (["--monitor", "val/adee", "--trainer.num_sanity_val_steps", "0"], "val/ade"),
        (["--monitor", "train/varity"], "train/variety"),
    ],
)
def test_a_metric_that_is_not_logged_leaves_no_folder(options, near, refused):
    said = f"unknown metric to --monitor '{options[1]}': did you mean '{near}'?"
    assert said in refused(*FIT, *options) and not Path("runs").exists()


def test_a_run_does_not_go_on_with_a_misspelt_metric(refused):
    assert main(FIT) == 0
    config = (RUN / "config.yaml").read_bytes()
    error = refused("fit", "--resume", str(RUN), "--monitor", "val/adee", "--trainer.max_epochs", "2")
    assert "did you mean 'val/ade'?" in error
    assert (RUN / "config.yaml").read_bytes() == config and LAST.is_file()


def test_one_process_at_a_time_trains_in_a_folder(capsys):
    assert main(FIT) == 0
    before = contents(RUN)
    other = RunFolder.resume(RUN)
    other.begin()
    during = contents(RUN)
    capsys.readouterr()
    assert resume(2) == 2
    error = capsys.readouterr().err
    assert f"run '{RUN}' is in use by process {os.getpid()} on " in error and error.count("\n") == 1
    assert contents(RUN) == during
    other.end()
    shutil.rmtree(RUN / "before-resume-1")
    assert contents(RUN) == before
    assert resume(2) == 0 and torch.load(LAST)["epoch"] == 1


def test_a_dead_process_holds_no_folder():
    run = RunFolder.claim(RUN)
    code = f"""
import os, signal
from pathlib import Path
from pedzoo.train.run import RunFolder
run = RunFolder(Path({str(RUN)!r}))  # as long as it is held
run.begin()
print("begun", flush=True)
signal.pause()
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout and process.stdout.readline() == "begun\n"
            with pytest.raises(UserError, match=f"in use by process {process.pid} on "):
                run.begin()
        finally:
            process.kill()
    run.begin()
    run.end()
    assert not RUN.exists()


def test_metrics_tell_the_whole_run_once(monkeypatch):
    long = [*FIT, "--trainer.max_epochs", "3", "--trainer.check_val_every_n_epoch", "2"]
    assert main([*long, "--runs", "whole"]) == 0
    expected = rows_of(next(Path("whole").rglob("metrics.csv")))

    class CutError(BaseException):
        pass

    log = MetricsFile.log_metrics

    def cut(self: MetricsFile, metrics: Any, step: int | None = None) -> None:
        log(self, metrics, step)
        if metrics["epoch"] == 1 and "train/" in "".join(metrics):  # its checkpoint is there by now
            log(self, {"train/of_the_next_epoch": 0.0, "epoch": 2}, step)
            raise CutError

    with monkeypatch.context() as patched:
        patched.setattr(MetricsFile, "log_metrics", cut)
        with pytest.raises(CutError):
            main(long)
    assert torch.load(LAST)["epoch"] == 1
    assert resume(3) == 0
    assert rows_of(RUN / "metrics.csv") == expected
    assert {row["epoch"] for row in expected} == {"0", "1", "2"}


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/runs"])
def test_runs_that_cannot_be_written(place, refused):
    Path("file").write_text("mine")
    assert "cannot make the run folder" in refused(*FIT, "--runs", place)
    assert Path("file").read_text() == "mine"


def test_a_full_disk_is_said_in_one_line(monkeypatch, capsys):
    save = WholeCheckpoints.save_checkpoint

    def full(self: WholeCheckpoints, checkpoint: dict[str, Any], path: Any, **settings: Any) -> None:
        if checkpoint["epoch"]:
            raise OSError(28, "No space left on device", "last.ckpt")
        save(self, checkpoint, path, **settings)

    monkeypatch.setattr(WholeCheckpoints, "save_checkpoint", full)
    assert main([*FIT, "--trainer.max_epochs", "2"]) == 2
    said, error = capsys.readouterr()
    assert error.endswith("pedzoo: cannot write last.ckpt: No space left on device\n")
    assert f"broken off; continue with: pedzoo fit --resume {RUN}\n" in said


@pytest.fixture
def slurm(monkeypatch):
    """A job of Slurm with one process."""
    names = {"NTASKS": "1", "JOB_ID": "7", "PROCID": "0", "LOCALID": "0", "NODEID": "0", "JOB_NAME": "fit"}
    for name, value in names.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    return monkeypatch


def test_the_checkpoint_of_another_run_is_not_continued(slurm):
    assert main([*FIT, "--seed_everything", "5", "--runs", "other"]) == 0
    shutil.copy(next(Path("other").glob("*/*/checkpoints/last.ckpt")), "hpc_ckpt_1.ckpt")
    assert main([*FIT, "--trainer.max_epochs", "2"]) == 0
    Path("hpc_ckpt_1.ckpt").unlink()
    assert main([*FIT, "--trainer.max_epochs", "2"]) == 0
    assert assert_same_end(LAST, last(Path(f"{RUN}-2")))["epoch"] == 1


def distributed(*words: str) -> subprocess.Popen[str]:
    """Start a command line whose processes are a group of their own."""
    command = [sys.executable, "-m", "pedzoo.cli.main", *words]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, env=environment(), start_new_session=True, **pipes)


@pytest.mark.slow
def test_two_killed_processes_end_as_uninterrupted_ones():
    words = [*FIT, "--trainer.max_epochs", "4", "--trainer.accelerator", "cpu", "--trainer.devices", "2"]
    words += ["--trainer.strategy", "ddp_find_unused_parameters_true"]
    with distributed(*words) as killed:
        try:
            while not LAST.is_file() and killed.poll() is None:
                time.sleep(0.01)
        finally:
            os.killpg(killed.pid, signal.SIGKILL)
        said, _ = killed.communicate(timeout=200)
    assert killed.returncode != 0, said
    assert torch.load(LAST)["epoch"] < 3
    with distributed("fit", "--resume", str(RUN)) as resumed:
        said, _ = resumed.communicate(timeout=400)
    assert resumed.returncode == 0, said
    with distributed(*words, "--runs", "whole") as whole:
        said, _ = whole.communicate(timeout=400)
    assert whole.returncode == 0, said
    end = assert_same_end(LAST, Path("whole") / LAST.relative_to("runs"))
    assert end["epoch"] == 3
