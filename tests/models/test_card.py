"""Model cards: what is written comes back, what is refused, and how a run becomes weights and a card."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from helpers.batches import make_batch
from helpers.model_cards import make_card
from helpers.runs import PROTOCOL, make_run
from msgspec.structs import asdict

from pedzoo.core.errors import UserError
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import provenance
from pedzoo.models.zoo.card import read_card, write_card
from pedzoo.models.zoo.card_page import page
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.publish import options_of, publish, zoo_name


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
def test_what_is_no_card_is_refused_and_nothing_in_it_runs(text, message, elsewhere):
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


# From a run to weights with their card


def test_the_card_says_what_the_run_recorded(tmp_path):
    checkpoint = make_run(tmp_path / "runs")
    command = ["pedzoo", "fit", "--config", "sgan_goal", "--seed_everything", "0", "--data.fold=zara1"]
    path = publish(checkpoint, tmp_path / "zoo")
    assert path == tmp_path / "zoo" / "sgan_goal.zara1" / "card.yaml"
    card, weights = read_card(path), path.with_name("weights.safetensors")
    assert card.name == "sgan_goal.zara1" and card.file == weights.name
    assert card.sha256 == hashlib.sha256(weights.read_bytes()).hexdigest()
    assert card.size == weights.stat().st_size
    assert card.training == {
        "config": "sgan_goal",
        "fold": "zara1",
        "clock": "benchmark",
        "goal": "window_end",
        "seed": 0,
        "seeds": {0: 0.2},
        "chosen_by": "val/ade",
        "value": 0.2,
        "step": 60,
        "epoch": 5,
        "command": [*command, "--model.lr=0.001", "--rollout.scenarios", "null"],
        "overrides": {"model.lr": "0.001"},
    }
    assert card.config["protocol"] == PROTOCOL and card.config["init"]["goal_dim"] == 4
    assert card.config["training"] == {
        "config": "sgan_goal", "fold": "zara1", "seed": 0, "chosen_by": "val/ade"
    }  # fmt: skip
    assert card.versions == {"torch": "2.13.0"} and card.evaluations == []
    batch, noise = make_batch((3, 2)), torch.Generator()
    one, other = (load(file).sample(batch, 2, 8, noise.manual_seed(0)) for file in (checkpoint, weights))
    assert torch.equal(one, other)


def test_all_seeds_of_the_same_training_are_on_the_card(tmp_path):
    runs = tmp_path / "runs"
    make_run(runs, 0, (0.3, 0.25))
    checkpoint = make_run(runs, 1, (0.3, 0.2))
    make_run(runs, 2, (0.1,))  # not finished
    make_run(runs, 3, (0.1, 0.1), model={"lr": 0.002})  # another training
    make_run(runs, 4, (0.22, 0.3), rollout={"scenarios": None})
    (runs / "sgan_goal" / "zara1-seed5").mkdir()  # just begun
    card = read_card(publish(checkpoint, tmp_path / "zoo"))
    assert card.training["seeds"] == {0: 0.25, 1: 0.2, 4: 0.22}
    assert card.training["seed"] == 1 and card.training["value"] == 0.2


def test_a_resumed_run_keeps_how_it_began(tmp_path):
    checkpoint = make_run(tmp_path / "runs", 0, (0.15, 0.2, 0.18))
    run = checkpoint.parents[1]
    (run / "before-resume-1").mkdir()
    lines = (run / "metrics.csv").read_text().splitlines()
    (run / "before-resume-1" / "metrics.csv").write_text("\n".join(lines[:3]))
    (run / "metrics.csv").write_text("\n".join([lines[0], *lines[3:]]))
    (run / "versions.json").rename(run / "before-resume-1" / "versions.json")
    again = {"command": ["pedzoo", "fit", "--resume", "runs/x"], "versions": {"torch": "2.14.0"}}
    (run / "versions.json").write_text(json.dumps(again))
    card = read_card(publish(checkpoint, tmp_path / "zoo"))
    assert card.training["seeds"] == {0: 0.15} and card.training["value"] == 0.18
    assert card.training["command"][:4] == ["pedzoo", "fit", "--config", "sgan_goal"]
    assert card.versions == {"torch": "2.14.0"}


def test_a_run_that_began_with_other_weights_saw_what_they_saw(tmp_path):
    base = publish(make_run(tmp_path / "base"), tmp_path / "zoo")
    embedded = {"fold": "embedded", "files": None}
    for began in (str(base.parent), str(tmp_path / "base/sgan_goal/zara1-seed0/checkpoints/best.ckpt")):
        checkpoint = make_run(tmp_path / f"runs{len(began)}", weights=began, data=embedded)
        content = torch.load(checkpoint, weights_only=True)
        content["pedzoo"]["protocol"] = PROTOCOL | {"fold": "embedded"}
        torch.save(content, checkpoint)
        data = read_card(publish(checkpoint, tmp_path / "tuned")).data
        assert data["recordings"] == sorted([*provenance("zara1")["recordings"], "plaza_train"])
        assert "Pellegrini" in data["citation"] and "synthetic" in data["source"]
    checkpoint = make_run(tmp_path / "lost", weights="gone/sgan.zara1", data=embedded)
    with pytest.raises(
        UserError, match=r"began with 'gone/sgan\.zara1', and the card has to say what they saw"
    ):
        publish(checkpoint, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_shipped_configs_file_is_called_by_its_name(tmp_path):
    checkpoint = make_run(tmp_path / "runs")
    file = checkpoint.parents[1] / "versions.json"
    record = json.loads(file.read_text())
    record["command"][3] = "/elsewhere/configs/sgan_goal.yaml"
    file.write_text(json.dumps(record))
    command = read_card(publish(checkpoint, tmp_path / "zoo")).training["command"]
    assert command[2:4] == ["--config", "sgan_goal"]


def test_measurements_stay_as_long_as_the_weights_are_the_same(tmp_path):
    checkpoint, measured = make_run(tmp_path / "runs"), make_card().evaluations
    path = publish(checkpoint, tmp_path, measured=measured)
    again = publish(checkpoint, tmp_path / "b", measured=measured)
    for name in ("card.yaml", "weights.safetensors"):
        assert path.with_name(name).read_bytes() == again.with_name(name).read_bytes()
    assert read_card(publish(checkpoint, tmp_path)).evaluations == measured
    assert read_card(publish(checkpoint, tmp_path, measured=[])).evaluations == []
    publish(checkpoint, tmp_path, measured=measured)
    other = make_run(tmp_path / "runs", 1)
    assert publish(other, tmp_path) == path and read_card(path).evaluations == []


def test_what_cannot_be_published_is_refused_and_leaves_nothing(tmp_path):
    checkpoint = make_run(tmp_path / "runs")
    with pytest.raises(UserError, match=r"'a/b\.c': expected ARCHITECTURE\.TAG"):
        publish(checkpoint, tmp_path / "zoo", name="a/b.c")
    alone = tmp_path / "alone" / "best.ckpt"
    alone.parent.mkdir()
    alone.write_bytes(checkpoint.read_bytes())
    with pytest.raises(
        UserError, match=r"not in the folder of its run: .* has no config\.yaml and no metrics"
    ):
        publish(alone, tmp_path / "zoo")
    (there := tmp_path / "there" / "sgan_goal.zara1").mkdir(parents=True)
    (there / "card.yaml").write_text("name: [")
    with pytest.raises(UserError, match=r"model card .* cannot be read"):
        publish(checkpoint, tmp_path / "there", name="sgan_goal.zara1")
    assert not list(there.glob("*.safetensors"))
    content = torch.load(checkpoint, weights_only=True)
    content["pedzoo"]["architecture"] = "own.py:Mine"
    torch.save(content, checkpoint)
    with pytest.raises(UserError, match="never make a file of code run"):
        publish(checkpoint, tmp_path / "zoo")
    assert not (tmp_path / "zoo").exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("config.yaml", b"\xff\xfe"),
        ("config.yaml", b"{}"),
        ("versions.json", b"{"),
        ("metrics.csv", b"epoch,val/ade\nx,y\n"),
    ],
)
def test_damaged_records_of_a_run_are_told(name, content, tmp_path):
    checkpoint = make_run(tmp_path / "runs")
    (checkpoint.parents[1] / name).write_bytes(content)
    with pytest.raises(UserError, match=r"records of the run .* are damaged|config\.yaml"):
        publish(checkpoint, tmp_path / "zoo")
    assert not (tmp_path / "zoo").exists()


@pytest.mark.parametrize(
    ("config", "changed", "name"),
    [
        ("sgan_goal", {}, "sgan_goal.zara1"),
        ("sgan_goal", {"goal": "destination"}, "sgan_goal.zara1_destination"),
        ("sgan_goal_destination", {"goal": "destination"}, "sgan_goal.zara1_destination"),
        ("sgan_goal", {"pred_len": 12, "goal": "none"}, "sgan_goal.zara1_pred12"),
        ("sgan_goal", {"clock": "true"}, "sgan_goal.zara1_true"),
        ("sgan_goal", {"fold": "eth_ucy", "clock": "true"}, "sgan_goal.eth_ucy"),
        ("sgan_goal", {"fold": "eth_ucy"}, "sgan_goal.eth_ucy_benchmark"),
        *(
            (config, {"fold": fold, "clock": clock}, f"{name}{'' if clock == 'true' else '_benchmark'}")
            for config, fold, name in (
                ("open_loop/approach_net_goal_map", "eth_ucy", "approach_net_goal_map.controller_open"),
                ("open_loop/approach_net_goal_map", "zara1", "approach_net_goal_map.controller_open_zara1"),
                ("closed_loop/approach_net_goal_map", "eth_ucy", "approach_net_goal_map.indoor"),
                ("closed_loop/approach_net_goal", "hotel", "approach_net_goal.indoor_hotel"),
                ("closed_loop/social_walker", "zara1", "social_walker.zara1"),
                ("closed_loop/social_walker_styled", "zara1", "social_walker.styled_zara1"),
                ("closed_loop/social_walker_styled", "eth_ucy", "social_walker.styled"),
            )
            for clock in ("true", "benchmark")
        ),
        ("open_loop/mdn_walker", {"fold": "mixed"}, "mdn_walker.likelihood"),
        ("open_loop/mdn_walker", {"fold": "mixed_halls"}, "mdn_walker.likelihood_halls"),
        ("closed_loop/mdn_walker", {"fold": "mixed"}, "mdn_walker.mixed"),
        ("closed_loop/mdn_walker", {"fold": "mixed_zara1"}, "mdn_walker.zara1"),
    ],
)
def test_names_say_what_was_not_seen_and_what_is_unusual(config, changed, name):
    assert zoo_name(config, PROTOCOL | changed) == name


def test_options_are_read_as_they_were_typed():
    command = ["pedzoo", "fit", "-c", "sgan", "--a=1", "--b", "-2", "--flag", "--d", "x", "y"]
    assert [(option.key, option.value) for option in options_of(command)] == [
        ("config", "sgan"), ("a", "1"), ("b", "-2"), ("flag", "true"), ("d", "x y")
    ]  # fmt: skip


def test_recordings_on_cards_are_those_of_the_folds(shared):
    for fold in ("eth", "hotel", "univ", "zara1", "zara2", "eth_ucy"):
        lists = EthUcy(fold, str(shared / "data")).lists
        folds = lists if fold == "eth_ucy" else [fold]
        files = {Path(file).stem for one in folds for file in lists[one]["train"]}
        said = provenance(fold)["recordings"]
        assert said == sorted(name.removesuffix("_train") for name in files), fold
    assert "CC BY-NC" in provenance("zara1", plans=True)["terms"]
    assert provenance(None, ["data/mall.csv"])["recordings"] == ["mall.csv"]
    assert "synthetic" in provenance("embedded")["source"]
