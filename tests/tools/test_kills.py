"""What kills are measured by, and whom they meet."""

from __future__ import annotations

from pathlib import Path

import torch

from pedzoo.core.configs import load_config
from pedzoo.core.paths import config_names
from tools import kills
from tools.kills import difference


def test_every_trainer_is_killed() -> None:
    def trainer(config: str) -> str:
        return load_config(config)["model"]["class_path"]

    killed = {words[words.index("--config") + 1] for words in kills.TRAININGS.values()}
    assert {*map(trainer, killed)} == {*map(trainer, config_names())}


def test_what_a_kill_has_changed_is_told(tmp_path: Path) -> None:
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
