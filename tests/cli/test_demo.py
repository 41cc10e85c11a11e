"""The demo: all of its commands run, write what they promise, and show what they are there to show."""

import json
import shlex
from importlib.util import find_spec

from helpers.training import LIGHTNING_MARKS

from pedzoo.cli.commands import demo
from pedzoo.cli.main import main
from pedzoo.viz.video import read_video

pytestmark = LIGHTNING_MARKS


def test_the_demo_walks_tunes_and_compares(elsewhere, capsys, monkeypatch) -> None:
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    policies = f"{demo.CONTROLLER} orca:radius=0.3"
    less = {"FILM_SECONDS": 1, "EPISODES": 1, "POLICIES": policies, "METRICS": "success,time_ratio"}
    for name, value in less.items():
        monkeypatch.setattr(demo, name, value)
    assert main(["demo", "--out", "my demo", "--epochs", "3"]) == 0
    printed = capsys.readouterr().out
    out = elsewhere / "my demo"
    for picture in ("door.png", "apartment.png", "forecasts.png"):
        assert (out / picture).read_bytes().startswith(b"\x89PNG")
    assert read_video(out / "door.webm")[0] == 11
    physics = "bullet" if find_spec("pybullet") else "compiled"
    for title, command in demo.steps(shlex.quote("my demo"), 3, physics):
        assert f" {title}\n$ pedzoo {command}\n" in printed
    tuned = out / "runs" / "sgan_goal" / "embedded-seed0" / "checkpoints" / "best.ckpt"
    last = demo.last_steps(shlex.quote(str(tuned.relative_to(elsewhere))), shlex.quote("my demo"))
    assert tuned.is_file() and all(command in printed for _, command in last)
    report = json.loads((out / "door.json").read_text())
    assert [row["name"] for row in report["rows"]] == demo.POLICIES.split()
    assert report["protocol"]["physics"] == physics
    for number in range(1, 8):
        assert f"\n{number}/7 " in printed
    page = (out / "report.html").read_text()
    assert all(text in page for text in ("apartment.7", demo.CONTROLLER, "val/ade", '"episodes":[{'))
    # all rows of the table of forecasts, and what is shown in Python
    assert all(name in printed for name in ("constant_velocity", "straight_line", "bent_line"))
    velocity = next(line for line in printed.splitlines() if line.startswith("{'anna'"))
    (anna, _), (ben, _) = json.loads(velocity.translate(str.maketrans("'()", '"[]'))).values()
    assert anna > 0 > ben


def test_a_step_that_fails_ends_the_demo(tmp_path, capsys) -> None:
    (tmp_path / "out" / "door.png").mkdir(parents=True)
    assert main(["demo", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert "door.png: is a folder, expected a file" in said.err
    assert "\n2/7" in said.out and "\n3/7" not in said.out


def test_rollout_prints_the_metrics_that_are_asked_for(capsys) -> None:
    command = ["rollout", "go_to_goal", "--physics", "compiled", "--episodes", "1", "--metrics"]
    assert main([*command, "time_ratio,success"]) == 0
    printed = capsys.readouterr().out
    assert printed.index("time_") < printed.index("success") and "deadlock" not in printed
