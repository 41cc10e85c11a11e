"""Metrics of one's own: a function in a file from any folder, and what is said where it fails."""

import json
from pathlib import Path
from textwrap import dedent

import pytest

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core import registry
from pedzoo.core.errors import UserError
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.metrics.closed_loop import NAMES, closed_loop

METRICS = '''
    """How long people are there."""

    from pedzoo.metrics.ratios import Ratio, metric, share


    def seconds_there(rollout):
        return rollout.scored.sum((1, 2)) * 0.1, rollout.mask.sum(1)

    @metric("ordinary")
    def always_there(rollout) -> Ratio:
        return share(rollout.scored[..., -1].all(1))

    def success(rollout):
        return rollout.mask.sum(1), rollout.mask.sum(1)

    def of_people(rollout):
        return rollout.mask, rollout.mask

    def with_count(rollout):
        return rollout.mask.sum(1), rollout.mask.sum(1), rollout.mask.sum(1)

    def below_0(rollout):
        return rollout.mask.sum(1), -rollout.mask.sum(1)

    def more_than_all(rollout):
        return share(2.0 * rollout.mask, rollout.mask)

    def fails(rollout):
        return rollout.mask.sum(1) / {}["gone"]
'''


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "metrics.py").write_text(dedent(METRICS))
    return tmp_path


def test_a_metric_on_rollout(folder: Path, capsys) -> None:
    """The mean over people of the time that they are there, with an interval, in the table and in JSON."""
    words = ["rollout", "go_to_goal", "--physics", "compiled", "--episodes", "5"]
    metrics, report = f"{folder / 'metrics.py'}:seconds_there", folder / "out.json"
    assert main([*words, "--metrics", metrics, "--json", str(report)]) == 0
    (row,) = json.loads(report.read_text())["rows"]
    walked, _ = pedzoo.rollout("go_to_goal", "door", "compiled", 5)
    seconds = 0.1 * float(walked.scored.sum()) / int(walked.mask.sum())
    assert row["metrics"]["seconds_there"] == pytest.approx(seconds)
    low, high = row["ci95"]["seconds_there"]
    assert low < seconds < high and {"success", "spl"} <= row["metrics"].keys()
    alone = capsys.readouterr().out
    assert main([*words, "--metrics", f"success,{metrics}"]) == 0
    both = capsys.readouterr().out
    assert "seconds" in alone and "success" not in alone and "spl" not in alone
    assert "seconds" in both and "success" in both and "spl" not in both


def test_a_metric_that_fails_does_not_lose_the_walk(folder: Path, capsys) -> None:
    """Table, report, plot and page have all others; the error names the metric, its line and the cause."""
    words = ["rollout", "go_to_goal", "--scenario", "circle:people=2", "--physics", "compiled"]
    file, report = folder / "metrics.py", folder / "out.json"
    words += ["--episodes", "2", "--metrics", f"{file}:fails,{file}:of_people,{file}:seconds_there"]
    files = ["--json", str(report), "--plot", str(folder / "a.png"), "--html", str(folder / "a.html")]
    assert main([*words, *files]) == 2
    told = capsys.readouterr()
    line = METRICS[1:].split("\n").index('        return rollout.mask.sum(1) / {}["gone"]') + 2
    assert told.err == f"pedzoo: metric fails ({file}, line {line}) raised KeyError: 'gone'\n"
    assert "spl" in told.out and "seconds" in told.out
    (row,) = json.loads(report.read_text())["rows"]
    assert {"success", "seconds_there"} <= row["metrics"].keys() and "fails" not in row["metrics"]
    assert (folder / "a.png").is_file() and (folder / "a.html").is_file()
    with pytest.raises(UserError, match=r"metric fails .* raised KeyError: 'gone'") as caught:
        closed_loop(pedzoo.rollout("go_to_goal", "circle:people=2", "compiled", 1)[0], [f"{file}:fails"])
    assert isinstance(caught.value.__cause__, KeyError)


def test_metrics_on_evaluate(folder: Path, monkeypatch) -> None:
    """Of ordinary scenes and of replays, beside the real people, the same with two workers."""
    monkeypatch.setattr("pedzoo.eval.suites.replay.QUICK", 20)
    (folder / "all.py").write_text(
        "from pedzoo.eval.suites.replay import Replay\n\nclass All(Replay):\n    simulated = ('all',)\n"
    )
    metrics = [f"{folder / 'metrics.py'}:{name}" for name in ("seconds_there", "always_there")]
    asked = {"episodes": 2, "quick": True, "physics": "compiled", "metrics": [*metrics, "spl"]}
    report = pedzoo.evaluate("go_to_goal", ["door", f"{folder / 'all.py'}:All"], **asked, folds="embedded")
    ours, walked, real, _ = (row["metrics"] for row in report["rows"])
    assert ours.keys() >= {"seconds_there", "always_there"}
    assert real["seconds_there"] > 0 < walked["seconds_there"]
    assert "always_there" not in real  # people come and go there
    assert report["summary"][0]["metrics"]["seconds_there"] == ours["seconds_there"]
    again = pedzoo.evaluate(["go_to_goal", "constant_velocity"], "door", **asked, workers=2)
    assert again["rows"][0]["metrics"] == ours and "seconds_there" in again["rows"][1]["metrics"]
    shown = Evaluation("go_to_goal", ["door"], EvaluationOptions(metrics=tuple(asked["metrics"]))).shown
    assert shown["door"].columns[-3:] == ["spl", "seconds_there", "always_there"]


def test_metrics_that_are_refused(folder: Path) -> None:
    file = folder / "metrics.py"
    with pytest.raises(UserError, match="there is a metric 'success' already"):
        pedzoo.evaluate("go_to_goal", "door", metrics=[f"{file}:success"])
    with pytest.raises(UserError, match="did you mean 'always_there'"):
        pedzoo.evaluate("go_to_goal", "door", metrics=f"{file}:always_their")
    with pytest.raises(UserError, match="unknown metric 'sucess': did you mean 'success'"):
        pedzoo.evaluate("go_to_goal", "door", metrics=["sucess"])
    walked, _ = pedzoo.rollout("go_to_goal", "door", "compiled", 2)
    values, _ = pedzoo.measure(walked, [f"{file}:seconds_there"])
    assert values["seconds_there"] > 0 and values["failed"] == 0
    said = r"of_people: expected two tensors \(sum, count\) of shape \(2,\), .* got \(a tensor of shape"
    for name, message in (
        ("of_people", said),
        ("with_count", r"with_count: expected two tensors .* got \(a tensor .*, a tensor .*, "),
        ("below_0", "a count is below 0"),
        ("more_than_all", "a share is outside 0 to 1"),
    ):
        with pytest.raises(UserError, match=message):
            closed_loop(walked, [f"{file}:{name}"])


def test_every_shipped_metric_says_what_it_is_without_an_import() -> None:
    """The registry reads the files alone."""
    assert {*NAMES} == {*registry.METRICS.names()} and len(NAMES) > 30
    assert all(len(registry.METRICS.describe(name).split()) > 2 for name in NAMES)
