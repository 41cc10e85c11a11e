"""pedzoo export: weights and card of a run, a folder for the hub, and what is refused."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from helpers.batches import make_batch, random_weights
from helpers.model_cards import make_card, write_model
from helpers.runs import make_run
from msgspec.structs import replace

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.paths import shipped
from pedzoo.data.recordings import licence, provenance, together
from pedzoo.eval import cards as card_numbers
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.card import read_card, write_card
from pedzoo.models.zoo.card_page import page, readme, write_hub
from pedzoo.models.zoo.loading import load


def answers(model: Forecaster) -> torch.Tensor:
    return model.mode(make_batch((3, 2)), 8)


@pytest.fixture
def model(tmp_path) -> str:
    """A folder of models with one in it."""
    measured = make_card("sgan.mall").evaluations
    write_model(random_weights(SGAN()), tmp_path / "zoo", "sgan.mall", evaluations=measured)
    return str(tmp_path / "zoo" / "sgan.mall")


def test_a_run_becomes_weights_and_a_card_with_its_numbers(tmp_path, monkeypatch, capsys):
    asked: list[Any] = []

    def measure(model: str, name: str, root: str | None, progress: Any) -> list[dict[str, Any]]:
        asked.extend((model, name, root))
        return make_card(name).evaluations

    monkeypatch.setattr(card_numbers, "measure", measure)
    checkpoint, folder = str(make_run(tmp_path)), str(tmp_path / "mine")
    options = ["--to", folder, "--data.root", "recordings", "--json", str(tmp_path / "said.json")]
    assert main(["export", checkpoint, "--zoo", *options]) == 0
    assert asked == [checkpoint, "sgan_goal.zara1", "recordings"]
    assert os.listdir(folder) == ["sgan_goal.zara1"]
    assert sorted(os.listdir(f"{folder}/sgan_goal.zara1")) == ["card.yaml", "weights.safetensors"]
    card = read_card(f"{folder}/sgan_goal.zara1/card.yaml")
    assert card.evaluations == make_card().evaluations and card.training["value"] == 0.2
    loaded = f'pedzoo.load("{folder}/sgan_goal.zara1")'
    assert loaded in capsys.readouterr().out
    assert torch.equal(answers(pedzoo.load(f"{folder}/sgan_goal.zara1")), answers(load(checkpoint)))
    said = json.loads((tmp_path / "said.json").read_text())
    files = [f"{folder}/sgan_goal.zara1/{file}" for file in ("weights.safetensors", "card.yaml")]
    assert said["command"] == "export" and said["files"] == files


def test_numbers_are_left_out_where_no_person_wants_them(tmp_path) -> None:
    options = ["--to", str(tmp_path / "zoo"), "--name", "sgan_goal.mall", "--no-evaluation"]
    assert main(["export", str(make_run(tmp_path)), "--zoo", *options]) == 0
    assert read_card(tmp_path / "zoo" / "sgan_goal.mall" / "card.yaml").evaluations == []


def test_a_hub_folder_loads_and_is_written_the_same_again(model: str, tmp_path) -> None:
    hub = tmp_path / "hub"
    assert main(["export", model, "--hub", str(hub)]) == 0
    assert sorted(os.listdir(hub)) == ["LICENSE.md", "README.md", "card.yaml", "weights.safetensors"]
    assert torch.equal(answers(pedzoo.load(hub)), answers(load(model)))
    before = {path.name: path.read_bytes() for path in hub.iterdir()}
    write_hub(str(hub), hub)
    assert {path.name: path.read_bytes() for path in hub.iterdir()} == before
    with pytest.raises(UserError, match=r"holds sgan\.mall already: .* a folder of its own"):
        write_hub("approach_net_goal_map.indoor_zara1", hub)
    assert len(os.listdir(hub)) == 4
    # wherever a card says that its weights can be downloaded, in the folder they lie beside it
    path = Path(model) / "card.yaml"
    card = read_card(path)
    write_card(replace(card, url="https://example.org/sgan.safetensors"), path)
    write_hub(model, tmp_path / "other")
    assert read_card(tmp_path / "other" / "card.yaml") == card


def test_the_front_matter_is_what_the_hub_reads() -> None:
    card = make_card()
    _, front, text = readme(card).split("---\n", 2)
    said = yaml.safe_load(front)
    assert said["license"] == "mit" and said["library_name"] == "pedzoo"
    assert said["model_name"] == "sgan_goal.zara1" and "sgan" in said["tags"]
    (index,) = said["model-index"]
    forecast, door = index["results"]
    assert forecast["task"] == {"type": "trajectory-forecasting"}
    where = {"type": "zara1-test-goal-window-end", "name": "zara1 test, goal window_end"}
    assert forecast["dataset"] == where
    assert forecast["metrics"] == [{"type": "ade_m", "value": 0.0571}, {"type": "fde_m", "value": 0.0086}]
    assert door["task"] == {"type": "closed-loop-simulation"} and door["dataset"]["name"] == "door bullet"
    assert page(card) in text and 'pedzoo.load("hf://OWNER/REPOSITORY")' in text


def test_licences_have_the_names_of_the_hub() -> None:
    own = {"license": "other", "license_name": "ours-for-research", "license_link": "LICENSE.md"}
    for terms, said in {"CC-BY-4.0": {"license": "cc-by-4.0"}, "Ours, for research": own}.items():
        front = yaml.safe_load(readme(make_card(licence=terms, evaluations=[])).split("---\n")[1])
        assert {key: value for key, value in front.items() if "license" in key} == said
        assert "model-index" not in front


def test_shipped_weights_have_the_licence_of_their_data(tmp_path) -> None:
    """MIT are only those that saw no recorded person; masks under CC BY-NC are passed on as what they are."""
    seen = set()
    for file in sorted(shipped("checkpoints").glob("*/card.yaml")):
        card = read_card(file)
        terms = card.data["terms"]
        assert (card.licence == "MIT") == (terms.startswith(("MIT", "simulated"))), card.name
        assert ("CC BY-NC 4.0" in card.licence) == ("CC BY-NC 4.0" in terms), card.name
        if card.licence != "MIT":
            assert card.licence == licence(terms)
            front = yaml.safe_load(readme(card).split("---\n")[1])
            assert front["license"] == "other" and front["license_link"] == "LICENSE.md"
        seen.add(card.licence)
    assert len(seen) == 3
    write_hub("approach_net_goal_map.indoor_zara1", tmp_path / "hub")
    assert "CC BY-NC 4.0" in (text := (tmp_path / "hub" / "LICENSE.md").read_text()) and "Pellegrini" in text
    assert licence(provenance("embedded")["terms"]) == "MIT"
    mixed = together(provenance("embedded"), provenance("zara1", plans=True))
    assert licence(mixed["terms"]) == licence(provenance("zara1", plans=True)["terms"]) != "MIT"
