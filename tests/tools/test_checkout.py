"""Tools of a checkout: absent from a wheel; dependencies of the checks, killed trainings, walks."""

import re
import tomllib

import pytest
import torch
import yaml

from pedzoo.cli.commands import delegated
from pedzoo.cli.main import overview
from pedzoo.core.configs import load_config
from pedzoo.core.errors import EXTRAS
from pedzoo.core.paths import CARD, config_names, shipped, weight_files
from pedzoo.core.registry import ROOT, SUITES, Registry
from pedzoo.eval.cards import about
from pedzoo.models.zoo.card import read_card
from tools import kills
from tools.kills import difference
from tools.walks import plan_to_input, track_to_loss


@pytest.mark.parametrize("words", [["bench", "loop"], ["bench", "--help"], ["reproduce", "table1"]])
def test_a_wheel_says_how_to_get_a_checkout(words: list[str], tmp_path, monkeypatch, refused) -> None:
    monkeypatch.setattr(delegated, "folder_of", lambda name: tmp_path / "tools")
    line = refused(*words)
    assert line.startswith(f"pedzoo: {words[0]}: needs a checkout") and "run tools/setup" in line


def test_a_checkout_has_more_commands_and_suites() -> None:
    assert "pedzoo bench policies" in overview() and "pedzoo reproduce table2" in overview()
    assert {"door", "table2"} <= set(SUITES.names())
    assert SUITES.describe("table2").startswith("Table II")
    assert SUITES.get("table2").__module__ == "tools.paper.suites"
    assert SUITES.get("door").__module__ == "pedzoo.eval.suites.scenes"
    nowhere = Registry("suite", "pedzoo.eval.suites", "tools.nowhere")
    assert "replay" in nowhere.names() and "table2" not in nowhere.names()


def test_cards_name_no_suite_of_a_checkout() -> None:
    package = {*Registry("suite", "pedzoo.eval.suites", "pedzoo.eval.suites.scenes").names()}
    for name in weight_files():
        for report in read_card(shipped("checkpoints") / name / CARD).evaluations:
            suites = report["protocol"].get("suites", [])
            assert package >= set(suites), f"{name}: {about(report['protocol'])}"


# Kills


def test_every_trainer_is_killed() -> None:
    def trainer(config: str) -> str:
        return load_config(config)["model"]["class_path"]

    killed = {words[words.index("--config") + 1] for words in kills.TRAININGS.values()}
    assert {*map(trainer, killed)} == {*map(trainer, config_names())}


def test_what_a_kill_has_changed_is_told(tmp_path) -> None:
    runs = tmp_path / "one", tmp_path / "two"
    for run in runs:
        (run / "checkpoints").mkdir(parents=True)
        torch.save({"state_dict": {"w": torch.ones(2)}}, run / "checkpoints" / "last.ckpt")
        (run / "metrics.csv").write_text("epoch,loss\n0,1\n")
    assert difference(*runs) == ""
    (runs[1] / "metrics.csv").write_text("epoch,loss\n0,1\n0,1\n")
    assert difference(*runs) == "metrics.csv"
    (runs[0] / "metrics.csv").write_text("epoch,samples_per_s\n0,7\n")
    (runs[1] / "metrics.csv").write_text("epoch,samples_per_s\n0,8\n")
    assert difference(*runs) == ""
    torch.save({"state_dict": {"w": torch.tensor([1, 1.0000001])}}, runs[1] / "checkpoints" / "last.ckpt")
    assert difference(*runs) == "weights ['w']"


# One version of each dependency, every file by its sha256


def name_of(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement)[0].lower().replace("_", "-")


def locked() -> dict[str, tuple[str, int]]:
    """Return the version of each locked package, and how many hashes it has."""
    text = (ROOT / "requirements-ci.txt").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return {
        name_of(line): (re.split(r"==| ", line)[1], len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", line)))
        for line in lines
    }


def test_every_file_that_the_checks_install_has_a_hash() -> None:
    packages = locked()
    assert len(packages) > 100 and "torch" not in packages
    assert all(hashes > 0 for _, hashes in packages.values())
    setup = (ROOT / "tools" / "setup").read_text()
    assert "--no-deps --require-hashes --requirement requirements-ci.txt" in setup


def test_the_lock_has_the_versions_of_the_constraints() -> None:
    """``tools/lock`` makes them agree. torch has many builds of one version, and no hash."""
    packages, lines = locked(), (ROOT / "constraints.txt").read_text().splitlines()
    versions = {name_of(line): line.partition("==")[2] for line in lines if not line.startswith("#")}
    assert versions.pop("torch")
    assert {name: packages[name][0] for name in versions} == versions


def test_an_installation_brings_what_pedzoo_is_named_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = (ROOT / "requirements-small.txt").read_text().splitlines()
    small, wanted = [line for line in lines if not line.startswith("#")], project["dependencies"]
    named = {"torch", "lightning", "torchrl", "tensordict", "opencv-python-headless", "wandb", "pybullet"}
    assert named <= {name_of(one) for one in wanted}
    left_out = {"lightning", "wandb", "pybullet"}
    assert small == [one for one in wanted if name_of(one) not in left_out]
    for extra, name in (("train", "lightning"), ("wandb", "wandb"), ("bullet", "pybullet")):
        (again,) = project["optional-dependencies"][extra]
        assert name_of(again) == name and again.split(";")[0] in {one.split(";")[0] for one in wanted}


def test_the_citation_names_the_works_that_models_come_from() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["cff-version"] == "1.2.0" and cited["title"] and cited["message"] and cited["authors"]
    titles = [one["title"] for one in cited["references"]]
    for start in (
        "Interactive Pedestrian Simulation in iGibson",
        "Social GAN:",
        "Social-VRNN:",
        "ImageNet Class",
    ):
        assert sum(title.startswith(start) for title in titles) == 1
    assert all(one["type"] and one["authors"] for one in cited["references"])


def test_the_lock_has_all_dependencies_and_all_is_every_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(one for extra in extras.values() for one in extra)]
    assert {name_of(one) for one in wanted} - {"torch", "pedzoo"} <= locked().keys()
    (every,) = extras["all"]
    assert set(re.split(r"[\[\],]", every)[1:-1]) == set(EXTRAS) == extras.keys() - {"all", "dev"}
    assert extras["dev"][0] == "pedzoo[all]"


def test_ways_through_the_code_can_be_walked() -> None:
    for walk, first in ((track_to_loss, "data/datamodule.py"), (plan_to_input, "maps/plans.py")):
        trace = walk()
        assert next(iter(trace.files)) == first
        assert 2 < len(trace.files) < 60 and trace.changes >= 1
