"""Everything that the README tells people to type works, in the order in which they read it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from pedzoo.cli.commands import demo
from pedzoo.cli.main import main
from pedzoo.core.paths import config_names, shipped

ROOT = Path(__file__).parents[2]
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
TUNED = "demo/runs/sgan_goal_map/embedded-seed0/checkpoints/best.ckpt"
BENCH = ["--quick", "--seconds", "0.01", "--turns", "1", "--size", "2x5"]
ELSEWHERE = [shlex.split(command) for _, command in [*demo.steps(), demo.compared(TUNED)]]
"""Commands that other tests run: here those of tests/cli/test_demo.py."""
ELSEWHERE += [
    shlex.split(command)
    for command in (
        "evaluate sgan_goal_map.zara1 --from-card",  # tests/eval/test_card_numbers.py
        "export sgan_goal.eth_ucy --onnx model.onnx",  # tests/models/test_onnx.py
        "reproduce table1 --out pages",  # tests/tools/test_reproduce.py
        "reproduce figure4 --out pages --quick",
        "evaluate straight orca --suite robots --people orca,sgan_goal_map.indoor,replay "
        "--robot diff_drive:radius=0.35 --quick",  # tests/eval/test_robots.py
        "fit --config closed_loop/sgan_goal_map",  # tests/train/test_configs.py
        "fit --config closed_loop/sgan_goal_map --weights social_vrnn.eth_ucy",  # train/test_in_the_loop.py
        "fit --config closed_loop/sgan_goal_map --weights sgan_goal.zara1 --model.walking.walls 30",
        "fit --config ppo/sgan_goal --weights sgan_goal.eth_ucy",  # tests/train/test_ppo.py
    )
]


def blocks(language: str) -> list[str]:
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def commands() -> list[list[str]]:
    """Return all ``pedzoo`` commands, in order."""
    lines = [line.partition("#")[0].strip() for block in blocks("bash") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("pedzoo ")]


@pytest.fixture
def readers_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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
    readers_folder: Path, shared: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PEDZOO_DATA", str(shared / "data"))
    result = commands()
    walk = ["--episodes", "2", "--video_seconds", "1"]
    less = {"fit": SHORT, "forecast": ["--samples", "2"], "rollout": walk, "plans": [], "bench": BENCH}
    less |= {name: [] for name in ("models", "info", "robots", "export")}
    less["evaluate"] = ["--suite", "encounters", "--episodes", "1"]
    assert {words[0] for words in result} == {*less, *(words[0] for words in ELSEWHERE)}
    for words in result:
        if words not in ELSEWHERE:
            shorter = ["--no-evaluation"] if "--zoo" in words else less[words[0]]
            assert main([*words, *shorter]) == 0, words
    for file in ("out.json", "walk.json", "door.png", "door.webm", "walked.json", "walked.md"):
        assert (readers_folder / file).is_file()
    assert "min_ade_2" in capsys.readouterr().out


def test_what_is_shown_elsewhere_is_in_the_readme() -> None:
    assert all(words in commands() for words in ELSEWHERE)


def test_python_snippets(readers_folder: Path) -> None:
    scopes: list[dict] = [{} for _ in blocks("python")]
    for snippet, scope in zip(blocks("python"), scopes, strict=True):
        exec(compile(snippet, "README.md", "exec"), scope)
    forecast, compared, walk, robot, own, beside_a_robot = scopes
    scenes, samples, people, steps, _ = forecast["futures"].shape
    assert (samples, steps) == (20, 8)
    assert forecast["batch"]["agents", "mask"].shape == (scenes, people)
    assert compared["success"] == {"go_to_goal": 1.0, "orca:radius=0.3": 1.0}
    assert walk["trace"].shape == (8, 50, 5, 4, 2)
    assert set(robot["observation"]) == {"robot", "people", "mask"}
    assert set(own["velocity"]) == {"anna", 7}
    assert own["people"]["anna"][0] > -3  # she set out from -9
    assert list(beside_a_robot["velocity"]) == ["anna"]


def test_the_two_scripts_and_every_linked_file_exist() -> None:
    for script in re.findall(r"^\./(\S+)", blocks("bash")[0], re.MULTILINE):
        assert (ROOT / script).stat().st_mode & 0o111, script
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / link).exists(), link


def test_every_config_is_in_the_table_and_every_name_in_the_table_is_a_config() -> None:
    table = README.partition("| config | model |")[2].partition("\n\n")[0]
    names = (line.split("|")[1] for line in table.splitlines() if line.startswith("| `"))
    named = {name for cell in names for name in re.findall(r"`([\w/]+)`", cell)}
    assert named == set(config_names())
