"""Folds, own files and the embedded people as the command line sees them: counts, clocks, maps, refusals."""

import json
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
import torch
from jsonargparse import ArgumentParser
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import ImitationWindows, Loading, TrajectoryDataModule
from pedzoo.data.recordings import Split

SPLITS: tuple[Split, ...] = ("train", "val", "test")
TURN = np.array([[0.0, -0.1, 30.0], [0.1, 0.0, 2.0], [0.0, 0.0, 1.0]])
"""Pixels to metres in the recording below: a quarter turn, 0.1 m per pixel, and a shift."""


def write_recording(folder: Path, name: str = "lobby.csv", people: int = 29, every: int = 25) -> Path:
    """Write people who walk 1 m/s to the right on lines of their own: 10 Hz, pixels of `TURN`, unsorted."""
    rows = []
    for agent in range(people):
        for frame in range(agent * every, agent * every + 100):
            world = np.array([0.1 * (frame - agent * every), 0.5 * agent, 1.0])
            pixel = np.linalg.inv(TURN) @ world
            rows.append(f"{pixel[1]:.6f},{agent},{frame},someone,{pixel[0]:.6f}\n")
    np.random.default_rng(0).shuffle(rows)
    path = folder / name
    path.write_text("y,agent,frame,note,x\n" + "".join(rows))
    return path


def own_files(folder: Path, **options: Any) -> dict[str, Any]:
    """Return the --data options of a recording with homography and floor plan."""
    np.savetxt(folder / "H.txt", TURN)
    cv2.imwrite(str(folder / "lobby.png"), np.full((40, 30), 255, np.uint8))
    (folder / "lobby.yaml").write_text(
        "image: lobby.png\nresolution: 0.5\norigin: [-2, -2, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    given = {
        "files": [str(write_recording(folder))],
        "dt": 0.1,
        "map": str(folder / "lobby.yaml"),
        "homography": str(folder / "H.txt"),
    }
    return given | options


def refused(**options: Any) -> str:
    with pytest.raises(UserError) as error:
        TrajectoryDataModule(**options).setup(None)
    assert "\n" not in str(error.value)
    return str(error.value)


# -- own files


def test_own_files_end_to_end_by_their_options(tmp_path, capsys):
    """Files, clock, split, map and homography, written as on the command line."""
    options = own_files(tmp_path, split="0.6,0.2,0.2", goal="destination")
    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(TrajectoryDataModule, "data")
    parsed = parser.parse_args(
        [f"--data.{key}={json.dumps(value) if key == 'files' else value}" for key, value in options.items()]
    )
    data = cast("Any", parser.instantiate_classes(parsed)).data
    assert isinstance(data, TrajectoryDataModule)
    data.setup(None)

    printed = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in printed] == ["files train", "files val", "files test"]
    for line, split in zip(printed, SPLITS, strict=True):
        assert f"{len(data.sets[split])} windows with {int(data.sets[split].sizes.sum())} people" in line
        assert line.endswith("median speed 1.00 m/s")
    assert data.sets["train"].offsets[-1] > 2 * data.sets["val"].offsets[-1] > 0

    batches = list(data.test_dataloader())
    for batch in batches:
        mask = cast("Tensor", batch["agents", "mask"])
        velocity = cast("Tensor", batch["agents", "velocity"])[mask]
        assert torch.allclose(velocity, torch.tensor([1.0, 0.0]).expand_as(velocity), atol=1e-3)
        step = cast("Tensor", batch["agents", "history"])[mask].diff(dim=1)
        assert torch.allclose(step, torch.tensor([0.4, 0.0]).expand_as(step), atol=1e-4)
        assert (batch["map_id"] == data.bank.id_of("lobby")).all()
    goal = cast("Tensor", batches[0]["agents", "goal"])[cast("Tensor", batches[0]["agents", "mask"])]
    assert (goal[:, 0] > 6).all()  # where they leave, 10 m ahead, or where the part ends
    assert data.protocol["fold"] == "files"
    assert data.protocol["clock"] == "true"


def test_splits_are_cut_in_time_without_overlap(tmp_path):
    """A cut falls exactly on step 100 of 200: it belongs to one part."""
    data = TrajectoryDataModule(**own_files(tmp_path, split="0.5,0.25,0.25"))
    parts = [data.source.recordings(split)[0].tracks for split in SPLITS]
    whole = TrajectoryDataModule(**own_files(tmp_path, split="1,0,0")).source.recordings("train")[0].tracks
    assert sum(map(len, parts)) == len(whole)
    for early, late in pairwise(parts):
        assert early.frame.max() < late.frame.min()
    ends = [part.frame.max() / whole.frame.max() for part in parts]
    assert ends == pytest.approx([0.5, 0.75, 1.0], abs=0.02)


def test_several_files_are_one_split_and_empty_ones_named(tmp_path, capsys):
    paths = [write_recording(tmp_path), write_recording(tmp_path, "short.csv", people=2, every=3)]
    np.savetxt(tmp_path / "H.txt", TURN)
    homography = str(tmp_path / "H.txt")
    one = TrajectoryDataModule(files=[str(paths[0])], dt=0.1, homography=homography)
    one.setup("test")
    capsys.readouterr()
    both = TrajectoryDataModule(files=[str(path) for path in paths], dt=0.1, homography=homography)
    both.setup("test")
    assert len(both.sets["test"]) == len(one.sets["test"])
    assert "files test: no window in short" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dt": None}, ["--data.dt is None", "seconds between two consecutive frame numbers"]),
        ({"dt": -0.1}, ["--data.dt is -0.1"]),
        ({"dt": 1e-6}, ["lobby.csv", "lasts 0.000799 s", "--data.dt 1e-06"]),
        ({"dt": 25}, ["--data.dt is 25"]),
        ({"split": "0.7,0.3"}, ["--data.split '0.7,0.3'", "0.7,0.15,0.15"]),
        ({"split": "0.7,0.2,0.2"}, ["--data.split '0.7,0.2,0.2'", "add up to 1"]),
        ({"split": "nan,0.5,0.5"}, ["--data.split 'nan,0.5,0.5'"]),
        ({"split": "1,0,0"}, ["no person", "val part", "lobby.csv", "share 0", "--data.split"]),
        ({"split": "0.98,0.01,0.01"}, ["16 steps", "only", "lobby"]),
        ({"homography": "nowhere.txt"}, ["--data.homography", "nowhere.txt", "3 rows of 3 numbers"]),
        ({"homography": "{folder}/two.txt"}, ["--data.homography", "(2, 3)"]),
        ({"homography": "{folder}/flat.txt"}, ["--data.homography", "singular"]),
        ({"homography": "{folder}/far.txt"}, ["lobby.csv", "extends over", "homography to metres"]),
        ({"map": "{folder}/no.yaml"}, ["no.yaml"]),
        ({"files": ["{folder}/no.csv"]}, ["no recording at", "no.csv"]),
        ({"pred_len": 400}, ["8 + 400 = 408", "lobby"]),
        ({"obs_len": 1}, ["--data.obs_len 1"]),
        ({"loading": Loading(batch_size=0)}, ["--data.loading.batch_size"]),
        ({"imitated": ImitationWindows(steps=-1)}, ["--data.imitated.steps -1: expected steps"]),
        ({"imitated": ImitationWindows(8, 0)}, ["imitated.batch_size 0: expected at least 1"]),
    ],
)
def test_bad_own_files_are_refused(tmp_path, options, words):
    given = own_files(tmp_path, **options)
    np.savetxt(tmp_path / "two.txt", TURN[:2])
    np.savetxt(tmp_path / "flat.txt", np.ones((3, 3)))
    np.savetxt(tmp_path / "far.txt", np.diag([1e5, 1e5, 1]) @ TURN)
    for name in ("homography", "map"):
        given[name] = given[name].format(folder=tmp_path)
    given["files"] = [file.format(folder=tmp_path) for file in given["files"]]
    message = refused(**given)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"files": ["a.csv", "b.csv", "a.csv"], "dt": 0.4}, "files name 'a.csv' twice"),
        ({"dt": 0.1}, "--data.dt given without --data.files"),
        ({"map": "m.yaml"}, "--data.map given without --data.files"),
        ({"homography": "H.txt"}, "--data.homography given without --data.files"),
        ({"hold_out": "zara1"}, "hold_out zara1: expected another scene of the recordings of 'embedded'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, words):
    assert words in refused(**options)


# -- folds


def test_embedded_needs_no_root(monkeypatch, capsys):
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    data = TrajectoryDataModule()
    data.setup(None)
    assert data.bank.names == ("plaza",)
    assert len(capsys.readouterr().out.splitlines()) == 3
    batch = next(iter(data.train_dataloader()))
    assert (batch["map_id"] == data.bank.id_of("plaza")).all()


def test_unknown_folds_and_missing_roots_are_refused(tmp_path, monkeypatch):
    message = refused(fold="zarra1")
    assert "unknown fold 'zarra1': did you mean 'zara1'?" in message
    assert "known: embedded, eth, eth_ucy, gc" in message
    assert "--data.files a.csv,b.csv" in refused(fold="files")  # as weights say that learned from such
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    how = ["--data.root", "PEDZOO_DATA", "pedzoo download eth_ucy", "embedded"]
    for root, words in ((None, how), (str(tmp_path / "no"), [*how, "is not a folder"])):
        message = refused(fold="zara1", root=root)
        assert all(word in message for word in words), message
    message, words = refused(fold="zara1", root=str(tmp_path)), ("splits.json", "zara1/train/*.txt")
    assert all(word in message for word in (str(tmp_path), *words, "pedzoo download"))


def test_stages_read_what_they_need_once(shared, capsys):
    data = TrajectoryDataModule("zara1", str(shared / "data"))
    data.setup("fit")
    assert list(data.sets) == ["train", "val"]
    before = dict(data.sets)
    capsys.readouterr()
    data.setup("validate")
    data.setup("fit")
    data.setup("test")
    assert capsys.readouterr().out == (
        "zara1 test: 702 windows with 2875 people (counted once per window); "
        "left out: 2126 seen only in part of a window, 63 with too few others; median speed 1.10 m/s\n"
    )
    assert all(data.sets[split] is before[split] for split in before)
    # training goes on after a test: the bank knows the floor plans of both
    ids = torch.cat([scenes.map_id for scenes in data.sets.values()])
    assert data.bank.index(ids).max() == 4


def test_protocol_options_reach_the_batches(shared):
    data = TrajectoryDataModule(
        "zara1", str(shared / "data"), keep_people="present", min_people=1, pred_len=12
    )
    batches = list(data.test_dataloader())
    assert batches[0]["agents", "future"].shape[2] == 12
    assert int(data.sets["test"].sizes.min()) == 1
    known = torch.cat([batch["agents", "future_valid"][batch["agents", "mask"]] for batch in batches])
    assert 0.5 < known.float().mean() < 1
    assert {"goal": "none", "clock": "benchmark", "pred_len": 12}.items() <= data.protocol.items()


def test_the_true_clock_reaches_the_batches(shared):
    speeds = {}
    for clock in ("benchmark", "true"):
        data = TrajectoryDataModule("eth", str(shared / "data"), clock=clock)  # type: ignore[arg-type]
        agents = [batch["agents"] for batch in data.test_dataloader()]
        speed = torch.cat([one["velocity"][one["mask"]].norm(dim=-1) for one in agents])
        speeds[clock] = float(speed[speed > 0.3].median())
    assert 2.2 < speeds["benchmark"] < 2.8
    assert 1.3 < speeds["true"] < 1.7


def test_social_gans_folders_give_the_same_windows(shared, tmp_path):
    """The layout that one can download: zara1/{train,val,test}/*.txt, no floor plans."""
    pack = shared / "data" / "eth_ucy"
    for split, files in json.loads((pack / "splits.json").read_text())["folds"]["zara1"].items():
        folder = tmp_path / "datasets" / "zara1" / split
        folder.mkdir(parents=True)
        for file in files:
            shutil.copy(pack / file, folder)
    for root in (tmp_path, tmp_path / "datasets"):
        data = TrajectoryDataModule("zara1", str(root))
        data.setup(None)
        sizes = [(len(data.sets[split]), int(data.sets[split].offsets[-1])) for split in SPLITS]
        assert sizes == [(2692, 32686), (721, 6361), (702, 2875)]
        assert (data.sets["test"].map_id == -1).all()
    fold = TrajectoryDataModule("zara1", str(tmp_path)).source.recordings("train")[0].tracks
    true = TrajectoryDataModule("zara1", str(tmp_path), clock="true").source.recordings("train")[0].tracks
    assert fold.name == true.name == "biwi_eth_train"
    assert np.ptp(true.frame) * 0.4 == pytest.approx(np.ptp(fold.frame) / 10 * 2 / 3, abs=0.4)
    shutil.rmtree(tmp_path / "datasets" / "zara1" / "val")
    assert "pedzoo download eth_ucy" in refused(fold="zara1", root=str(tmp_path))


# -- loaders


def test_training_repeats_with_the_seed_not_between_epochs():
    def histories(seed: int, epoch: int) -> list[Tensor]:
        data = TrajectoryDataModule(
            goal="random_future", loading=Loading(seed=seed, rotate=True, mirror=True)
        )
        loader = data.train_dataloader()
        cast("Any", loader.sampler).set_epoch(epoch)
        return [torch.cat((b["agents", "history"][:, :, -1], b["agents", "goal"]), -1) for b in loader]

    first = histories(0, 3)
    assert all(torch.equal(a, b) for a, b in zip(first, histories(0, 3), strict=True))
    for other in (histories(1, 3), histories(0, 4)):
        assert any(a.shape != b.shape or not torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_every_process_evaluates_all_windows():
    class Second:
        global_rank, world_size = 1, 2

    alone, second = TrajectoryDataModule(), TrajectoryDataModule()
    second.trainer = cast("Any", Second())
    assert len(list(second.val_dataloader())) == len(list(alone.val_dataloader()))
    assert len(list(second.train_dataloader())) == -(-len(list(alone.train_dataloader())) // 2)


def test_a_scene_that_is_held_out_is_what_validation_is_on(shared):
    data = TrajectoryDataModule("zara1", str(shared / "data"), hold_out="hotel")
    data.setup("fit")
    names = {split: {name for name, _ in data.sets[split].counts} for split in ("train", "val")}
    assert names["val"] == {"biwi_hotel_train", "biwi_hotel_val"}
    assert {name.removesuffix("_train") for name in names["train"]} == {
        *("biwi_eth", "crowds_zara02", "crowds_zara03", "students001", "students003", "uni_examples")
    }
    for scene in ("zara1", "eth_ucy", "mall"):
        with pytest.raises(UserError, match=f"hold_out {scene}: expected another scene"):
            TrajectoryDataModule("zara1", str(shared / "data"), hold_out=scene).setup("fit")
