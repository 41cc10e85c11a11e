"""Every shipped config trains, on the embedded recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from pedzoo.cli.main import main
from pedzoo.paths import config_names


@pytest.mark.parametrize("name", config_names())
def test_config_trains(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if "alexnet" in name:
        request.getfixturevalue("alexnet")
    options = {"data.fold": "embedded", "runs": str(tmp_path), "trainer.enable_progress_bar": "false"}
    options |= {"trainer.max_epochs": "1", "trainer.check_val_every_n_epoch": "1"}
    options |= {"trainer.limit_train_batches": "2", "trainer.limit_val_batches": "1", "rollout.episodes": "1"}
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    assert main(["fit", "--config", name, *words]) == 0
    (run,) = (tmp_path / name).iterdir()
    assert (run / "checkpoints" / "best.ckpt").is_file()
    logged = (run / "metrics.csv").read_text().splitlines()[0]
    assert "val/ade" in logged
    # who has a goal walks
    assert ("rollout/door/success" in logged) == name.startswith("sgan_goal")
