"""Every reader of files and texts from outside, with sound examples of what it reads."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save

from pedzoo.core.configs import load_config
from pedzoo.core.paths import shipped
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import build
from pedzoo.data.own_files import OwnFiles
from pedzoo.data.tracks import Tracks
from pedzoo.eval.work_units import Journal
from pedzoo.maps.formats import read_igibson, read_image, read_ros
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.card import read_card
from pedzoo.models.zoo.loading import config_of, load
from pedzoo.policies.load import load_policy
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.scenarios._yaml import scenario_spec


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        file: Name of the file that it reads.
        read: Reads a file, and raises `UserError` for what it refuses.
        examples: Contents that it takes.
        inside: What is in a container of bytes, whose sums and lengths refuse most mistakes.
    """

    file: str
    read: Callable[[Path], object]
    examples: Callable[[], list[bytes]]
    inside: Callable[[], Inside] | None = None


@dataclass(frozen=True)
class Inside:
    """What is in a container.

    Attributes:
        content: Its bytes.
        whole: Makes a container of such bytes, with the sums and lengths that belong to them.
    """

    content: bytes
    whole: Callable[[bytes], bytes]


def _picture(suffix: str) -> bytes:
    import cv2

    pixels = np.where(np.arange(256).reshape(16, 16) % 16 < 12, 255, 0).astype(np.uint8)
    return cv2.imencode(suffix, pixels)[1].tobytes()


@cache
def _pictures() -> list[bytes]:
    return [_picture(kind) for kind in (".png", ".pgm", ".jpg", ".bmp")]


def _png(content: bytes) -> bytes:
    """Return a PNG of a header of 13 bytes and the rows behind it."""
    parts = (b"IHDR", content[:13]), (b"IDAT", zlib.compress(content[13:])), (b"IEND", b"")
    made = (struct.pack(">I", len(data)) + kind + data for kind, data in parts)
    sums = (struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(part + check for part, check in zip(made, sums, strict=True))


def _pixels() -> Inside:
    rows = b"".join(b"\0" + bytes(255 if column % 16 < 12 else 0 for column in range(16)) for _ in range(16))
    return Inside(struct.pack(">IIBBBBB", 16, 16, 8, 0, 0, 0, 0) + rows, _png)


@cache
def _tracks() -> list[bytes]:
    rows = [(frame, agent, 0.4 * frame + agent, 1.5 * agent) for frame in range(12) for agent in range(3)]
    plain = "".join(f"{frame}\t{agent}\t{x:.3f}\t{y:.3f}\n" for frame, agent, x, y in rows)
    table = "".join(f"{x:.3f},{y:.3f},{frame},{agent}\n" for frame, agent, x, y in rows)
    return [plain.encode(), b"x,y,frame,agent\n" + table.encode()]


_ROS = b"""image: plan.png
resolution: 0.05
origin: [0, 0, 0]
occupied_thresh: 0.65
free_thresh: 0.2
negate: 0
"""


def _ros(path: Path) -> object:
    path.with_name("plan.png").write_bytes(_pictures()[0])
    return read_ros(path)


@cache
def _sgan() -> SGAN:
    return SGAN.of(encoder_dim=4, decoder_dim=6, noise_dim=2, mlp_dim=4, embedding_dim=4)


@cache
def _weights() -> list[bytes]:
    return [save(_sgan().state_dict(), {"config": json.dumps(config_of(_sgan()))})]


@cache
def _header() -> Inside:
    content = _weights()[0]
    end = 8 + int.from_bytes(content[:8], "little")
    return Inside(content[8:end], lambda header: struct.pack("<Q", len(header)) + header + content[end:])


@cache
def _checkpoint() -> list[bytes]:
    state = {f"generator.{key}": value for key, value in _sgan().state_dict().items()}
    torch.save({"pedzoo": config_of(_sgan()), "state_dict": state}, target := io.BytesIO())
    return [target.getvalue()]


@cache
def _pickle() -> Inside:
    with zipfile.ZipFile(io.BytesIO(_checkpoint()[0])) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    name = next(entry for entry in entries if entry.endswith("data.pkl"))

    def archive_of(content: bytes) -> bytes:
        with zipfile.ZipFile(target := io.BytesIO(), "w") as archive:
            for entry, other in entries.items():
                archive.writestr(entry, content if entry == name else other)
        return target.getvalue()

    return Inside(entries[name], archive_of)


@cache
def _files(folder: str, pattern: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted(shipped(folder).glob(pattern))[:3]]


_JOURNAL = b"".join(b'{"unit": "%d", "rows": [{"n": %d}]}\n' % (one, one) for one in range(4))
_PEOPLE = b"""map: flat
speed: 1.2
people:
- {from: [-3, 0], to: [3, 0], speed: 1.1}
- {from: [3, 0.5], to: [-3, 0]}
"""
_POLICIES = [b"orca:radius=0.2,dt=0.4", b"orca:share=0.3+social_force:tau=0.5", b"go_to_goal:safety=true"]
_SCENARIOS = [b"door:width=0.9,people=4", b"circle:people=6", b"goals:map=flat,people=5", b"queue"]

READERS = {
    "tracks": Reader("people.csv", lambda path: Tracks.read(path).resampled(0.4), _tracks),
    "homography": Reader(
        "H.txt",
        lambda path: OwnFiles(["people.csv"], 0.4, homography=str(path)),
        lambda: [b"1 0 2\n0 1 3\n0 0.001 1\n"],
    ),
    "ros": Reader("map.yaml", _ros, lambda: [_ROS]),
    "image": Reader(
        "plan.png",
        lambda path: read_image(path, 0.05),
        _pictures,
        _pixels,
    ),
    "igibson": Reader("floor_trav_0.png", read_igibson, lambda: _pictures()[:1], _pixels),
    "card": Reader("card.yaml", read_card, lambda: _files("checkpoints", "sgan*.zara1/card.yaml")),
    "safetensors": Reader("sgan.safetensors", lambda path: load(str(path)), _weights, _header),
    "checkpoint": Reader("sgan.ckpt", lambda path: load(str(path)), _checkpoint, _pickle),
    "config": Reader("own.yaml", load_config, lambda: _files("configs", "*.yaml")),
    "journal": Reader("parts", Journal, lambda: [_JOURNAL]),
    "policy": Reader("policy", lambda path: load_policy(_text(path)), lambda: _POLICIES),
    "people": Reader(
        "mine.yaml",
        lambda path: build(SCENARIOS, scenario_spec(str(path)), Scenario),
        lambda: [_PEOPLE],
    ),
    "scenario": Reader("scenario", lambda path: build(SCENARIOS, _text(path), Scenario), lambda: _SCENARIOS),
}


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="replace")
