"""Everything that the README tells people to type works, in the order in which they read it."""

from __future__ import annotations

import json
import re
import shlex
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from pedzoo.cli.main import main
from pedzoo.eval.video import read_video
from pedzoo.paths import config_names, shipped

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SHORT = [
    "--trainer.max_epochs",
    "1",
    "--trainer.limit_train_batches",
    "2",
    "--trainer.limit_val_batches",
    "1",
]
SHORT += ["--trainer.check_val_every_n_epoch", "1", "--trainer.enable_progress_bar", "false"]
SHORT += ["--rollout.episodes", "2"]
BENCH = ["--quick", "--seconds", "0.01", "--turns", "1", "--size", "2x5"]


def blocks(language: str) -> list[str]:
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def commands() -> list[list[str]]:
    """Return all ``pedzoo`` commands, in order."""
    lines = [line.partition("#")[0].strip() for block in blocks("bash") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("pedzoo ")]


@pytest.fixture
def somebodys_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the files that the README's reader is supposed to have."""
    monkeypatch.chdir(tmp_path)
    plaza = ROOT / "pedzoo" / "data" / "embedded"
    table = np.loadtxt(plaza / "plaza_test.csv", delimiter=",", skiprows=1)
    table[:, 0] *= 4  # recorded at 0.1 s
    for name in ("a.csv", "b.csv"):
        np.savetxt(tmp_path / name, table, "%g", ",", header="frame,agent,x,y", comments="")
    plan = (plaza / "plaza.yaml").read_text()
    (tmp_path / "plan.yaml").write_text(plan)
    (tmp_path / "plaza.png").write_bytes((plaza / "plaza.png").read_bytes())
    mine = tmp_path / "path" / "to"
    mine.mkdir(parents=True)
    source = (shipped("configs").parent / "pedzoo/models/architectures/constant_velocity.py").read_text()
    (mine / "mine.py").write_text(source.replace("ConstantVelocity", "Mine"))
    (tmp_path / "mine.yaml").write_text(
        (shipped("configs") / "sgan.yaml").read_text().replace("zara1", "embedded")
    )
    return tmp_path


def test_pedzoo_commands(
    somebodys_folder: Path, shared: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PEDZOO_DATA", str(shared / "data"))
    found = commands()
    walk = ["--episodes", "2", "--video_seconds", "1"]
    less = {"fit": SHORT, "forecast": ["--samples", "2"], "rollout": walk, "plans": [], "bench": BENCH}
    less["evaluate"] = ["--suite", "cards", "--episodes", "1"]
    assert {words[0] for words in found} == set(less)
    for words in found:
        assert main([*words, *less[words[0]]]) == 0, words
    for file in ("out.json", "walk.json", "door.png", "door.webm", "walked.json", "walked.md"):
        assert (somebodys_folder / file).is_file()
    assert "min_ade_2" in capsys.readouterr().out


def test_python_snippets(somebodys_folder: Path) -> None:
    scopes: list[dict] = [{} for _ in blocks("python")]
    for snippet, scope in zip(blocks("python"), scopes, strict=True):
        exec(compile(snippet, "README.md", "exec"), scope)
    forecast, compared, walk, own = scopes
    scenes, samples, people, steps, _ = forecast["futures"].shape
    assert (samples, steps) == (20, 8)
    assert forecast["batch"]["agents", "mask"].shape == (scenes, people)
    assert compared["success"] == {"go_to_goal": 1.0, "orca:radius=0.3": 1.0}
    assert walk["trace"].shape == (8, 50, 5, 4, 2)
    assert set(own["velocity"]) == {"anna", 7}
    assert own["people"]["anna"][0] > -3  # she set out from -9


def test_the_two_scripts_and_every_linked_file_exist() -> None:
    for script in re.findall(r"^\./(\S+)", blocks("bash")[0], re.MULTILINE):
        assert (ROOT / script).stat().st_mode & 0o111, script
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / link).exists(), link


def test_every_config_is_in_the_table_and_every_name_in_the_table_is_a_config() -> None:
    table = README.partition("| config | model |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(sgan\w*)`", table))
    assert named == {name for name in config_names() if name.startswith("sgan")}


def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pedzoo.cli.commands.demo.FILM_SECONDS", 1.0)
    monkeypatch.setattr("pedzoo.cli.commands.demo.EPISODES", 2)
    assert main(["demo", "--out", str(tmp_path / "demo"), "--epochs", "1"]) == 0
    printed = capsys.readouterr().out
    for name in (
        "constant_velocity",
        "straight_line",
        "bent_line",
        "sgan_goal",
        "forecasts.png",
        "forecast.json",
        "orca:radius=0.5",
        "orca:radius=0.1",
        "sgan_goal_map.zara1",
        "door.png",
        "door.webm",
        "door.json",
    ):
        assert name in printed
    for name in ("forecasts.png", "door.png"):
        assert (tmp_path / "demo" / name).read_bytes().startswith(b"\x89PNG")
    assert read_video(tmp_path / "demo" / "door.webm")[0] == 11
    report = json.loads((tmp_path / "demo" / "door.json").read_text())
    blocked, passing, learned = (row["metrics"] for row in report["rows"])
    assert blocked["success"] == 0 and passing["success"] == 1 and learned["failed"] == 0
    assert report["protocol"]["world"] == ("bullet" if find_spec("pybullet") else "grid")
