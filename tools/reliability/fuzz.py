"""Fuzzing of all readers: by one command, for hours, going on where it was.

    python -m tools.reliability.fuzz --inputs 100000

Input ``i`` of a reader is the same every time. What is wrong is kept in ``tests/corpus``.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import tempfile
from pathlib import Path

import numpy as np

from pedzoo.core.paths import write_whole
from tools.reliability.hostile import complaint, mistaken, warm
from tools.reliability.readers import READERS

CORPUS = Path(__file__).parents[2] / "tests" / "corpus"
STATE = Path("fuzz.json")


def content_of(reader: str, number: int) -> bytes:
    """Return the input of that number."""
    draw = np.random.default_rng([number, *reader.encode()])
    examples = READERS[reader].examples()
    return mistaken(examples[draw.integers(len(examples))], draw)


def main() -> None:
    """Go on until every reader has had as many inputs as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="for each reader")
    parser.add_argument("--readers", nargs="*", default=list(READERS), choices=list(READERS))
    options = parser.parse_args()
    state = json.loads(STATE.read_text()) if STATE.is_file() else {}
    with tempfile.TemporaryDirectory(dir=".") as folder:
        for name in options.readers:
            warm(READERS[name], Path(folder))
            done = state.setdefault(name, {"inputs": 0, "complaints": {}})
            while done["inputs"] < options.inputs:
                number = done["inputs"]
                content = content_of(name, number)
                with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
                    wrong = complaint(READERS[name], content, Path(folder))
                done["inputs"] += 1
                if wrong:
                    done["complaints"][wrong.partition(":")[0]] = wrong
                    digest = hashlib.sha256(content).hexdigest()[:12]
                    write_whole(CORPUS / f"{name}-{digest}", content)
                    print(f"{name} {number}: {wrong}", flush=True)
                if wrong or done["inputs"] % 1000 == 0 or done["inputs"] == options.inputs:
                    write_whole(STATE, f"{json.dumps(state, indent=1)}\n".encode())
            print(
                f"{name}: {done['inputs']} inputs, {len(done['complaints'])} kinds of complaints", flush=True
            )


if __name__ == "__main__":
    main()
