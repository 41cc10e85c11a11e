"""The picture of success against ADE over trainings."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from pedzoo.core.errors import UserError
from tools.pages.plot_training import plot_training


def make_run(folder: Path, columns: str = "val/ade,rollout/success,rollout/clean,rollout/stl") -> Path:
    """Make the metrics of a run that validated twice; losses have rows of their own."""
    folder.mkdir(parents=True)
    numbers = [[0.1, 0.9, 0.5, 0.4], [0.12, 1.0, 0.95, 0.8]]
    rows = [f"epoch,step,train/people,{columns}"]
    for epoch, result in enumerate(numbers):
        rows += [f"{epoch},{epoch},0.3{',' * (columns.count(',') + 1)}"]
        rows += [f"{epoch},{epoch},,{','.join(map(str, result[: columns.count(',') + 1]))}"]
    (folder / "metrics.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_runs_share_a_picture(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / "runs" / name) for name in ("zara1-seed0", "zara1-seed1")]
    plot_training(runs, tmp_path / "pictures" / "training.png")
    picture = cv2.imread(str(tmp_path / "pictures" / "training.png"))
    assert picture is not None and picture.shape == (506, 1210, 3)
    assert picture.std() > 5


def test_a_run_that_never_walked_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no validation with val/ade and rollout/stl: train with --rollout"):
        plot_training([make_run(tmp_path / "run", "val/ade")], tmp_path / "out.png")
    with pytest.raises(UserError, match=r"expected a run folder with metrics\.csv"):
        plot_training([tmp_path], tmp_path / "out.png")
    assert not (tmp_path / "out.png").exists()
