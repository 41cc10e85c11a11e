"""Model cards: what is written comes back, wrong ones are refused with a reason, the page says it all."""

import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.model_cards import make_card
from msgspec.structs import asdict

from pedzoo.core.errors import UserError
from pedzoo.models.zoo.card import read_card, write_card
from pedzoo.models.zoo.card_page import page


def written(path: Path, **changed: Any) -> Path:
    """Write a card whose values need not make sense; ``...`` leaves a key out."""
    values = asdict(make_card()) | changed
    path.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not ...}))
    return path


def measured(row: dict[str, Any] | None = None, **changed: Any) -> dict[str, Any]:
    """Return an evaluation with something else in it, or in its row."""
    report = make_card().evaluations[0] | changed
    return report | {"rows": [report["rows"][0] | (row or {})]}


def test_a_card_is_the_same_when_read_again(tmp_path):
    report = {"command": "x", "protocol": {"lr": 1e-07}, "seeds": [0], "versions": {"a": "1"}, "rows": []}
    for card in (make_card(), make_card(evaluations=[report, report], versions=report["versions"])):
        write_card(card, tmp_path / "new" / "a.yaml")
        assert read_card(tmp_path / "new" / "a.yaml") == card
        write_card(read_card(tmp_path / "new" / "a.yaml"), tmp_path / "b.yaml")
        assert (text := (tmp_path / "b.yaml").read_text()) == (tmp_path / "new" / "a.yaml").read_text()
        assert text.startswith("name: sgan_goal.zara1\narchitecture: sgan\n")
        assert "&" not in text  # no reference to an equal part
    assert os.listdir(tmp_path / "new") == ["a.yaml"]


TRAINING, DATA = make_card().training, make_card().data

WRONG: list[tuple[dict[str, Any], str]] = [
    ({"licence": ...}, "missing required field `licence`"),
    ({"license": "MIT"}, "unknown field `license`"),
    ({"size": "many"}, "size: Expected `int`, got `str`"),
    ({"versions": {"torch": 2}}, r"versions\[...\]: Expected `str`, got `int`"),
    ({"training": TRAINING | {"epoch": 1.5}}, r"training.epoch: Expected `int . null`, got `float`"),
    ({"training": {"config": "sgan"}}, "training: .*missing required field `fold`"),
    ({"url": 3}, r"url: Expected `str . null`, got `int`"),
    ({"url": "file:///etc/passwd"}, "expected an address at http"),
    ({"sha256": "abc"}, "expected 64 digits"),
    ({"name": "../sgan.zara1"}, "expected ARCHITECTURE.TAG"),
    *(
        ({"file": file}, r"file .*: expected weights\.safetensors, beside the card, and no path")
        for file in ("../weights.safetensors", "/etc/weights.safetensors", "weights.safetensors\n", "a.pkl")
    ),
    ({"architecture": "social_vrnn"}, "architecture 'social_vrnn': its config is of 'sgan'"),
    ({"config": {"architecture": "sgan"}}, "config: .*missing required field `init`"),
    ({"config": {"architecture": "sgan", "init": {}, "hook": "x"}}, "config: .*unknown field `hook`"),
    ({"data": DATA | {"licence": "?"}}, "data: .*unknown field `licence`"),
    ({"data": DATA | {"recordings": [["a"]]}}, r"data.recordings\[0\]: Expected `str`"),
    ({"evaluations": [{"rows": []}]}, r"evaluations\[0\]: .*missing required field `command`"),
    ({"evaluations": [measured(command=["a"])]}, r"\[0\].command: Expected `str`, got `array`"),
    ({"evaluations": [measured({"metrics": {"ade_m": "low"}})]}, r"metrics\[...\]: Expected `float`"),
    ({"evaluations": [measured({"ci95": {"ade_m": [1.0]}})]}, "Expected `array` of length 2, got 1"),
]


@pytest.mark.parametrize(("changed", "message"), WRONG)
def test_a_wrong_card_is_refused_with_the_reason(changed, message, tmp_path):
    with pytest.raises(UserError, match=rf"model card .*bad\.yaml': .*{message}"):
        read_card(written(tmp_path / "bad.yaml", **changed))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "Expected `object`, got `null`"),
        ("name: [", "cannot be read"),
        ("name: !!python/object/apply:os.mkdir [trapped]", "cannot be read: could not determine"),
        ("[" * 100_000, "at most 20 levels|maximum nesting depth"),
        ("\x00", "cannot be read"),
    ],
)
def test_what_is_no_card_is_refused_and_nothing_in_it_runs(text, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(text)
    with pytest.raises(UserError, match=message):
        read_card("bad.yaml")
    assert os.listdir() == ["bad.yaml"]
    with pytest.raises(UserError, match="no model card at"):
        read_card("none.yaml")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (".nan", "nan: expected plain values"),
        ("2026-11-21", "expected plain values"),
        ("2026-11-99", "cannot be read: day is out of range"),
        ("!!int many", "cannot be read"),
        ("9" * 5000, "has 5,000 digits, at most 300 are read"),
        ("!!binary aGk=", "expected plain values"),
        ("{1.5: x}", "expected plain values"),
        (r'"\e[2J"', "x1b.*expected no control characters"),
        ("[&b [x, x, x], &c [*b, *b, *b], [*c, *c, *c]]", "expected no references"),
    ],
)
def test_card_refuses_values_that_are_no_json(value, message, tmp_path):
    path = written(tmp_path / "bad.yaml", versions=...)
    path.write_text(f"{path.read_text()}\nversions: {{torch: {value}}}\n")
    with pytest.raises(UserError, match=message):
        read_card(path)


def test_a_file_that_is_far_too_large_is_not_even_parsed(tmp_path):
    (tmp_path / "bad.yaml").write_bytes(b"x" * 3_000_000)
    with pytest.raises(UserError, match="has 3,000,000 bytes, at most 2,000,000 are read"):
        read_card(tmp_path / "bad.yaml")


def test_a_page_says_everything_and_its_tables_hold():
    card = make_card(licence="MIT | or not")
    text = page(card)
    for part in (
        "# sgan_goal.zara1",
        'pedzoo.load("sgan_goal.zara1")',
        card.sha256,
        "192,920 bytes",
        "0: 0.0612, 1: 0.0605",
        "pedzoo fit --config sgan_goal --data.pred_len 8",
        "biwi_eth, biwi_hotel",
        "for research",
        "0.975 [0.871, 0.996]",
        r"MIT \| or not",
    ):
        assert part in text
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) == 8  # two evaluations and six sections
    for lines in blocks:
        assert len({line.replace(r"\|", "").count("|") for line in lines}) == 1
    assert "Not measured yet." in page(make_card(evaluations=[]))
