"""The page of robots trained among some people and tested among others."""

from typing import Any

from pedzoo.cli.main import main
from tools.paper import suites
from tools.paper.robots import COLUMNS, RobotTransfer, grouped, transfer_pages
from tools.paper.suites import PLACES, REACTING, RECORDED
from tools.zoo.robots import PEOPLE


def row(name: str, place: str, people: str, success: float) -> dict[str, Any]:
    metrics = {"success": success, "collision_person": 1 - success, "stl": success, "delay_s": 0.0}
    return {"name": name, "case": {"place": place, "people": people}, "metrics": metrics}


def test_seeds_count_as_one_robot_and_places_weigh_the_same() -> None:
    rows = []
    for name, success in (("robot_ppo.orca", 0.9), ("robot_ppo.orca-seed1", 0.7), ("straight", 0.6)):
        rows += [row(name, place, kind, success) for place in PLACES for kind in PEOPLE]
        rows += [row(name, place, REACTING, success - 0.5) for place in RECORDED]
    rows.append(row("stop", "rooms", "orca", 0.0))  # not tested everywhere: left out
    groups = grouped(rows)
    assert list(groups) == ["robot_ppo.orca", "straight"] and set(groups["straight"]) == set(COLUMNS)
    answer, success, *_ = transfer_pages(rows)
    best, worst = answer.rows
    # three places at .9 and two at .4: .7; of the second training .5
    assert best[:3] == ["robot_ppo.orca", "0.600 [0.500, 0.700]", "0.400 [0.300, 0.500]"]
    assert worst[0] == "straight" and worst[1] == "0.400" and worst[3:] == ["0.60"] * 3 + ["0.10"] * 2
    assert success.rows[0][1] == "0.80 [0.70, 0.90]" and success.rows[0][-1] == "0.30 [0.20, 0.40]"


def test_the_command_makes_page_report_and_picture(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(suites, "PEOPLE", {"orca": "orca", "sgan": "orca"})
    monkeypatch.setattr("tools.paper.robots.COLUMNS", (("doors", "orca"), ("reacting", "sgan")))
    monkeypatch.setattr("tools.paper.robots.PLACES", {"doors": PLACES["doors"]})
    monkeypatch.setattr("tools.paper.robots.RECORDED", {"reacting": RECORDED["reacting"]})
    monkeypatch.setattr(suites, "PLACES", {"doors": ("doors", "door:people=2", 1.0)})
    recorded = ("recorded", "replay:fold=embedded,simulated=around,share=0.02", 1.0)
    monkeypatch.setattr(suites, "RECORDED", {"reacting": recorded})
    monkeypatch.setattr(suites, "FOLD", "embedded")
    monkeypatch.setattr(RobotTransfer, "baselines", ("straight",))
    out = ["--out", str(tmp_path), "--episodes", "1"]
    assert main(["reproduce", "robots", "--models", "robot_ppo.circle", *out]) == 0
    page = (tmp_path / "ROBOTS.md").read_text()
    assert "| robot_ppo.circle |" in page and "| straight |" in page and "ROBOTS.png" in page
    assert (tmp_path / "ROBOTS.json").is_file() and (tmp_path / "ROBOTS.png").stat().st_size > 10_000
