"""The command line: quick help, exit codes, and one helpful line for every mistake."""

import errno
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.training import SHORT
from jsonargparse import ArgumentParser

import pedzoo
from pedzoo.cli.main import main
from pedzoo.cli.output import write_json
from pedzoo.cli.parsing import PARSER_SETTINGS, parse
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.registry import COMMANDS

ROOT = Path(pedzoo.__file__).parents[1]
FIT = ["fit", "--config", "sgan_goal", "--data.fold", "embedded"]
QUIET = ["--trainer.enable_progress_bar=false", "--model.samples=2", "--model.generator.losses.best_k=2"]

pytestmark = pytest.mark.usefixtures("elsewhere")


def test_a_mistake_gives_no_orders_to_the_terminal(refused):
    error = refused("models", "--json", "/dev/null/a\x1b[2J\x9b\u202eb")
    assert error.rstrip().isprintable() and "--json /dev/null/a [2J b: '/dev/null' is a file" in error


def test_help_and_version_import_nothing_heavy():
    code = (
        "import sys; from pedzoo.cli.main import main; assert main(['--help']) == main(['--version']) == 0;"
        "heavy = {'torch', 'lightning', 'numpy', 'rich', 'jsonargparse', 'tensordict'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert f"pedzoo {pedzoo.__version__}" in done.stdout


def test_overview_names_every_command_config_and_model(capsys):
    assert main([]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS.names():
        assert f"  {name} " in text and f"$ pedzoo {name}" in text
    for name in (*config_names(), "sgan", "eth_ucy"):
        assert f"  {name}" in text


@pytest.mark.parametrize("command", COMMANDS.names())
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as exit_:
        main([command, "--help"])
    assert exit_.value.code == 0
    text = capsys.readouterr().out
    assert "example:" in text and f"pedzoo {command}" in text.partition("example:")[2]
    assert not re.search(r"^  --\w+ [A-Z_]+ +\(type", text, re.MULTILINE), "an option without a text"


def parsed(typed: str, **types):
    parser = ArgumentParser(**PARSER_SETTINGS)
    for name, kind in types.items():
        parser.add_argument(f"--{name}", type=kind)
    return parse(parser, typed.split())


@pytest.mark.parametrize(
    ("typed", "kind", "wanted"),
    [
        ("--one", bool, True),
        ("--one=true", bool, True),
        ("--one false", bool, False),
        ("--one x.y", str, "x.y"),
        ("--one a.csv,b.csv", list[str] | None, ["a.csv", "b.csv"]),
        ("--one=door", list[str] | None, ["door"]),
        ("--one d:w=[0.7,0.9],p=4,c,f.py:M:a=1", list[str], ["d:w=[0.7,0.9],p=4", "c", "f.py:M:a=1"]),
        ("--one [a,b]", list[str] | None, ["a", "b"]),
        ("--one null", list[str] | None, None),
        ("--one 2", list[int] | int | str, 2),
        ("--one 0,1", list[int] | int | str, [0, 1]),
        ("--one auto", list[int] | int | str, "auto"),
        ("--one 12,9", tuple[float, float] | None, (12, 9)),
        ("--one 1,2,3", tuple[int, ...], (1, 2, 3)),
    ],
)
def test_values_are_read_as_people_type_them(typed, kind, wanted):
    assert parsed(typed, one=kind).one == wanted
    assert parsed("--video-view top --quick", video_view=str, quick=bool).video_view == "top"


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("--size 12 9", "--size 12: expected 2 values with a comma between them, as --size 12,9"),
        ("--size=12,9,3", "--size 12,9,3: expected 2 values with a comma between them, as --size 12,9"),
        ("--doors 1 --size 12,9", "--doors 1: expected 2 values with a comma between them, as --doors 1,1"),
        ("--size [12]", "--size: expected tuple[float, float] or null, not '[12]'"),
        ("--size 1,2,3 --doors 1,2 --any 3,4,5", "--size 1,2"),
    ],
)
def test_pairs_say_how_they_are_typed(typed, expected):
    pair = tuple[float, float]
    with pytest.raises(UserError, match=f"{re.escape(expected)}$"):
        parsed(typed, size=pair | None, doors=pair, any=tuple[int, ...])


@pytest.mark.parametrize(
    ("yaml", "expected"),
    [
        ("modell: {lr: 1}", "unknown option --modell.lr: did you mean --model.lr?"),
        ("data: {batchsize: 4}", "unknown option --data.batchsize: did you mean --data.loading.batch_size?"),
        ("model: {init_args: {generator: {init_args: {goal_dims: 3}}}}", "generator.architecture.goal_dim?"),
        ("data: {loading: {batch_size: many}}", "--data.loading.batch_size: expected int, not 'many'"),
        ("data: [", "config 'own.yaml' is no YAML: cannot be read: while parsing"),
    ],
)
def test_misspelt_keys_in_a_config_are_refused(yaml, expected, refused, elsewhere):
    (elsewhere / "own.yaml").write_text(yaml)
    assert expected in refused(*FIT, "--config", "own.yaml")


@pytest.mark.parametrize("command", ["test", "validate"])
def test_files_that_are_no_checkpoints_are_called_so(command, refused):
    for name in ("cut.ckpt", "good.csv", "weights.safetensors"):
        Path(name).write_bytes(b"PK, and no more")
    expected = "expected a .ckpt file, as pedzoo fit writes it"
    for name, said in (
        ("cut.ckpt", "checkpoint 'cut.ckpt' cannot be read (File is not a zip file): is it cut off?"),
        ("good.csv", f"--ckpt_path good.csv: {expected}\n"),
        ("weights.safetensors", f"{expected}; weights are measured by: pedzoo forecast"),
    ):
        assert said in refused(command, "--ckpt_path", name)


def fails(monkeypatch, error: BaseException) -> None:
    """Let the command ``models`` end by an error."""

    def run(argv):
        raise error

    monkeypatch.setattr("pedzoo.cli.commands.lists.models", run)


def test_our_own_mistakes_keep_their_traceback(monkeypatch):
    for error in (ZeroDivisionError(), RuntimeError("shapes"), FileNotFoundError(2, "no", "x")):
        fails(monkeypatch, error)
        with pytest.raises(type(error)):
            main(["models"])
    fails(monkeypatch, KeyboardInterrupt())
    assert main(["models"]) == 130


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory (nothing is left): take fewer at once"),
        (MemoryError("Unable to allocate 8 EiB"), "(Unable to allocate 8 EiB)"),
        (RuntimeError("[enforce fail] . DefaultCPUAllocator: can't allocate memory: 5"), "memory: 5)"),
        (torch.OutOfMemoryError("CUDA out of memory. Tried\nto"), "(CUDA out of memory. Tried to)"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "Cannot allocate memory"),
        (OSError(errno.EFBIG, "File too large", "big.ckpt"), "cannot write big.ckpt: File too large"),
        (OSError(errno.EFBIG, "File too large"), "cannot write a file: File too large"),
        (OSError(errno.ENOSPC, "No space left on device", "a"), "cannot write a: No space left on device"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "aa"), "'aa': no file has so long a name"),
    ],
)
def test_what_the_machine_lacks_is_one_line(error, said, monkeypatch, refused):
    fails(monkeypatch, error)
    assert said in refused("models")


def test_a_real_lack_of_memory_or_room_is_told(monkeypatch, refused, tmp_path):
    for make in (torch.zeros, np.zeros, bytearray):
        monkeypatch.setattr("pedzoo.cli.commands.lists.models", lambda argv, make=make: make(2**58))
        assert refused("models").startswith("pedzoo: not enough memory (")
    if sys.platform == "linux":  # a limit of the shell's, in a process of its own
        code = "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        code += "resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10)); from pedzoo.cli.main import main; "
        code += "sys.exit(main(['models', '--json', 'a.json']))"
        ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
        assert ended.returncode == 2 and "a.json" in ended.stderr and ended.stderr.count("\n") == 1


def test_fit_resume_test_and_forecast(capsys, elsewhere):
    """One run through its life: folders, records, overrides over a checkpoint, the next command."""
    once = ["--trainer.check_val_every_n_epoch=2", "--rollout.episodes=1"]  # the last epoch all the same
    assert main([*FIT, *SHORT, *QUIET, *once, "--weights", "sgan_goal.zara1", "--model.lr", "0.004"]) == 0
    run = Path("runs/sgan_goal/embedded-seed0")
    best = run / "checkpoints" / "best.ckpt"
    printed = capsys.readouterr().out
    assert re.search(r"\nval/ade \d\.\d{3} \(epoch 0\), door success \d\.\d\d, \d+ (s|min)\nnext: ", printed)
    assert f"next: pedzoo forecast {best} --data.fold embedded --data.goal window_end" in printed
    assert f"pedzoo rollout {best} --scenario door" in printed
    assert [path.name for path in elsewhere.iterdir()] == ["runs"]
    assert {path.name for path in (run / "checkpoints").iterdir()} == {"best.ckpt", "last.ckpt"}
    assert "lr: 0.004" in (run / "config.yaml").read_text()
    record = json.loads((run / "versions.json").read_text())
    assert record["command"][:2] == ["pedzoo", "fit"] and record["versions"]["pedzoo"] == pedzoo.__version__
    assert "val/ade" in (run / "metrics.csv").read_text()

    again = ["fit", "--resume", str(run), "--trainer.max_epochs", "2", "--model.lr", "0.003"]
    assert main(again) == 0
    assert "lr: 0.003" in (run / "config.yaml").read_text()
    assert "lr: 0.004" in (run / "before-resume-1" / "config.yaml").read_text()
    lines = (run / "metrics.csv").read_text().splitlines()
    assert {line.partition(",")[0] for line in lines[1:]} == {"0", "1"}

    assert main(["test", "--ckpt_path", str(best), "--json", "test.json", *QUIET]) == 0
    report = json.loads(Path("test.json").read_text())
    assert report["protocol"]["goal"] == "window_end" and report["rows"][0]["metrics"]["ade"] < 0.5

    capsys.readouterr()
    assert main(["forecast", str(best), "--samples", "2", "--json", "-"]) == 0
    rows = json.loads("{" + capsys.readouterr().out.partition("\n{")[2])["rows"]
    names = ["constant_velocity", str(best), "straight_line", "bent_line", "anchors"]
    assert [row["name"] for row in rows] == names
    assert {row["metrics"]["ade_m"] > 0 for row in rows} == {True}


def test_reports_are_written_whole_into_new_folders(elsewhere, monkeypatch):
    file = elsewhere / "a" / "b" / "report.json"
    write_json(file, {"rows": 1})
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "no space left")))
        with pytest.raises(UserError, match=r"cannot write '.*report\.json': no space left"):
            write_json(file, {"rows": 2})
    assert json.loads(file.read_text()) == {"rows": 1}
    assert list(file.parent.iterdir()) == [file]
    (elsewhere / "link.json").symlink_to(file)
    write_json("link.json", {"rows": 3})
    assert json.loads(file.read_text()) == {"rows": 3} and Path("link.json").is_symlink()


def test_robots_lists_bodies_sensors_rewards_and_policies(capsys, elsewhere):
    assert main(["robots", "*o*", "--json", "robots.json"]) == 0
    report = json.loads(Path("robots.json").read_text())
    names = {kind: [row["name"] for row in report[kind]] for kind in ("robots", "sensors", "policies")}
    assert "turtlebot4" in names["robots"] and "jackal" not in names["robots"]
    assert "goal" in names["sensors"] and "stop" in names["policies"]
    assert "goal" in (said := capsys.readouterr().out) and "straight" not in said


@pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="needs a checkout")
def test_wheel_holds_configs_and_checkpoints(elsewhere):
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(elsewhere)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = elsewhere.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    readme = (ROOT / "README.md").read_text()
    weights = {
        name
        for name in re.findall(r"`([a-z_]+\.[a-z0-9_]+)`", readme)
        if (ROOT / "checkpoints" / name).is_dir()
    }
    folders = [ROOT / "configs", *(ROOT / "checkpoints" / name for name in sorted(weights))]
    shipped = [path.relative_to(ROOT) for one in folders for path in one.rglob("*.*") if path.is_file()]
    embedded = ROOT / "pedzoo" / "data" / "embedded"
    shipped += [path.relative_to(ROOT / "pedzoo") for path in embedded.glob("*.*")]
    assert weights and {f"pedzoo/{path}" for path in shipped} <= names
    assert wheel.stat().st_size < 10e6 and not any("results" in Path(name).parts for name in names)
    assert "pedzoo/py.typed" in names and not any("test" in Path(name).parts for name in names)
