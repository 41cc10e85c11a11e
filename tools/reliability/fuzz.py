"""Fuzzing of all readers. Input ``i`` of a reader is the same every time.

What is wrong is kept in ``tests/corpus``.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import resource
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pedzoo.core.paths import write_atomically
from tools.reliability.hostile import MEMORY, Outcome, content_of, outcome, warm
from tools.reliability.readers import READERS

CORPUS = Path(__file__).parents[2] / "tests" / "corpus"

IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where files of inputs are: a disk would do nothing but wait for each of them."""


def go_on(name: str, inputs: int, done: dict[str, Any], save: Callable[[], None]) -> None:
    """Give a reader inputs until it had so many; forget earlier complaints that are mended.

    Args:
        name: The reader's.
        inputs: How many are wanted.
        done: What was done before; it grows. Complaints are by the file of the corpus.
        save: Called from time to time, and at the end.
    """
    reader, quiet = READERS[name], io.StringIO()

    def tried(content: bytes) -> Outcome:
        quiet.truncate(quiet.seek(0))
        with contextlib.redirect_stderr(quiet), contextlib.redirect_stdout(quiet):
            return outcome(reader, content, Path(folder))

    with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder, _little_memory():
        warm(reader, Path(folder))
        before = done.get("complaints", {})
        again = {
            file: tried((CORPUS / file).read_bytes()).wrong for file in before if (CORPUS / file).is_file()
        }
        done["complaints"] = {file: wrong for file, wrong in again.items() if wrong}
        for key in ("inputs", "read"):
            done.setdefault(key, 0)
        while done["inputs"] < inputs:
            content = content_of(reader, np.random.default_rng([done["inputs"], *name.encode()]))
            read, wrong = tried(content)
            done["inputs"] += 1
            done["read"] += read
            if wrong:
                file = f"{name}-{hashlib.sha256(content).hexdigest()[:12]}"
                done["complaints"][file] = wrong
                write_atomically(CORPUS / file, content)
                print(f"{file}: {wrong}", flush=True)
            if wrong or done["inputs"] % 10_000 == 0:
                save()


@contextlib.contextmanager
def _little_memory() -> Any:
    """Let no reader take the memory of the machine."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 4 * int(MEMORY), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
