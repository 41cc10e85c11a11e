"""Every shipped config trains, on the embedded recordings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from pedzoo.cli.main import main
from pedzoo.core.paths import config_names, shipped
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.sim.make import make_scenario
from pedzoo.train.fine_tuning import architecture_options


@pytest.mark.parametrize("name", config_names())
def test_config_trains(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if "alexnet" in name:
        request.getfixturevalue("alexnet")
    options = {"data.fold": "embedded", "runs": str(tmp_path), "trainer.enable_progress_bar": "false"}
    options |= {"trainer.max_epochs": "1", "trainer.check_val_every_n_epoch": "1"}
    options |= {"trainer.limit_train_batches": "2", "trainer.limit_val_batches": "1", "rollout.episodes": "1"}
    if "/" in name and not name.startswith("open_loop"):
        options["model.steps"] = "2"
    if name.startswith("closed_loop"):
        options["rollout.scenarios"] = '["hallway"]'  # its own are many, and slow to prepare
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    assert main(["fit", "--config", name, *words]) == 0
    (run,) = (tmp_path / name.replace("/", ".")).iterdir()
    assert (run / "checkpoints" / "best.ckpt").is_file()
    logged = (run / "metrics.csv").read_text().splitlines()[0]
    assert "val/ade" in logged
    # who has a goal walks
    assert ("rollout/success" in logged) == name.rpartition("/")[2].startswith("sgan_goal")


def test_closed_loop_configs_differ_in_what_people_see_alone() -> None:
    """The numbers of two controllers are compared: they were trained alike."""
    one, other = (
        yaml.safe_load((shipped("configs") / "closed_loop" / f"{name}.yaml").read_text())
        for name in ("sgan_goal_map", "sgan_goal")
    )
    plan = {"map": "rings", "map_dim": 24}
    other["model"]["init_args"]["generator"]["init_args"] |= plan
    assert one | {"weights": ""} == other | {"weights": ""}
    assert all(make_scenario(name) for name in one["rollout"]["scenarios"])


@pytest.mark.parametrize("name", ["sgan_goal_map", "sgan_goal"])
def test_a_closed_loop_config_says_what_its_weights_say(name: str) -> None:
    """With these weights on the command line, as releases are made, it is the same training."""
    config = yaml.safe_load((shipped("configs") / "closed_loop" / f"{name}.yaml").read_text())
    told = iter(architecture_options(config["weights"], f"closed_loop/{name}"))
    generator = next(json.loads(next(told)) for option in told if option == "--model.generator")
    written = config["model"]["init_args"]["generator"]
    assert written["class_path"] == generator["class_path"]
    assert written["init_args"] == {key: generator["init_args"][key] for key in written["init_args"]}
    left_out = generator["init_args"].keys() - written["init_args"].keys()
    assert all(generator["init_args"][key] == SGAN().config[key] for key in left_out)
    data = {"people": "complete", "min_people": 2} | config["data"]
    assert {f"--data.{key}={value}" for key, value in data.items()} >= set(told)
