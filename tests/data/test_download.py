"""``pedzoo download``: datasets, AlexNet and models, from a server on this machine."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.server import serving, without_patience

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.published import files as listing
from pedzoo.data.published.eth_ucy import FRAMES, floor_plan, splits
from pedzoo.data.published.files import files_of, published
from pedzoo.maps.formats import read_plan, seen_from_above
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN
from pedzoo.models.blocks import alexnet

PLACE = ("repository", "commit", "path")
RAW, CDN = "raw/{repository}/{commit}/{path}", "cdn/{repository}@{commit}/{path}"


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A server in the place of GitHub and its mirror, and an empty cache."""
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "cache"))
    for name in ("PEDZOO_DATA", "PEDZOO_ALEXNET"):
        monkeypatch.delenv(name, raising=False)
    without_patience(monkeypatch)
    with serving() as result:
        monkeypatch.setattr(listing, "HOSTS", (f"{result.url}/{RAW}", f"{result.url}/{CDN}"))
        yield result


@pytest.fixture
def full(site, shared):
    """The server with all files of ETH/UCY in the first place of each."""
    for file in files_of("eth_ucy"):
        repository, commit, path = file.places[0]
        content = (shared / "data" / "eth_ucy" / file.path).read_bytes()
        site.put(RAW.format(repository=repository, commit=commit, path=path), content)
    return site


# -- where things lie


def test_every_file_has_a_pinned_place_and_a_second_one():
    assert published() == ["eth_ucy"]
    files = files_of("eth_ucy")
    assert len({file.path for file in files}) == len(files) == 24 + 5 + 6
    for file in files:
        assert len(file.urls()) >= 2
        assert len({url.split("/")[2] for url in file.urls()}) >= 2, "one host is down, the other is not"
        for _, commit, path in file.places:
            assert len(commit) == 40
            assert int(commit, 16)
            assert ".." not in path
    assert {file.path.split("/")[0] for file in files} == {"raw", "train", "val", "homography", "maps"}


def test_sums_are_those_of_the_files(shared):
    lines = (shared / "data" / "eth_ucy" / "SHA256SUMS").read_text().splitlines()
    expected = {path: digest for digest, path in map(str.split, lines)}
    made_here = {"README.md", "splits.json", "maps/alignment.json"}
    made_here |= {f"maps/{scene}{end}" for scene in FRAMES for end in (".png", ".yaml")}
    files = {file.path: file.sha256 for file in files_of("eth_ucy")}
    assert files == {path: digest for path, digest in expected.items() if path not in made_here}
    for file in files_of("eth_ucy"):
        assert (shared / "data" / "eth_ucy" / file.path).stat().st_size == file.size


def test_folds_are_those_of_social_gan(shared):
    expected = json.loads((shared / "data" / "eth_ucy" / "splits.json").read_text())
    assert splits() == {key: expected[key] for key in splits()}


# -- floor plans


@pytest.mark.parametrize("scene", FRAMES)
def test_floor_plans_equal_the_recorded_ones_bit_for_bit(shared, scene):
    plan = floor_plan(scene, shared / "data" / "eth_ucy")
    expected = read_plan(shared / "data" / "eth_ucy" / "maps" / f"{scene}.yaml")
    assert np.array_equal(plan.cells, expected.cells)
    assert (plan.resolution, plan.origin) == (expected.resolution, expected.origin)
    assert plan.digest == expected.digest


LOOKING_DOWN = np.array([[0.1, 0, 0], [0, -0.1, 1.0], [0, 0, 1]])
"""Pixels of 0.1 m, the image's upper left corner at (0, 1) on the ground."""


def test_cells_are_solid_by_majority_and_unknown_outside():
    solid, thin = np.zeros((2, 10, 10), dtype=np.bool_)
    solid[0, :5] = True  # y from 0.95 to 1.05, x up to 0.45
    thin[8, 8] = True
    plan = seen_from_above(solid, thin, LOOKING_DOWN, (0.0, 0.0), (1.5, 1.0), 0.25)
    image = np.flipud(plan.cells)
    assert image.shape == (4, 6)
    assert (image[:, 4:] == UNKNOWN).all()
    assert (image[0, :4] == FREE).all(), "three of nine samples"
    assert image[3, 3] == OCCUPIED, "one pixel"
    assert (image == OCCUPIED).sum() == 1
    finer = np.flipud(seen_from_above(solid, thin, LOOKING_DOWN, (0.0, 0.0), (1.5, 1.0), 0.05).cells)
    assert finer.shape == (20, 30)
    assert (finer[0, :9] == OCCUPIED).all()
    assert (finer[1, :19] == FREE).all()
    assert (finer[0, 9:19] == FREE).all()
    assert (finer == OCCUPIED).sum() == 9 + 4


def test_homography_is_the_same_at_every_scale():
    rng = np.random.default_rng(0)
    solid, thin = rng.random((2, 20, 20)) < 0.3
    tilted = LOOKING_DOWN + np.array([[0, 0.01, 0], [0.01, 0, 0], [0.01, 0.02, 0]])
    plans = [
        seen_from_above(solid, thin, factor * tilted, (-1.0, -1.0), (2.0, 2.0)) for factor in (1.0, -4.0)
    ]
    assert plans[0].digest == plans[1].digest
    with pytest.raises(UserError, match="cannot be inverted"):
        seen_from_above(solid, thin, np.ones((3, 3)), (0, 0), (1, 1))
    with pytest.raises(UserError, match=r"\(2, 3\), expected \(3, 3\)"):
        seen_from_above(solid, thin, tilted[:2], (0, 0), (1, 1))
    with pytest.raises(UserError, match="no cells"):
        seen_from_above(solid, thin, tilted, (0, 0), (0, 1))
    with pytest.raises(UserError, match="expected two of one image"):
        seen_from_above(solid, thin[1:], tilted, (0, 0), (1, 1))


# -- pedzoo download eth_ucy


def test_a_dataset_comes_whole_and_is_found_unnamed(refused, full, shared, tmp_path, capsys, monkeypatch):
    with pytest.raises(UserError, match="`pedzoo download eth_ucy` gets those"):
        EthUcy("zara1", None)
    assert main(["download", "eth_ucy"]) == 0
    said = capsys.readouterr().out
    folder, there = tmp_path / "cache" / "data" / "eth_ucy", shared / "data" / "eth_ucy"
    assert f"eth_ucy: 35 files, 5.6 MB, each with the expected sha256, in {folder}" in said
    assert "terms: ETH is public for research" in said
    assert "cite: S. Pellegrini" in said
    assert "use: --data.fold eth\n" in said

    expected = {str(path.relative_to(there)) for path in there.rglob("*") if path.is_file()}
    came = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert came == expected - {"maps/alignment.json"}
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, path = line.split()
        assert hashlib.sha256((folder / path).read_bytes()).hexdigest() == digest
    readme = (folder / "README.md").read_text()
    assert all(
        part in readme for part in ("Lerner", "CC BY-NC 4.0", "333d3a57b4d2705e129b21aefefa09c79b2b9ae1")
    )
    assert "$" not in readme

    ours, theirs = (EthUcy("univ", root, "true").recordings("train") for root in (None, str(there)))
    for one, other in zip(ours, theirs, strict=True):
        assert np.array_equal(one.tracks.xy, other.tracks.xy)
        assert (one.plan is None) == (other.plan is None)
        if isinstance(one.plan, Path) and isinstance(other.plan, Path):
            assert read_plan(one.plan).digest == read_plan(other.plan).digest

    monkeypatch.setenv("PEDZOO_OFFLINE", "1")
    assert main(["download", "eth_ucy"]) == 0, "all is there"
    said = refused("download", "eth_ucy", "--to", str(tmp_path / "elsewhere"))
    assert "biwi_eth.txt is not there, and PEDZOO_OFFLINE forbids the network" in said


def test_a_second_call_mends_what_is_missing_or_damaged(refused, full, tmp_path, capsys):
    folder, last = tmp_path / "mine", files_of("eth_ucy")[-1]
    (first_place, second_place) = (dict(zip(PLACE, place, strict=True)) for place in last.places)
    missing = full.pages.pop(RAW.format(**first_place))
    said = refused("download", "eth_ucy", "--to", str(folder))
    assert "cannot download hotel_ewap_obstacles.png: http" in said
    assert not (folder / "splits.json").exists(), "half a dataset does not look like a whole one"
    with pytest.raises(UserError, match=r"expected splits\.json"):
        EthUcy("zara1", str(folder))

    (damaged := folder / "raw" / "biwi_eth.txt").write_text("0 1 2 3\n")
    before = len(full.asked)
    full.put(CDN.format(**second_place), missing)
    assert main(["download", "eth_ucy", "--to", str(folder)]) == 0
    assert f"use: --data.fold eth --data.root {folder}" in capsys.readouterr().out
    asked = [path for path, _ in full.asked[before:]]
    mirrors = [form.format(**place) for place in (first_place, second_place) for form in (RAW, CDN)]
    assert asked[0].endswith("biwi_eth.txt")
    assert asked[1:] == mirrors, "all else is kept"
    assert damaged.stat().st_size == 116970
    assert len(EthUcy("zara1", str(folder)).recordings("val")) == 7


def test_a_folder_that_cannot_be_is_refused(site, tmp_path, refused):
    (tmp_path / "file").write_text("")
    assert "is a file, expected a folder" in refused("download", "eth_ucy", "--to", str(tmp_path / "file"))
    assert not site.asked


# -- AlexNet and models


@pytest.fixture
def published_alexnet(site, shared, tmp_path, monkeypatch):
    """A server with AlexNet's weights as torchvision publishes them, but without the classifier."""
    weights = alexnet.load(str(shared / "weights" / "alexnet_imagenet_features_fp16.safetensors"))
    file = tmp_path / alexnet.FILE
    torch.save(weights, file)
    content = file.read_bytes()
    file.unlink()
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(alexnet, "URLS", (f"{site.url}/gone.pth", site.put(alexnet.FILE, content)))
    monkeypatch.setattr(alexnet, "SHA256", hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(alexnet, "SIZE", len(content))
    return site, tmp_path / "cache" / alexnet.FILE


def test_alexnet_comes_once_and_loads(published_alexnet, shared, capsys):
    site, file = published_alexnet
    assert main(["download", "alexnet"]) == 0
    assert capsys.readouterr().out == f"{file}\n"
    asked = len(site.asked)
    weights = alexnet.load()
    assert len(site.asked) == asked == 2
    expected = alexnet.load(str(shared / "weights" / "alexnet_imagenet_features_fp16.safetensors"))
    assert all(torch.equal(weights[key], expected[key]) for key in alexnet.KEYS)


def test_alexnet_of_torch_hub_is_taken_if_published(published_alexnet, tmp_path):
    site, file = published_alexnet
    (folder := tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    (folder / alexnet.FILE).write_bytes(b"another")
    assert alexnet.obtain() == file
    (folder / alexnet.FILE).write_bytes(file.read_bytes())
    file.unlink()
    asked = len(site.asked)
    assert alexnet.obtain() == folder / alexnet.FILE
    assert len(site.asked) == asked


def test_without_a_network_alexnet_can_be_given(site, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(alexnet, "URLS", (f"{site.url}/none.pth",))
    with pytest.raises(UserError, match=r"404 Not Found.*or in the environment variable PEDZOO_ALEXNET"):
        alexnet.load()


def test_a_shipped_model_is_there_already(site, capsys):
    assert main(["download", "sgan_goal.zara1"]) == 0
    assert capsys.readouterr().out.endswith("sgan_goal.zara1/weights.safetensors\n")
    assert not site.asked


@pytest.mark.parametrize(
    ("name", "near"),
    [("eth-ucy", "eth_ucy"), ("alexnett", "alexnet"), ("sgan_goal.zarra1", "sgan_goal.zara1")],
)
def test_misspelt_names_are_told(site, refused, name, near):
    said = refused("download", name)
    assert f"unknown dataset or model {name!r}: did you mean {near!r}?" in said
    assert "pedzoo: --to x: only for datasets (eth_ucy)" in refused("download", "alexnet", "--to", "x")
