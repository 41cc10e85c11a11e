"""The embedded dataset: made by its script, small, sane and honest."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from pedzoo.data.datasets.embedded import Embedded
from pedzoo.data.recordings import Split, open_fold
from pedzoo.maps.formats import read_ros

FOLDER = Embedded().folder
PEOPLE: dict[Split, int] = {"train": 360, "val": 80, "test": 80}


def test_script_reproduces_the_committed_files_byte_for_byte(tmp_path, monkeypatch) -> None:
    """The shortest recording and the floor plan: the others come from other seeds alone."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "tools" / "zoo"))
    script = import_module("make_embedded")
    monkeypatch.setattr(script, "SPLITS", {"val": script.SPLITS["val"]})
    script.main(tmp_path)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == ["plaza.png", "plaza.yaml", "plaza_val.csv"]
    for name in made:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


def test_it_is_under_a_megabyte_and_says_that_it_is_synthetic() -> None:
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000
    text = (FOLDER / "README.md").read_text()
    assert "synthetic" in text
    assert "not human data" in text


@pytest.mark.parametrize("split", list(PEOPLE))
def test_people_walk_at_human_speeds_without_overlaps(split: Split) -> None:
    (recording,) = open_fold("embedded", None, "benchmark").recordings(split)
    tracks = recording.tracks
    assert tracks.people == PEOPLE[split]
    assert np.isfinite(tracks.xy).all()

    same = np.diff(tracks.agent) == 0
    assert (np.diff(tracks.frame)[same] == 1).all()
    speed = np.linalg.norm(np.diff(tracks.xy, axis=0)[same], axis=1) / 0.4
    assert 0.9 < speed.mean() < 1.4
    assert speed.max() < 2.5

    crowds = [np.flatnonzero(tracks.frame == frame) for frame in np.unique(tracks.frame)]
    assert max(map(len, crowds)) <= 20
    nearest = []
    for rows in crowds:
        apart = np.linalg.norm(tracks.xy[rows, None] - tracks.xy[None, rows], axis=-1)
        np.fill_diagonal(apart, np.inf)
        nearest += apart.min(axis=1).tolist()
    assert np.mean(np.array(nearest) < 0.3) < 0.005


@pytest.mark.parametrize("split", list(PEOPLE))
def test_no_person_is_inside_a_wall(split: Split) -> None:
    (recording,) = Embedded().recordings(split)
    assert isinstance(recording.plan, Path)
    grid = read_ros(recording.plan)
    affine = grid.map_to_cell()
    column, row = np.rint(affine[:, :2] @ recording.tracks.xy.T + affine[:, 2:]).astype(int)
    # Positions between the outermost cell's centre and the border belong to that cell.
    height, width = grid.cells.shape
    distance = grid.signed_distance("wall")[row.clip(0, height - 1), column.clip(0, width - 1)]
    assert distance.min() > -0.1
    assert (distance < 0).mean() < 0.001
