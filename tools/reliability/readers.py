"""Every reader of files and texts from outside, with sound examples of what it reads."""

from __future__ import annotations

import json
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
from pedzoo.eval.workers.journal import Journal
from pedzoo.maps.files.igibson import read_igibson
from pedzoo.maps.files.images import read_image
from pedzoo.maps.files.ros import read_ros
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.card import read_card
from pedzoo.models.zoo.loading import config_of, load
from pedzoo.policies.load import load_policy
from pedzoo.sim.scenario_parts.scenario import Scenario


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        file: Name of the file that it reads.
        read: Reads a file, and raises `UserError` for what it refuses.
        examples: Contents that it takes.
    """

    file: str
    read: Callable[[Path], object]
    examples: Callable[[], list[bytes]]


def _picture(suffix: str) -> bytes:
    import cv2

    pixels = np.where(np.arange(256).reshape(16, 16) % 16 < 12, 255, 0).astype(np.uint8)
    return cv2.imencode(suffix, pixels)[1].tobytes()


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
    path.with_name("plan.png").write_bytes(_picture(".png"))
    return read_ros(path)


@cache
def _sgan() -> SGAN:
    return SGAN.of(encoder_dim=4, decoder_dim=6, noise_dim=2, mlp_dim=4, embedding_dim=4)


def _weights() -> list[bytes]:
    return [save(_sgan().state_dict(), {"config": json.dumps(config_of(_sgan()))})]


def _checkpoint() -> list[bytes]:
    import io

    state = {f"generator.{key}": value for key, value in _sgan().state_dict().items()}
    torch.save({"pedzoo": config_of(_sgan()), "state_dict": state}, target := io.BytesIO())
    return [target.getvalue()]


def _files(folder: str, pattern: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted(shipped(folder).glob(pattern))[:3]]


_JOURNAL = b"".join(b'{"unit": "%d", "rows": [{"n": %d}]}\n' % (one, one) for one in range(4))
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
        lambda: [_picture(kind) for kind in (".png", ".pgm", ".jpg", ".bmp")],
    ),
    "igibson": Reader("floor_trav_0.png", read_igibson, lambda: [_picture(".png")]),
    "card": Reader("card.yaml", read_card, lambda: _files("checkpoints", "sgan*.zara1/card.yaml")),
    "safetensors": Reader("sgan.safetensors", lambda path: load(str(path)), _weights),
    "checkpoint": Reader("sgan.ckpt", lambda path: load(str(path)), _checkpoint),
    "config": Reader("own.yaml", load_config, lambda: _files("configs", "*.yaml")),
    "journal": Reader("parts", Journal, lambda: [_JOURNAL]),
    "policy": Reader("policy", lambda path: load_policy(_text(path)), lambda: _POLICIES),
    "scenario": Reader("scenario", lambda path: build(SCENARIOS, _text(path), Scenario), lambda: _SCENARIOS),
}


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="replace")
