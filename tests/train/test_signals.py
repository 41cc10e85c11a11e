"""Signals end every command as Ctrl-C does, and what was begun goes on."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.training import FIT, LAST, RUN, assert_same_end, environment

from pedzoo.cli.main import main

FIT = [*FIT, "--trainer.max_epochs", "2"]
JOB = {"NTASKS": "1", "JOB_ID": "7", "PROCID": "0", "LOCALID": "0", "NODEID": "0", "JOB_NAME": "fit"}
SLURM = {f"SLURM_{name}": value for name, value in JOB.items()}

STOPS = """
import os, signal, sys
from pedzoo.cli.main import main
from pedzoo.train.gan import GANModule

steps = GANModule.training_step

def stopped(self, *batch):
    result = steps(self, *batch)
    if int(self.iteration) == 3:  # in the midst of the second epoch, before Lightning has counted the step
        os.kill(os.getpid(), int(sys.argv[1]))
        os.kill(os.getpid(), int(sys.argv[1]))  # a terminal and its shell send one each
    return result

GANModule.training_step = stopped
sys.exit(main(sys.argv[2:]))
"""

WAITS = """
import time
from pathlib import Path
from typing import Any
from pedzoo.eval.suite import EvaluationCase, Suite

class Waits(Suite):
    accepted_options = ("episodes",)

    def cases(self, options):
        return [EvaluationCase(self.name, name, "circle", "compiled", 1, {}) for name in ("one", "two")]

    def rows(self, unit, tell=None):
        if unit.case.name == "two" and not Path("waits").exists():
            Path("waits").touch()
            time.sleep(500)
        return super().rows(unit, tell)
"""

pytestmark = [pytest.mark.usefixtures("elsewhere", "hangups")]


@pytest.fixture(name="hangups")
def processes_that_hear_hangups():
    """Let processes that a test starts hear SIGHUP: below ``nohup`` they would inherit that it is ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def run(code: list[str], **variables: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own."""
    pipes: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 200, "check": False}
    return subprocess.run([sys.executable, *code], env=environment(**variables), **pipes)


def stopped(number: int, **variables: str) -> subprocess.CompletedProcess[str]:
    """Train, and send a signal in the second epoch."""
    return run(["-c", STOPS, str(number), *FIT], **variables)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the last checkpoint of the same training that nothing stopped."""
    runs = tmp_path_factory.mktemp("whole")
    assert main([*FIT, "--runs", str(runs)]) == 0
    return runs / LAST.relative_to("runs")


def test_a_training_that_sigterm_ended_is_resumed(whole):
    ended = stopped(signal.SIGTERM)
    assert ended.returncode == 143, ended.stderr
    assert f"interrupted; continue with: pedzoo fit --resume {RUN}\n" in ended.stdout
    assert ended.stderr.endswith("pedzoo: ended by SIGTERM\n") and "Traceback" not in ended.stderr
    assert torch.load(LAST)["epoch"] == 0
    assert main(["fit", "--resume", str(RUN)]) == 0
    assert assert_same_end(LAST, whole)["epoch"] == 1  # to the last bit, of both networks


def test_a_job_that_slurm_runs_again_goes_on(whole, monkeypatch):
    scontrol = Path("bin/scontrol")
    scontrol.parent.mkdir()
    scontrol.write_text('#!/bin/sh\necho "$@" >> asked\nls -A runs/sgan_nopool/embedded-seed0 >> asked\n')
    scontrol.chmod(0o755)
    path = {"PATH": f"{scontrol.parent.absolute()}:{os.environ['PATH']}"}
    ended = stopped(signal.SIGUSR1, **SLURM, **path)
    assert ended.returncode == 138, ended.stderr
    assert "Slurm runs job 7 again" in ended.stdout
    asked = Path("asked").read_text().split()
    assert asked[:2] == ["requeue", "7"] and ".in-use" not in asked  # nothing is left to write by then
    for name, value in SLURM.items():
        monkeypatch.setenv(name, value)
    assert main([*FIT, "--seed_everything", "5"]) == 0  # another run of the job
    monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
    assert main(FIT) == 0
    assert {path.name for path in Path("runs/sgan_nopool").iterdir()} == {"embedded-seed0", "embedded-seed5"}
    assert list(Path().rglob("hpc_ckpt*")) == []
    assert main(FIT) == 0  # the same training again, in the same run of the job
    assert Path(f"{RUN}-2").is_dir()
    for name in (*SLURM, "SLURM_RESTART_COUNT"):
        monkeypatch.delenv(name)
    assert assert_same_end(LAST, whole)["epoch"] == 1  # to the last bit, of both networks


def started(words: list[str], until: Callable[[], bool]) -> subprocess.Popen[str]:
    """Start a command in a session of its own, and return it once something has come true."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-m", "pedzoo", *words]
    process = subprocess.Popen(command, env=environment(), start_new_session=True, **pipes)
    while not until() and process.poll() is None:
        time.sleep(0.01)
    return process


@pytest.mark.slow
def test_an_evaluation_whose_terminal_was_closed_goes_on():
    Path("waits.py").write_text(WAITS)
    words = ["evaluate", "go_to_goal", "--suite", "waits.py:Waits", "--episodes", "1"]
    words += ["--json", "report.json"]
    journal = Path("report.json.partial")
    with started(
        [*words, "--workers", "2"], lambda: journal.is_file() and Path("waits").is_file()
    ) as process:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGHUP)  # workers, too
        try:
            said, errors = process.communicate(timeout=100)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # else the block waits for ever
            raise
    assert process.returncode == 129, errors
    assert f"is kept in {journal}: the same command goes on from there" in said
    assert errors.endswith("pedzoo: ended by SIGHUP\n") and "Traceback" not in errors
    assert len(journal.read_text().splitlines()) == 1
    assert json.loads(Path("report.json").read_text())["interrupted"]
    assert main(words) == 0
    report = json.loads(Path("report.json").read_text())
    assert "interrupted" not in report and len(report["rows"]) == 2
