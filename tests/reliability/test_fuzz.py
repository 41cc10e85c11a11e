"""Hostile contents for every reader: sound ones with mistakes, any bytes, and what was wrong once."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.hostile import ODD, content_of, outcome, warm
from helpers.readers import READERS, Reader
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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


def test_contents_with_mistakes_are_read_or_refused_in_words(name: str) -> None:
    @QUICK
    @given(st.integers(0, 2**63 - 1))
    def check(seed: int) -> None:
        content = content_of(READERS[name], np.random.default_rng(seed))
        with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder:
            assert outcome(READERS[name], content, Path(folder)).wrong is None

    check()


def test_any_bytes_are_read_or_refused_in_words(name: str) -> None:
    @QUICK
    @given(st.one_of(st.binary(max_size=300), st.text(max_size=100).map(str.encode), st.sampled_from(ODD)))
    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder:
            assert outcome(READERS[name], content, Path(folder)).wrong is None

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
