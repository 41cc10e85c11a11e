"""Hostile contents for every reader: sound ones with mistakes, any bytes, and what was wrong once."""

import io
import json
import os
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save

from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.paths import shipped
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import build
from pedzoo.data.recordings import OwnFiles
from pedzoo.data.tracks import Tracks
from pedzoo.eval.work_units import Journal
from pedzoo.maps.formats import read_igibson, read_image, read_ros
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.card import read_card
from pedzoo.models.zoo.loading import config_of, load
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import scenario_spec
from pedzoo.sim.scenario import Scenario


class Inside(NamedTuple):
    """The bytes in a container, and what makes a ``whole`` one of such bytes, with sums and lengths."""

    content: bytes
    whole: Callable[[bytes], bytes]


class Reader(NamedTuple):
    """Reads a file of some name, or refuses it by `UserError`; ``examples`` are contents that it takes."""

    file: str
    read: Callable[[Path], object]
    examples: list[bytes]
    inside: Inside | None = None


_pixels = np.where(np.arange(256).reshape(16, 16) % 16 < 12, 255, 0).astype(np.uint8)
PICTURES = [cv2.imencode(kind, _pixels)[1].tobytes() for kind in (".png", ".pgm", ".jpg", ".bmp")]


def _png(content: bytes) -> bytes:
    """Return a PNG of a header of 13 bytes and the rows behind it."""
    parts = (b"IHDR", content[:13]), (b"IDAT", zlib.compress(content[13:])), (b"IEND", b"")
    made = (struct.pack(">I", len(data)) + kind + data for kind, data in parts)
    sums = (struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(part + check for part, check in zip(made, sums, strict=True))


_ROWS = b"".join(b"\0" + row.tobytes() for row in _pixels)
PIXELS = Inside(struct.pack(">IIBBBBB", 16, 16, 8, 0, 0, 0, 0) + _ROWS, _png)

_WALKS = [(frame, agent, 0.4 * frame + agent, 1.5 * agent) for frame in range(12) for agent in range(3)]
TRACKS = [
    "".join(f"{frame}\t{agent}\t{x:.3f}\t{y:.3f}\n" for frame, agent, x, y in _WALKS).encode(),
    b"x,y,frame,agent\n" + "".join(f"{x},{y},{frame},{agent}\n" for frame, agent, x, y in _WALKS).encode(),
]

_SGAN = SGAN.of(encoder_dim=4, decoder_dim=6, noise_dim=2, mlp_dim=4, embedding_dim=4)
WEIGHTS = save(_SGAN.state_dict(), {"config": json.dumps(config_of(_SGAN))})
_END = 8 + int.from_bytes(WEIGHTS[:8], "little")
HEADER = Inside(WEIGHTS[8:_END], lambda header: struct.pack("<Q", len(header)) + header + WEIGHTS[_END:])

_STATE = {f"generator.{key}": value for key, value in _SGAN.state_dict().items()}
torch.save({"pedzoo": config_of(_SGAN), "state_dict": _STATE}, CHECKPOINT := io.BytesIO())
with zipfile.ZipFile(CHECKPOINT) as _archive:
    ENTRIES = {entry: _archive.read(entry) for entry in _archive.namelist()}
PICKLE = next(entry for entry in ENTRIES if entry.endswith("data.pkl"))


def _archive_of(content: bytes) -> bytes:
    """Return a checkpoint with another pickle."""
    with zipfile.ZipFile(target := io.BytesIO(), "w") as archive:
        for entry, other in ENTRIES.items():
            archive.writestr(entry, content if entry == PICKLE else other)
    return target.getvalue()


def _files(folder: str, pattern: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted(shipped(folder).glob(pattern))[:3]]


ROS = b"image: plan.png\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
ROS += b"negate: 0\n"
JOURNAL = b"".join(b'{"unit": "%d", "rows": [{"n": %d}]}\n' % (one, one) for one in range(4))
PEOPLE = b"""map: flat
speed: 1.2
people:
- {from: [-3, 0], to: [3, 0], speed: 1.1}
- {from: [3, 0.5], to: [-3, 0]}
"""
POLICIES = [b"orca:radius=0.2,dt=0.4", b"orca:share=0.3+social_force:tau=0.5", b"go_to_goal:safety=true"]
SCENES = [b"door:width=0.9,people=4", b"circle:people=6", b"goals:map=flat,people=5", b"queue"]


def _ros(path: Path) -> object:
    path.with_name("plan.png").write_bytes(PICTURES[0])
    return read_ros(path)


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="replace")


def _own(path: Path) -> object:
    return OwnFiles(["people.csv"], 0.4, homography=str(path))


def _people(path: Path) -> object:
    return build(SCENARIOS, scenario_spec(str(path)), Scenario)


READERS = {
    "tracks": Reader("people.csv", lambda path: Tracks.read(path).resampled(0.4), TRACKS),
    "homography": Reader("H.txt", _own, [b"1 0 2\n0 1 3\n0 0.001 1\n"]),
    "ros": Reader("map.yaml", _ros, [ROS]),
    "image": Reader("plan.png", lambda path: read_image(path, 0.05), PICTURES, PIXELS),
    "igibson": Reader("floor_trav_0.png", read_igibson, PICTURES[:1], PIXELS),
    "card": Reader("card.yaml", read_card, _files("checkpoints", "sgan*.zara1/card.yaml")),
    "safetensors": Reader("sgan.safetensors", lambda path: load(str(path)), [WEIGHTS], HEADER),
    "checkpoint": Reader(
        *("sgan.ckpt", lambda path: load(str(path)), [CHECKPOINT.getvalue()]),
        Inside(ENTRIES[PICKLE], _archive_of),
    ),
    "config": Reader("own.yaml", load_config, _files("configs", "*.yaml")),
    "journal": Reader("parts", Journal, [JOURNAL]),
    "policy": Reader("policy", lambda path: load_policy(_text(path)), POLICIES),
    "people": Reader("mine.yaml", _people, [PEOPLE]),
    "scenario": Reader("scenario", lambda path: build(SCENARIOS, _text(path), Scenario), SCENES),
}


_BYTES = (b"", b"\0", b"\xff\xfe", b"\n", b"\x1b[2J", b"\xf0\x9f\x9a\xb6", b"'", b'"', b",", b":", b"+", b"=")
_NUMBERS = (b"nan", b"-inf", b"1e300", b"-1", b"0", b"0x10", b"1e-320", b"9" * 40, b"1" * 5000, b"2147483648")
_YAML = (b"no", b"null", b"2026-11-99", b"*a", b"&a [*a]", b"[" * 50, b"{" * 50, b"[]", b"{}", b"1_0")
_ORDERS = (b"!!python/name:os.system", b"/dev/zero", b"../../etc/passwd", b"x.py:C", b"%s", b"~nobody/x")

ODD = (*_BYTES, *_NUMBERS, *_YAML, *_ORDERS)
"""What is put between, or in the place of a word."""

SECONDS, MEMORY = 1.0, 1e9
"""Of the processor, and bytes more than before, that a reader may take, once it is warm."""

HANGS = 30
"""Seconds of the processor after which a reader is stopped."""

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_FILES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.truncate")
_DEEDS = (*_FILES, "subprocess.Popen", "os.system", "os.exec", "os.fork", "os.posix_spawn", "socket.connect")


class Hangs(BaseException):
    """A reader was stopped; no reader catches this."""


def warm(reader: Reader, folder: Path) -> None:
    """Read the sound examples in an empty folder, with all the imports that this takes."""
    path = folder / reader.file
    for content in reader.examples:
        path.write_bytes(content)
        reader.read(path)
    if reader.inside:
        path.write_bytes(reader.inside.whole(reader.inside.content))
        reader.read(path)
    for file in folder.iterdir():
        file.unlink()


def content_of(reader: Reader, draw: np.random.Generator) -> bytes:
    """Return a sound example with mistakes; half of the containers have theirs inside."""
    if reader.inside and draw.random() < 0.5:
        return reader.inside.whole(mistaken(reader.inside.content, draw))
    return mistaken(reader.examples[draw.integers(len(reader.examples))], draw)


def mistaken(content: bytes, draw: np.random.Generator) -> bytes:
    """Return a content with one to four mistakes, mostly one: odd words, cuts, repeats, other bytes."""
    for _ in range(min(4, draw.geometric(0.6))):
        begin, end = sorted(draw.integers(0, len(content) + 1, 2).tolist())
        end = min(end, begin + int(draw.integers(1, 40)))
        odd = ODD[draw.integers(len(ODD))]
        words = [*re.finditer(rb"[\w.-]+", content[begin : begin + 100])]
        word = (begin + words[0].start(), begin + words[0].end()) if words else (len(content),) * 2
        other = words[draw.integers(len(words))].group() if words else odd
        changes = (
            *((begin, end, b""), (end, begin, b""), (begin, end, draw.bytes(end - begin)), (begin, end, odd)),
            *((begin, begin + 1, draw.bytes(1)), (*word, other), (*word, odd), (*word, odd)),
            (begin, len(content), b""),
        )
        first, last, put = changes[draw.integers(len(changes))]
        content = content[:first] + put + content[last:]
    return content


def wrong_of(reader: Reader, content: bytes, folder: Path) -> str | None:
    """Return what is wrong: a reader should read a content, or refuse it in words, and do nothing else.

    The folder is empty before and afterwards.
    """
    path = folder / reader.file
    path.write_bytes(content)
    wrong, now, most, began = None, *_memory(), time.process_time()
    with warnings.catch_warnings(action="ignore"), _watched(folder) as done:
        try:
            reader.read(path)
        except UserError as error:
            wrong = f"a long message: {len(str(error))} signs" if len(str(error)) > 5000 else None
        except (Exception, Hangs) as error:  # that is what is looked for
            wrong = f"{type(error).__name__}: {str(error)[:200]}"
    seconds, (_, peak) = time.process_time() - began, _memory()
    done += [file.name for file in folder.iterdir() if file.name not in (reader.file, "plan.png")]
    for file in folder.iterdir():
        file.unlink()
    if done:
        return f"did more than read: {done[:5]}"
    if peak > most and peak - now > MEMORY:
        return f"took memory: {peak - now:,} bytes"
    return f"took time: {seconds:.1f} s" if seconds > SECONDS else wrong


def _memory() -> tuple[int, int]:
    """Return the bytes that this process has, and the most that it ever had; elsewhere nobody counts."""
    if sys.platform != "linux":
        return 0, 0
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


_heard: list[str] | None = None


@cache
def _listen() -> None:
    """Let this process write down what it does to files, programs and servers, while it is `_watched`."""

    def hear(event: str, values: tuple[Any, ...]) -> None:
        if _heard is None:
            return
        writes = event == "open" and isinstance(values[0], str) and (values[2] or 0) & _WRITING
        if (writes or event in _DEEDS) and "__pycache__" not in str(values[0]):
            _heard.append(f"{event} {str(values[0])[-200:]}")

    sys.addaudithook(hear)


@contextmanager
def _watched(folder: Path) -> Iterator[list[str]]:
    """Yield a list that gets what is done outside a folder; stop what hangs."""
    global _heard
    _listen()
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    _heard, done = [], []
    try:
        yield done
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        heard, _heard = _heard, None
        done += [deed for deed in heard if str(folder) not in deed]


def _stop(number: int, frame: FrameType | None) -> None:
    raise Hangs(f"more than {HANGS} s")


CORPUS = Path(__file__).parents[1] / "corpus"

IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where files of inputs are: a disk would do nothing but wait for each of them."""

QUICK = settings(
    max_examples=40,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    derandomize=True,
)


@pytest.mark.parametrize("kind", ["mistakes", "any bytes"])
@pytest.mark.parametrize("name", READERS)
def test_contents_are_read_or_refused_in_words(name: str, kind: str, tmp_path) -> None:
    reader = READERS[name]
    warm(reader, tmp_path)
    contents = st.one_of(st.binary(max_size=300), st.text(max_size=100).map(str.encode), st.sampled_from(ODD))
    if kind == "mistakes":
        contents = st.integers(0, 2**63 - 1).map(lambda seed: content_of(reader, np.random.default_rng(seed)))

    @QUICK
    @given(contents)
    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder:
            assert wrong_of(reader, content, Path(folder)) is None

    check()


@pytest.mark.parametrize("file", sorted(CORPUS.glob("*-*")), ids=lambda file: file.name)
def test_what_was_wrong_once_is_right(file: Path, tmp_path) -> None:
    reader = READERS[file.name.partition("-")[0]]
    warm(reader, tmp_path)
    assert wrong_of(reader, file.read_bytes(), tmp_path) is None


@pytest.mark.parametrize(
    ("read", "wrong"),
    [
        (lambda path: path.with_name("more").write_bytes(b""), "did more than read"),
        (lambda path: path.parents[1].joinpath("outside").mkdir(), "did more than read"),
        (lambda path: int(path.read_bytes()), "ValueError"),
        (lambda path: path.read_bytes(), None),
    ],
)
def test_what_a_reader_may_not_do_is_noticed(
    read: Callable[[Path], object], wrong: str | None, tmp_path
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    found = wrong_of(Reader("file", read, []), b"", folder)
    assert (found and found.partition(":")[0]) == wrong
