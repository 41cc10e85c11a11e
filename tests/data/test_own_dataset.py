"""A dataset from any file: its folds, its terms, forecasts, replays and cards, without a line elsewhere."""

import json
from pathlib import Path
from textwrap import dedent

import pytest
from helpers.training import SHORT

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.recordings import find_fold, open_fold, provenance
from pedzoo.eval import cards as card_numbers
from pedzoo.eval.trained_on import has_seen
from pedzoo.models.zoo.card import read_card
from pedzoo.models.zoo.publish import publish, zoo_name

DATASET = '''
    """Two halls of a mall, with the people of pedzoo's plaza."""

    from pedzoo.data.datasets.embedded import Embedded
    from pedzoo.data.recordings import Recording


    class Malls(Embedded):
        """Leave one hall out."""

        FOLDS = {"north": ["hall_north"], "south": ["hall_south"], "halls": []}
        ALWAYS_TRAINED = ["car_park"]
        SOURCE = "a mall"
        TERMS = "ask the mall"
        PLAN_TERMS = "; ask its architect, too"
        CITATION = "Mall et al."

        def __init__(self, fold, root, clock):
            super().__init__()
            self.fold = fold

        def recordings(self, split):
            ours = {"north": "val", "south": "test"}.get(self.fold, "val")
            return super().recordings(ours if split != "train" else "test" if ours == "val" else "val")
'''


@pytest.fixture
def malls(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(dedent(DATASET))
    return f"{file}:Malls"


def test_a_class_in_a_file_says_its_folds_without_being_run(malls):
    first, south, halls = (find_fold(name) for name in (malls, f"{malls}:south", f"{malls}:halls"))
    assert first and south and halls
    assert first.name == "north" and south.tested == ["hall_south"] and halls.whole and not south.whole
    assert provenance(f"{malls}:south", plans=True) == {
        "recordings": ["car_park", "hall_north"],
        "source": "a mall",
        "terms": "ask the mall; ask its architect, too",
        "citation": "Mall et al.",
    }
    assert provenance(f"{malls}:halls")["recordings"] == ["car_park", "hall_north", "hall_south"]
    Path(malls.rpartition(":")[0]).write_text("raise SystemExit\nclass Malls:\n    FOLDS = {'north': []}\n")
    assert provenance(malls)["recordings"] == []


def test_wrong_folds_are_refused(malls, tmp_path):
    with pytest.raises(UserError, match="did you mean 'south'"):
        open_fold(f"{malls}:sout", None, "true")
    with pytest.raises(UserError, match="did you mean 'zara2'"):
        open_fold("zara", None, "true")
    (tmp_path / "computed.py").write_text("class Mine:\n    FOLDS = dict(north=[])\n")
    with pytest.raises(UserError, match="FOLDS is no literal"):
        find_fold(f"{tmp_path / 'computed.py'}:Mine")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("pass", r"Mine has no method recordings\(self, split\), .* return a list of pedzoo.*Recording"),
        ("recordings = lambda self: []", r"expected recordings\(self, split\): too many positional"),
        ("recordings = lambda self, split: None", r"Mine.recordings\('test'\) returned None: it has to"),
        ("recordings = lambda self, split: ['a.csv']", r"returned \['a.csv'\]: it has to return a list"),
        ("recordings = lambda self, split: [Recording('a.csv')]", "it has to return a list"),
        ("def __init__(self): ...\n    recordings = print", r"expected Mine\(fold, root, clock\): too many"),
    ],
)
@pytest.mark.parametrize("base", ["", "(Dataset)"])
def test_what_a_class_lacks_is_said_in_one_line(body, message, base, tmp_path):
    code = f"from pedzoo.data.recordings import Dataset, Recording\n\nclass Mine{base}:\n    "
    code += "" if base or "__init__" in body else "def __init__(self, fold, root, clock): ...\n    "
    (tmp_path / "mine.py").write_text(f"{code}{body}\n")
    with pytest.raises(UserError, match=message) as error:
        open_fold(f"{tmp_path}/mine.py:Mine", None, "true").recordings("test")
    assert "\n" not in str(error.value)


def test_forecasts_and_replays(malls, tmp_path, capsys):
    words = ["forecast", "sgan_goal.zara1", "--data.fold", f"{malls}:north", "--data.goal", "window_end"]
    assert main([*words, "--samples", "2", "--json", str(tmp_path / "out.json")]) == 0
    report = json.loads((tmp_path / "out.json").read_text())
    plaza = [*words[:3], "embedded", *words[4:], "--samples", "2"]
    assert main([*plaza, "--json", str(tmp_path / "plaza.json")]) == 0
    assert report["protocol"]["fold"] == f"{malls}:north" and report["rows"][1]["metrics"]["ade_m"] < 1
    assert report["rows"][1]["n"] != json.loads((tmp_path / "plaza.json").read_text())["rows"][1]["n"]
    walked, _ = pedzoo.rollout("go_to_goal", f"replay:fold={malls}:south", "compiled", 1)
    assert walked.replayed and "replay south: " in capsys.readouterr().out
    rows = pedzoo.evaluate("go_to_goal", "replay", quick=True, folds=[f"{malls}:north"])["rows"]
    assert {row["case"]["fold"] for row in rows} == {"north"} and len(rows) == 6
    words = ["evaluate", "go_to_goal", "--suite", "replay", "--quick", "--data.fold", f"{malls}:north"]
    assert main([*words, "--json", str(tmp_path / "all.json")]) == 0
    again = json.loads((tmp_path / "all.json").read_text())["rows"]
    assert [row["metrics"] for row in again] == [row["metrics"] for row in rows]
    with pytest.raises(UserError, match="folds: no use for them in door"):
        pedzoo.evaluate("go_to_goal", "door", folds=["zara1"])


def test_cards(malls, elsewhere, monkeypatch):
    monkeypatch.setattr(card_numbers, "WALKS", [])
    fit = ["fit", "--config", "sgan_goal", "--data.fold", f"{malls}:south", "--rollout.scenarios", "null"]
    assert main([*fit, *SHORT, "--model.samples=2"]) == 0
    checkpoint = "runs/sgan_goal/south-seed0/checkpoints/best.ckpt"
    measured = card_numbers.measure(checkpoint, "sgan_goal.south")
    card = read_card(publish(checkpoint, "zoo", measured=measured))
    assert card.name == "sgan_goal.south" and card.data["recordings"] == ["car_park", "hall_north"]
    assert card.data["terms"] == "ask the mall" and card.training["fold"] == f"{malls}:south"
    # only a person who names it makes a file of code run, and the checkpoint names this one
    (plaza,) = card.evaluations
    assert plaza["protocol"]["fold"] == "embedded"
    assert has_seen("zoo/sgan_goal.south/weights.safetensors", f"{malls}:north")
    assert not has_seen("zoo/sgan_goal.south/weights.safetensors", f"{malls}:south")
    (plaza,) = card_numbers.again(card, "zoo/sgan_goal.south/weights.safetensors")
    assert plaza.now and plaza.now["rows"][0]["metrics"]["ade_m"] > 0


def test_weights_are_named_after_the_fold(malls):
    protocol = {"goal": "window_end", "pred_len": 8, "clock": "benchmark"}
    assert zoo_name("sgan_goal", protocol | {"fold": f"{malls}:south"}) == "sgan_goal.south"
    whole = protocol | {"fold": f"{malls}:halls", "clock": "true"}
    assert zoo_name("sgan_goal", whole) == "sgan_goal.halls"
