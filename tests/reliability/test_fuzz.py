"""Hostile contents for every reader: sound ones with mistakes, any bytes, and what was wrong once."""

from __future__ import annotations

import os
import re
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.readers import READERS, Reader
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pedzoo.core.errors import UserError

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
    for content in reader.examples():
        path.write_bytes(content)
        reader.read(path)
    if reader.inside:
        path.write_bytes(reader.inside().whole(reader.inside().content))
        reader.read(path)
    for file in folder.iterdir():
        file.unlink()


def content_of(reader: Reader, draw: np.random.Generator) -> bytes:
    """Return a sound example with mistakes; half of the containers have theirs inside."""
    if reader.inside and draw.random() < 0.5:
        return reader.inside().whole(mistaken(reader.inside().content, draw))
    examples = reader.examples()
    return mistaken(examples[draw.integers(len(examples))], draw)


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


class Outcome(NamedTuple):
    """What a reader did: whether it read a content, and what is wrong with that, if anything."""

    read: bool
    wrong: str | None = None


def outcome(reader: Reader, content: bytes, folder: Path) -> Outcome:
    """Return how a reader takes a content: it should read it, or refuse it in words, and do nothing else.

    Args:
        reader: The reader.
        content: What its file has.
        folder: An empty folder for the file; it is empty again afterwards.
    """
    path = folder / reader.file
    path.write_bytes(content)
    result, now, most, began = Outcome(True), *_memory(), time.process_time()
    with warnings.catch_warnings(action="ignore"), _watched(folder) as done:
        try:
            reader.read(path)
        except UserError as error:
            long = f"a long message: {len(str(error))} signs" if len(str(error)) > 5000 else None
            result = Outcome(False, long)
        except (Exception, Hangs) as error:  # that is what is looked for
            result = Outcome(False, f"{type(error).__name__}: {str(error)[:200]}")
    seconds, (_, peak) = time.process_time() - began, _memory()
    done += [file.name for file in folder.iterdir() if file.name not in (reader.file, "plan.png")]
    for file in folder.iterdir():
        file.unlink()
    if done:
        return Outcome(result.read, f"did more than read: {done[:5]}")
    if peak > most and peak - now > MEMORY:
        return Outcome(result.read, f"took memory: {peak - now:,} bytes")
    return Outcome(result.read, f"took time: {seconds:.1f} s") if seconds > SECONDS else result


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


@pytest.fixture(params=READERS)
def name(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A reader that reads what is sound."""
    warm(READERS[request.param], tmp_path)
    return request.param


@pytest.mark.parametrize("kind", ["mistakes", "any bytes"])
def test_contents_are_read_or_refused_in_words(name: str, kind: str) -> None:
    reader = READERS[name]
    contents = st.one_of(st.binary(max_size=300), st.text(max_size=100).map(str.encode), st.sampled_from(ODD))
    if kind == "mistakes":
        contents = st.integers(0, 2**63 - 1).map(lambda seed: content_of(reader, np.random.default_rng(seed)))

    @QUICK
    @given(contents)
    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder:
            assert outcome(reader, content, Path(folder)).wrong is None

    check()


@pytest.mark.parametrize("file", sorted(CORPUS.glob("*-*")), ids=lambda file: file.name)
def test_what_was_wrong_once_is_right(file: Path, tmp_path: Path) -> None:
    warm(READERS[file.name.partition("-")[0]], tmp_path)
    assert outcome(READERS[file.name.partition("-")[0]], file.read_bytes(), tmp_path).wrong is None


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
    read: Callable[[Path], object], wrong: str | None, tmp_path: Path
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    found = outcome(Reader("file", read, list), b"", folder).wrong
    assert (found and found.partition(":")[0]) == wrong
