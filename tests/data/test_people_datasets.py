"""Recordings of halls and corridors, and the training set of all kinds: what is in which split."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.datasets.gc import Gc
from pedzoo.data.datasets.hermes import Hermes, corridor
from pedzoo.data.recordings import open_fold, provenance
from pedzoo.maps.bank import MapBank

HALLS, CORRIDORS, STREETS = ("gc", "pamela"), ("hermes",), ("biwi", "crowds", "students", "uni")


def names(fold: str, split: str, root: Path) -> list[str]:
    return [one.tracks.name for one in open_fold(fold, str(root), "true").recordings(split)]  # type: ignore[arg-type]


@pytest.fixture
def root(shared: Path) -> Path:
    return shared / "data"


@pytest.mark.parametrize("fold", ["gc", "hermes", "pamela"])
def test_splits_of_a_dataset_share_no_file(fold: str, root: Path):
    train, val, test = (
        {name.partition("+")[0] for name in names(fold, s, root)} for s in ("train", "val", "test")
    )
    assert train and val and test
    assert not (train & val or train & test or val & test)


def test_the_clip_that_others_report_is_in_no_training(root: Path):
    for fold in ("gc", "mixed", "mixed_zara1", "mixed_corridors"):
        assert not [name for split in ("train", "val") for name in names(fold, split, root) if "2344" in name]


@pytest.mark.parametrize(
    ("fold", "out"),
    [
        ("mixed_zara1", ("crowds_zara01",)),
        ("mixed_univ", ("students",)),
        ("mixed_streets", STREETS),
        ("mixed_halls", HALLS),
        ("mixed_corridors", CORRIDORS),
        ("mixed_two_way", ("hermes_bo",)),
    ],
)
def test_a_fold_leaves_out_what_it_is_called_after(fold: str, out: tuple[str, ...], root: Path):
    seen = names(fold, "train", root) + names(fold, "val", root)
    assert not [name for name in seen if name.startswith(out)]
    assert all(name.startswith(out) for name in names(fold, "test", root))
    kept = [kind for kind in (HALLS, CORRIDORS, STREETS) if set(kind) - set(out)]
    assert all(any(name.startswith(kind) for name in seen) for kind in kept)


def test_phases_of_a_recording_are_the_same_people_a_little_later(root: Path):
    whole, later = Gc("gc", str(root)).read("gc_1000", (0, 2))
    table = np.loadtxt(root / "people" / "gc_1000.csv", delimiter=",", skiprows=1)
    agent = whole.tracks.agent[0]
    mine = table[table[:, 1] == agent]
    for one, phase in ((whole, 0), (later, 2)):
        rows = one.tracks.agent == agent
        for frame, xy in zip(one.tracks.frame[rows][:5], one.tracks.xy[rows][:5], strict=True):
            at = table[:, 0].min() + phase + frame * STEP_SECONDS / 0.08
            assert xy == pytest.approx(mine[mine[:, 0] == at][0, 2:], abs=1e-6)
    assert whole.weight == later.weight == 0.5


def test_corridor_has_walls_where_people_are_not(root: Path):
    recording = Hermes("hermes", str(root)).read("hermes_bo-360-050-050")[0]
    assert recording.plan is corridor(3.6)
    bank = MapBank([corridor(3.6)], unknown="free")
    xy = torch.from_numpy(recording.tracks.xy).float()
    free = bank.signed_distance(
        xy.unsqueeze(0), torch.tensor([bank.id_of("corridor_3.6")]), torch.tensor([[0.0, 1, 0, 0]])
    )
    assert float((free > 0).float().mean()) > 0.999
    beside = torch.tensor([[[-0.1, 0.0], [3.7, 3.9], [1.8, 0.0], [-0.1, 5.0]]])
    inside = bank.signed_distance(
        beside, torch.tensor([bank.id_of("corridor_3.6")]), torch.tensor([[0.0, 1, 0, 0]])
    )
    assert (inside < 0).tolist() == [[True, True, False, False]]


def test_a_narrow_corridor_is_named_by_its_second_number(root: Path):
    assert Hermes("hermes", str(root)).plan("hermes_uo-100-180-180") is corridor(1.8)


def test_datamodule_has_the_floor_plans_of_drawn_corridors(root: Path):
    data = TrajectoryDataModule(fold="hermes", root=str(root), clock="true")
    data.setup("validate")
    assert data.bank.names == ("corridor_3.6", "corridor_2.4")
    crowds = data.crowds("val")
    assert {data.bank.id_of("corridor_3.6"), data.bank.id_of("corridor_2.4")} == {at for _, at, _ in crowds}


def test_a_missing_file_is_said_with_its_source(tmp_path: Path):
    (tmp_path / "people").mkdir()
    with pytest.raises(UserError, match=r"gc_1000.csv.*0\.08 s apart, of Grand Central.*SPDiff"):
        Gc("gc", str(tmp_path)).read("gc_1000")


def test_cards_say_what_a_mixed_fold_trains_on():
    said = provenance("mixed_halls")
    assert said["recordings"] == [
        "biwi_eth", "biwi_hotel", "crowds_zara01", "crowds_zara02", "crowds_zara03", "hermes_bo", "hermes_uo",
        "students001", "students003", "uni_examples",
    ]  # fmt: skip
    assert said["citation"].startswith("Pellegrini et al., ICCV 2009; Lerner")
    assert "HERMES" in said["citation"]
    assert "research use" in said["terms"]
