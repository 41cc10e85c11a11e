"""Small files with huge demands: every reader refuses them before it takes memory, and says which limit."""

import json
import resource
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from helpers.batches import make_batch
from helpers.server import Page, serving
from msgspec.structs import replace
from safetensors.torch import save_file

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.paths import shipped
from pedzoo.core.registry import MODELS
from pedzoo.data.recordings import OwnFiles
from pedzoo.maps.formats import read_igibson, read_image, read_ros
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.card import read_card
from pedzoo.models.zoo.loading import LARGEST, config_of, load
from pedzoo.models.zoo.store import download

ROS = "resolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\nimage: "


@contextmanager
def at_most(megabytes: int, seconds: float = 3.0) -> Iterator[None]:
    """Let a block have some megabytes more than are in use, and check its time."""
    if sys.platform != "linux":
        yield
        return
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, began = resource.getrlimit(resource.RLIMIT_AS), time.monotonic()
    resource.setrlimit(resource.RLIMIT_AS, (used + megabytes * 2**20, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert time.monotonic() - began < seconds


def png(width: int, height: int) -> bytes:
    """Return a PNG of so many grey pixels by its header, with the data of one row."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(10)))


def test_yaml_of_a_floor_plan_has_no_references(tmp_path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 9)]
    path = tmp_path / "map.yaml"
    path.write_text("\n".join([*lines, f"{ROS}*a8"]))
    said = "is not a ROS map yaml: expected no references"
    with at_most(300), pytest.raises(UserError, match=said) as error:
        read_ros(path)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize("size", [(60_000, 60_000), (2**31 - 1, 2**31 - 1), (8193, 8192)])
@pytest.mark.parametrize("cut", [None, 72])
def test_pictures_are_measured_by_their_headers(tmp_path, size: tuple[int, int], cut: int | None) -> None:
    path = tmp_path / "plan.png"
    path.write_bytes(png(*size)[:cut])
    with at_most(300), pytest.raises(UserError, match=r"pixels, at most 67,108,864 are read: reduce it"):
        read_image(path, 0.05)
    (tmp_path / "map.yaml").write_text(f"{ROS}plan.png")
    with at_most(300), pytest.raises(UserError, match="pixels, at most"):
        read_ros(tmp_path / "map.yaml")


def test_igibson_makes_no_more_cells_than_are_read(tmp_path) -> None:
    cv2.imwrite(str(tmp_path / "floor_trav_0.png"), np.full((100, 100), 255, np.uint8))
    with at_most(300), pytest.raises(UserError, match="cells, at most 67,108,864 are read: give a larger"):
        read_igibson(tmp_path / "floor_trav_0.png", resolution=1e-5)
    with at_most(300), pytest.raises(UserError, match="cells from 0 to 1000"):
        read_igibson(tmp_path / "floor_trav_0.png", erosion=100_000)


@pytest.mark.parametrize(
    ("text", "dt", "message"),
    [
        ("frame,agent,x,y\n0,1,0,0\n75000000,1,1,1\n", 0.4, "75,000,001 rows 0.4 s apart, at most 5,000,000"),
        ("frame,agent,x,y\n0,1,0,0\n200000000,1,1,1\n", 0.4, "80,000,000 seconds, at most 31,622,400"),
        ("".join(f"{400_000_000 * k} 1 0 0\n" for k in range(9)), 0.04, "seconds between consecutive frame"),
    ],
)
def test_frame_numbers_far_apart(tmp_path, text: str, dt: float, message: str) -> None:
    path = tmp_path / "people.csv"
    path.write_text(text)
    with at_most(300), pytest.raises(UserError, match=message):
        OwnFiles([str(path)], dt).recordings("train")
    path.write_text("".join(f"{400_000_000 * k} 1 {k} 0\n" for k in range(9)))  # nanoseconds
    assert len(OwnFiles([str(path)], 1e-9, "1,0,0").recordings("train")[0].tracks) == 9


def test_homographies_are_small(tmp_path) -> None:
    path = tmp_path / "H.txt"
    path.write_text("1 2 3\n" * 1_000_000)
    with at_most(300), pytest.raises(UserError, match="at most 2,000,000 are read: is it the right file"):
        OwnFiles(["people.txt"], 0.4, homography=str(path))


@pytest.mark.parametrize("dt", [1e-9, 1e-300, float("nan")])
def test_calls_of_a_controller_are_a_millisecond_apart(dt: float) -> None:
    with at_most(300), pytest.raises(UserError, match=r"of at least 0.001 s"):
        pedzoo.controller("constant_velocity", dt=dt)


def weights(path: Path, empty: bool = False, **init: Any) -> str:
    config = config_of(SGAN.of())
    metadata = {"config": json.dumps(config | {"init": config["init"] | init})}
    save_file({} if empty else SGAN.of().state_dict(), path, metadata)
    return str(path)


@pytest.mark.parametrize("size", [20_000, 10**7, 10**15, 10**30])
@pytest.mark.parametrize("empty", [False, True])
def test_config_of_weights_asks_for_more_than_they_have(tmp_path, size: int, empty: bool) -> None:
    name = weights(tmp_path / "sgan.safetensors", empty, encoder_dim=size)
    load("constant_velocity")
    with at_most(300), pytest.raises(UserError, match=r"another architecture|cannot be built|plain values"):
        load(name)


def saved(path: Path, change: Callable[[dict[str, Any]], Any], model: Any = None) -> str:
    model = model or SGAN.of()
    content: dict[str, Any] = {"pedzoo": config_of(model)}
    content["state_dict"] = {f"generator.{key}": value for key, value in model.state_dict().items()}
    torch.save(change(content) or content, path)
    return str(path)


def test_checkpoints_are_not_unpacked(tmp_path) -> None:
    plain = saved(tmp_path / "plain.ckpt", lambda content: None)
    assert load(plain)
    packed = tmp_path / "packed.ckpt"
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.infolist():
            target.writestr(entry.filename, source.read(entry))
    with pytest.raises(UserError, match="is compressed, and torch does not compress"):
        load(str(packed))


@pytest.mark.parametrize("says_length", [True, False])
def test_cards_from_servers_have_a_largest_size(tmp_path, monkeypatch, says_length: bool) -> None:
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path))
    with serving() as site:
        page = Page(bytes(30_000_000), says_length=says_length)
        with pytest.raises(UserError, match="has more than 2000000 bytes"):
            download([site.put("card.yaml", page)], "models/card.yaml")
    assert sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file()) < 3_000_000


def test_cards_name_no_endless_weights() -> None:
    card = read_card(shipped("checkpoints") / "sgan_goal.zara1" / "card.yaml")
    said = "size of weights has 5,000,000,000,000 bytes, at most 4,000,000,000"
    with pytest.raises(UserError, match=said):
        replace(card, size=5 * 10**12)
    with pytest.raises(UserError, match="expected plain values"):
        replace(card, evaluations=[{"metrics": {"ade": 10**400}}])
    assert pedzoo.load(card.name)


@pytest.mark.parametrize("kind", ["safetensors", "ckpt"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (torch.full((64, 2), torch.nan), "has NaN or infinite values"),
        (torch.full((64, 2), -torch.inf), "has NaN or infinite values"),
        (torch.ones(64, 2, dtype=torch.int8), r"is of torch\.int8, expected floating point numbers"),
        (torch.ones(64, 2, dtype=torch.complex64), r"is of torch\.complex64"),
        (torch.full((64, 2), 1e38), r"has a weight of 1e\+38, at most 1000 are read"),
        (torch.cat((torch.zeros(127), torch.tensor([-2e6]))).view(64, 2), r"has a weight of 2e\+06, at most"),
    ],
)
def test_weights_are_finite_real_numbers(tmp_path, kind: str, value: Any, message: str) -> None:
    key = "encoder.embedding.weight"
    model = SGAN.of(embedding_dim=64)
    path = tmp_path / f"sgan.{kind}"
    if kind == "ckpt":
        saved(path, lambda content: content["state_dict"].update({f"generator.{key}": value}), model)
    else:
        save_file({**model.state_dict(), key: value}, path, {"config": json.dumps(config_of(model))})
    with pytest.raises(UserError, match=f"{key} {message}"):
        load(str(path))


def test_the_largest_weights_that_are_read_give_finite_steps(tmp_path) -> None:
    # a social walker sees its own steps again: those that follow one of 1e17 m are no numbers
    steps = {SGAN: 8, MODELS.get("anchor_net"): 8, MODELS.get("social_walker"): 1}
    for number, cls in enumerate(steps):
        model = cls.of()
        signs = torch.Generator().manual_seed(number)
        state = {
            key: (LARGEST * torch.randn(value.shape, generator=signs).sign()).to(value.dtype)
            for key, value in model.state_dict().items()
        }
        path = tmp_path / f"{number}.safetensors"
        save_file(state, path, {"config": json.dumps(config_of(model))})
        assert load(str(path)).sample(make_batch((3, 2)), 2, steps[cls]).isfinite().all()


@pytest.mark.parametrize(
    ("init", "message"),
    [
        ({"safety": "no"}, "safety is 'no', expected true or false"),
        ({"frame": "x"}, "frame is 'x', expected 'world' or 'heading' or 'way'"),
        ({"noise_dim": True}, "noise_dim is True, expected a whole number"),
        ({"map": 3}, "map is 3, expected 'patch' or"),
        ({"mode_weight": [1.0]}, r"mode_weight is \[1.0\], expected a number"),
        ({"goal_protocol": None}, "goal_protocol is None, expected 'none' or"),
    ],
)
def test_settings_of_weights_are_of_their_kinds(tmp_path, init: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        load(weights(tmp_path / "sgan.safetensors", **init))
    checkpoint = saved(tmp_path / "sgan.ckpt", lambda content: content["pedzoo"]["init"].update(init))
    with pytest.raises(UserError, match=message):
        load(checkpoint)


@pytest.mark.parametrize(
    "change",
    [
        lambda content: [1, 2],
        lambda content: {"pedzoo": 1, "state_dict": {}},
        lambda content: content["pedzoo"].update(architecture=["sgan"]),
        lambda content: content["pedzoo"].update(init=None),
        lambda content: content["pedzoo"].pop("init"),
        lambda content: content["pedzoo"].update(protocol={"a": {1, 2}}),
        lambda content: content.update(state_dict=[]),
        lambda content: content["state_dict"].update({"generator.encoder.embedding.weight": "text"}),
        lambda content: content["state_dict"].update({7: torch.ones(2)}),
    ],
)
def test_malformed_checkpoints(tmp_path, change: Callable[[dict[str, Any]], Any]) -> None:
    with pytest.raises(UserError):
        load(saved(tmp_path / "sgan.ckpt", change))
