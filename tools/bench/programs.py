"""Programs that are timed: a commit of pedzoo or another simulator, each in a process of its own."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CASES = HERE / "cases.py"

PATIENCE = 600.0
"""Seconds that an answer may take beyond its turn: in its first turn a program builds and compiles."""


@dataclass(frozen=True)
class Case:
    """What a program can be timed at; see `tools.bench.peers.answering.TimedCase`."""

    program: Program
    number: int
    section: str
    name: str
    scenes: int
    people: int
    note: str

    def seconds(self, seconds: float) -> float:
        """Return the seconds of one step, from about so many seconds of steps; errors as of `Program.ask`."""
        answer = self.program.ask({"run": self.number, "seconds": seconds}, seconds + PATIENCE)
        return float(answer["seconds"])


class Program:
    """A script that answers as ``peers/answering.py`` says; close it at the end."""

    def __init__(self, name: str, script: Path, python: str = "", tree: Path | None = None) -> None:
        """Start it with one thread, by this or another interpreter, and a ``tree`` of pedzoo to import.

        Raises:
            UserError: There is no such script or interpreter.
        """
        if not script.is_file():
            raise UserError(f"no peer {str(script)!r}: expected a script such as tools/bench/peers/jaxnav.py")
        if python and not shutil.which(python):
            raise UserError(f"--peer_python {python!r} does not start: expected an interpreter of Python")
        self.name, self.script = name, script
        self.versions: dict[str, str] = {}
        threads = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        variables = os.environ | dict.fromkeys(threads, "1")
        if tree is not None:
            variables["PYTHONPATH"] = str(tree)
        self._stderr = tempfile.TemporaryFile()
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._stderr}
        command = [python or sys.executable, str(script)]
        self._process = subprocess.Popen(command, text=True, env=variables, **pipes)
        self._answers: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def close(self) -> None:
        """End it, whatever it is doing."""
        self._process.kill()
        self._process.communicate()
        self._stderr.close()

    def cases(self, sections: Mapping[str, Sequence[tuple[int, int]]]) -> list[Case]:
        """Return what it can do of sizes (scenes, people) by section; errors as of `ask`."""
        answer = self.ask({"sections": sections}, PATIENCE)
        self.versions = {str(key): str(value) for key, value in answer["versions"].items()}
        return [Case(self, number, **about) for number, about in enumerate(answer["cases"])]

    def ask(self, question: dict[str, Any], patience: float) -> dict[str, Any]:
        """Return the answer to a question.

        Raises:
            UserError: It ended, was silent for ``patience`` seconds, or answered with an error.
        """
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
            line = self._answers.get(timeout=patience)
        except (BrokenPipeError, queue.Empty):
            line = ""
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            answer = {"error": f"answered {line[:100]!r} within {patience:g} s"}
        if "error" in answer:
            self._stderr.seek(0)
            said = " / ".join(self._stderr.read().decode(errors="replace").split("\n")[-4:-1])
            raise UserError(f"{self.script.name} of {self.name}: {answer['error']} ({said[-300:]})")
        return answer

    def _listen(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._answers.put(line)
        self._answers.put("")


@contextmanager
def checkout(name: str) -> Iterator[Path]:
    """Give a temporary worktree of a commit, and remove it after the block; `UserError` of none."""
    with tempfile.TemporaryDirectory(prefix="bench_") as folder:
        tree = Path(folder).resolve() / "before"
        git("worktree", "add", "--detach", str(tree), git("rev-parse", "--verify", f"{name}^{{commit}}"))
        try:
            yield tree
        finally:
            git("worktree", "remove", "--force", str(tree))


def git(*words: str) -> str:
    """Return what git answers in this repository; `UserError` where it fails."""
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise UserError(f"git {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout.strip()
