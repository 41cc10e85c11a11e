"""The page of results: it needs nothing else, and runs nothing that came with the results."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.sim.drawing import FACE, FACE_AHEAD, HAIR, HEAD, SHOULDERS, SKIN
from pedzoo.viz.report import better, content_of, framed, page, shorten

NAUGHTY = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u2028&amp;"


def row(name: str, case: dict[str, str] | None = None, **metrics: float) -> dict[str, Any]:
    return {"name": name, "case": case or {}, "n": 3, "metrics": metrics, "ci95": {"success": [0.2, 0.9]}}


def written(folder: Path, rows: list[dict[str, Any]], **more: Any) -> Path:
    file = folder / "results.json"
    file.write_text(json.dumps({"command": "rollout", "rows": rows, **more}))
    return file


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def tags_of(text: str) -> list[tuple[str, dict[str, str | None]]]:
    """Return the tags of a page, as a browser reads them."""
    tags: list[tuple[str, dict[str, str | None]]] = []
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attrs: tags.append((tag, dict(attrs)))
    parser.feed(text)
    return tags


def test_names_from_files_stay_text(tmp_path) -> None:
    file = written(tmp_path, [row(NAUGHTY, success=0.5)], protocol={"scenario": NAUGHTY}, notes=[NAUGHTY])
    text = page(content_of([file]), NAUGHTY)
    assert [tag for tag, _ in tags_of(text)].count("script") == 2
    assert not any(tag == "img" or "onerror" in given for tag, given in tags_of(text))
    data = data_of(text)
    assert data["tables"][0]["tables"][0]["rows"][0]["name"] == NAUGHTY and data["notes"] == [NAUGHTY]
    inside = framed(content_of([file]), NAUGHTY)
    (frame,) = tags_of(inside)
    assert frame[0] == "iframe" and frame[1]["sandbox"] == "allow-scripts"


def test_the_page_needs_nothing_and_runs_its_own_script(tmp_path) -> None:
    text = page(content_of([written(tmp_path, [row("orca", success=0.5)])]))
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", text)
    tags = tags_of(text)
    assert not any("src" in given or given.get("rel") == "stylesheet" for _, given in tags)
    (policy,) = [given["content"] for tag, given in tags if given.get("http-equiv")]
    script = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)[0]
    known = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy and policy.startswith("default-src 'none'") and f"script-src 'sha256-{known}'" in policy
    assert "unsafe" not in policy and "connect-src" not in policy


def test_tables_have_the_mean_and_every_case(tmp_path) -> None:
    rows = [
        {**row(name, {"suite": "goals", "physics": "torch", "people": people}, success=value), "table": "g"}
        for name, people, value in (("orca", "2", 0.5), ("orca", "3", 0.7), ("real", "2", 1.0))
    ]
    mean = {**row("orca", success=0.6), "table": "g"}
    content = content_of([written(tmp_path, rows, summary=[mean])])
    (group,) = content["tables"]
    assert [table["title"] for table in group["tables"]] == ["mean of 2 cases", "2", "3"]
    assert group["tables"][0]["rows"][0]["cells"] == {"success": [0.6, 0.2, 0.9]}
    assert [one["reference"] for one in group["tables"][1]["rows"]] == [False, True]


@pytest.mark.parametrize(
    ("direction", "metrics"),
    [
        (1, "success contact_free stl agent_steps_per_s"),
        (-1, "agent_contacts_per_min realism closed_loop_ade_m min_ade_20_scene_m time_ratio_median"),
        (0, "speed_m_per_s headway_p50_s"),
    ],
)
def test_which_way_is_better(direction: int, metrics: str) -> None:
    assert {better(metric) for metric in metrics.split()} == {direction}


def test_trainings_are_curves(tmp_path) -> None:
    run = tmp_path / "sgan" / "zara1-seed0"
    run.mkdir(parents=True)
    (run / "metrics.csv").write_text("epoch,step,train/loss,val/ade\n0,1,4,\n0,2,2,\n0,2,,0.5\n1,4,1,0.25\n")
    (chart,) = content_of([tmp_path])["charts"]
    lines = {panel["title"]: panel["lines"] for panel in chart["panels"]}
    assert lines["train/loss"] == [{"name": "sgan/zara1-seed0", "x": [0, 1], "y": [3.0, 1.0]}]
    assert lines["val/ade"][0]["y"] == [0.5, 0.25]


def test_pages_stay_small() -> None:
    def policy(name: str) -> dict[str, Any]:
        return {"name": name, "episodes": [{"plan": str(i), "xy": "A" * 1000} for i in range(10)]}

    plans = {str(i): {} for i in range(10)}
    content = {"cases": [{"name": "a", "policies": [policy("b"), policy("c")]}], "plans": plans, "notes": []}
    shorten(content, 7000)
    assert [len(one["episodes"]) for one in content["cases"][0]["policies"]] == [3, 3]
    assert sorted(content["plans"]) == ["0", "1", "2"]
    assert content["notes"] == [
        "Only the first 3 of 10 episodes are here: the page would be too large with more."
    ]


def test_what_is_no_result_is_refused(tmp_path) -> None:
    (tmp_path / "text.json").write_text("{")
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "empty").mkdir()
    kinds = "pedzoo evaluate, rollout, forecast, score or bench wrote"
    for name, message in (
        ("none.json", "cannot read"),
        ("text.json", f"is no JSON: expected JSON that {kinds}"),
        ("list.json", "has no rows with name and metrics"),
        ("empty", "no training in"),
    ):
        with pytest.raises(UserError, match=message):
            content_of([tmp_path / name])


def test_the_command_and_a_rollout_write_pages(tmp_path, capsys) -> None:
    words = "rollout go_to_goal --physics compiled --episodes 2 --metrics success --keep_episodes 2"
    files = ["--html", str(tmp_path / "a.html"), "--json", str(tmp_path / "a.json")]
    assert main([*words.split(), *files]) == 0
    assert main(["report", str(tmp_path / "a.json"), "-o", str(tmp_path / "b.html")]) == 0
    assert "2 replays" in capsys.readouterr().out
    (mine,), (other,) = (data_of((tmp_path / name).read_text())["cases"] for name in ("a.html", "b.html"))
    assert mine["policies"] == other["policies"] and len(mine["policies"][0]["episodes"]) == 2


def test_an_episode_shows_itself_in_a_notebook(tmp_path) -> None:
    shown = pedzoo.rollout("go_to_goal", "door", "compiled", 1, seed=4)
    assert repr(shown) == "ShownRollout('go_to_goal': 1 episodes)"
    page_of_cell = shown._repr_html_()
    assert page_of_cell.startswith("<iframe srcdoc=") and "seed 4" in page_of_cell
    walked, env = shown
    assert len(walked.failed) == 1 and env.policy_name == "go_to_goal"
    shown.save(tmp_path / "door.html")
    assert len(data_of((tmp_path / "door.html").read_text())["cases"]) == 1


def test_people_look_as_in_all_other_pictures() -> None:
    script = page({})
    assert "BODY = 0.15;" in script
    along, across = SHOULDERS
    sizes = f"along: {along}, across: {across}, head: {HEAD}, face: {FACE}, ahead: {FACE_AHEAD}"
    assert f"FIGURE = {{ {sizes} }}" in script
    for name, color in (("SKIN", SKIN), ("HAIR", HAIR)):
        assert f'{name} = "rgb({",".join(map(str, color))})"' in script
