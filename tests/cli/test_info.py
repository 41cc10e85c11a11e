"""``pedzoo info`` and ``pedzoo models``: what cards say, for people and for machines."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.model_cards import make_card

from pedzoo.cli.main import main
from pedzoo.models.zoo.card import write_card
from pedzoo.models.zoo.card_page import page
from pedzoo.models.zoo.store import names


@pytest.fixture(autouse=True)
def zoo(elsewhere, monkeypatch) -> Path:
    """A folder of the user's with one card, and an empty cache."""
    monkeypatch.setenv("PEDZOO_HOME", str(elsewhere / "home"))
    monkeypatch.setenv("PEDZOO_ZOO", str(elsewhere / "zoo"))
    write_card(make_card("sgan_goal.mall"), elsewhere / "zoo" / "sgan_goal.mall" / "card.yaml")
    return elsewhere / "zoo"


def rows(pattern: str) -> list[dict[str, Any]]:
    assert main(["models", pattern, "--json", "models.json"]) == 0
    return json.loads(Path("models.json").read_text())["weights"]


def test_info_shows_the_whole_card_and_writes_it(capsys) -> None:
    assert main(["info", "sgan_goal.mall"]) == 0
    text = capsys.readouterr().out
    for part in (
        make_card().sha256,
        "pedzoo fit --config sgan_goal",
        "0: 0.0612, 1: 0.0605",
        "for research",
        "forecast: fold zara1, goal window_end, pred_len 8, samples 20; seeds 0",
        "it leaks the answer's last position",
        "evaluate: suites door goals, quick, warm_start door orca; seeds 0",
        "0.975 [0.871, 0.996]",
    ):
        assert part in text
    assert "not recorded" not in text and "None" not in text

    assert main(["info", "zoo", "--json", "a.json", "--markdown", "a.md"]) == 0
    assert capsys.readouterr().out == ""
    card = make_card("sgan_goal.mall")
    written = json.loads(Path("a.json").read_text())
    assert written["command"] == "info" and written["card"]["evaluations"] == card.evaluations
    assert Path("a.md").read_text() == page(card)
    assert main(["info", "zoo/sgan_goal.mall", "--markdown", "-"]) == 0
    assert capsys.readouterr().out == page(card)


def test_text_of_a_card_gives_the_terminal_no_orders(zoo: Path, capsys) -> None:
    evaluations = make_card().evaluations
    evaluations[1]["rows"][0]["table"] = "[/red]"
    card = make_card("sgan_goal.mall", licence="[bold]MIT[/nothing]", evaluations=evaluations)
    write_card(card, zoo / "sgan_goal.mall" / "card.yaml")
    assert main(["info", "sgan_goal.mall"]) == 0
    text = capsys.readouterr().out
    assert "[bold]MIT[/nothing]" in text and "[/red]" in text


def test_names_that_have_no_card_are_told(refused) -> None:
    assert "did you mean 'sgan_goal.mall'" in refused("info", "sgan_goal.mal")
    assert "unknown model 'sgan_goal'" in refused("info", "sgan_goal")
    message = refused("info", "sgan")
    assert "'sgan' is an architecture" in message and "name its weights: sgan." in message
    message = refused("info", "runs/sgan/checkpoints/best.ckpt")
    assert "cards are asked for by name" in message and "pedzoo export" in message
    assert "is a folder" in refused("info", "zoo", "--json", "zoo")


def test_models_has_a_row_for_every_card_with_its_headline(capsys) -> None:
    result = {row["name"]: row for row in rows("*")}
    assert list(result) == names() and len(result) > 16
    facts = {"name": "sgan_goal.mall", "kB": 192, "fold": "zara1", "goal": "window_end", "clock": "benchmark"}
    numbers = {"steps": 8, "ade_m": 0.0571, "fde_m": 0.0086, "door": 0.975}
    assert result["sgan_goal.mall"] == facts | numbers
    text = capsys.readouterr().out
    assert "0.057" in text and "door" in text and "straight_line" in text
    assert [row["name"] for row in rows("*.mall")] == ["sgan_goal.mall"]
    assert rows("nothing") == [] and "none" in capsys.readouterr().out


def test_one_bad_card_does_not_hide_the_others(zoo: Path, capsys) -> None:
    (zoo / "sgan.bad").mkdir()
    (zoo / "sgan.bad" / "card.yaml").write_text("name: sgan.bad")
    bad, good = rows("*.[bm]a*")
    assert "missing required field `architecture`" in bad["error"] and good["kB"] == 192
    assert "sgan.bad/card.yaml': Object missing required field `architecture`" in capsys.readouterr().out


def test_nothing_heavy_is_imported() -> None:
    code = (
        "import sys; from pedzoo.cli.main import main; main(['models']); main(['info', 'sgan_goal.mall']);"
        "assert not {'torch', 'numpy', 'pandas', 'requests'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
