"""The examples are short, and do what they say."""

import json
import runpy
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, **settings: Any) -> Any:
    return runpy.run_path(str(EXAMPLES / name))["main"](**settings)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_are_shorter_than_60_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) < 60


def test_robots_in_gymnasium(capsys: pytest.CaptureFixture[str]) -> None:
    run("robot_gym.py", decisions=70)
    first, second = capsys.readouterr().out.splitlines()
    assert "'SUCCESS': True" in first and "'COLLISION_HUMAN': False" in first
    arrived, ended = (int(word) for word in second.split() if word.isdigit())
    assert 0 < arrived <= ended


def test_robots_in_torchrl(capsys: pytest.CaptureFixture[str]) -> None:
    run("robot_torchrl.py", scenes=4, decisions=60)
    straight, untrained = capsys.readouterr().out.splitlines()
    assert straight.startswith("straight: ") and untrained.startswith("untrained: ")
    assert int(straight.split()[1]) > int(untrained.split()[1])


def test_people_walk_around_a_robot_of_ones_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("people_around_a_robot.py", seconds=6.0) > 0.15  # a body's radius: no touch
    assert capsys.readouterr().out.startswith(" 0.0 s: robot (6.")


def test_policies_are_compared(tmp_path: Path) -> None:
    results = run("compare_policies.py", episodes=2, out=str(tmp_path / "door.png"))
    assert results["approach_net_goal_map.indoor"]["clean"] == 1.0 > results["go_to_goal"]["clean"]
    assert (tmp_path / "door.png").read_bytes().startswith(b"\x89PNG")


def test_the_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    cells = json.loads((EXAMPLES / "first_steps.ipynb").read_text())["cells"]
    scope: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), "first_steps.ipynb", "exec"), scope)
    assert scope["values"]["success"] == 1.0 and len(scope["axes"].lines) == 2
    assert scope["people"]["anna"][0] > 6.0


@pytest.mark.skipif(find_spec("pybullet") is None, reason="needs pybullet")
def test_people_walk_around_a_husky(capfd: pytest.CaptureFixture[str]) -> None:
    """They meet it head-on: the middle one has to leave the straight line, and none touches it."""
    assert run("husky_pybullet.py", seconds=10.0) > 0
    driven = float(capfd.readouterr().out.split("drove ")[1].split()[0])
    assert 5 < driven < 8
