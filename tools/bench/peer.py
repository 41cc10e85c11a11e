"""Other programs, timed in turns with ours: scripts in processes and environments of their own.

Licences and dependencies of other programs stay out of pedzoo that way. A peer is a script that answers lines
of JSON on its standard input with lines of JSON on its standard output; ``peers/`` has examples and the loop
that they share. It is asked twice:

* ``{"cases": [...], "threads": 1}`` with the scenes that we measure (see `Scenes`); it answers
  ``{"name", "versions": {...}, "cases": [{"name", "scenes", "people", "step_seconds", "note"}, ...]}`` with
  what it can do of the same sizes;
* ``{"run": i, "seconds": s}``: it works on the i-th of its cases for about s seconds and answers
  ``{"agent_steps_per_s": x}``.

What goes wrong it answers with ``{"error": "..."}``.
"""

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
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from tools.bench.section import Settings
from tools.bench.turns import Side

PATIENCE = 600.0
"""Seconds that a peer may take beyond the time that it is to work: it builds its scenes in its first turn."""


class Scenes(NamedTuple):
    """Scenes of one size, for peers to start from.

    Attributes:
        section: The benchmark that asks.
        scenes: How many.
        people: In each.
        orca: ORCA's constants, by RVO2's names.
        walls: Polygons of the walls, as lists of points, walls to the left; the same for all scenes.
        position: (B, A, 2) as lists, metres.
        velocity: Of every person (B, A, 2), m/s.
        preferred: The velocity that they want (B, A, 2), m/s.
        top_speed: Of every person (B, A), m/s.
    """

    section: str
    scenes: int
    people: int
    orca: dict[str, Any]
    walls: list[Any]
    position: list[Any]
    velocity: list[Any]
    preferred: list[Any]
    top_speed: list[Any]


class PeerCase(NamedTuple):
    """Something that a peer can be timed at.

    Attributes:
        peer: The peer's name.
        name: What it does.
        scenes: How many.
        people: In each.
        step_seconds: Simulated seconds of one agent-step.
        note: What its numbers include.
        side: Does it for some time.
    """

    peer: str
    name: str
    scenes: int
    people: int
    step_seconds: float
    note: str
    side: Side

    @property
    def title(self) -> str:
        """What its row is called."""
        return f"{self.peer}, {self.name}"

    @property
    def metric(self) -> str:
        """What ratios to it are called."""
        return f"times_{self.peer}_{self.name}".lower().replace(" ", "_")


class Peer:
    """A running script; close it, or use `running`."""

    def __init__(
        self,
        script: Path,
        python: str,
        threads: int,
        patience: float = PATIENCE,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Start it.

        Args:
            script: What it runs.
            python: The interpreter; this one if empty.
            threads: How many it shall use.
            patience: Seconds that an answer may take beyond the time that it is to work.
            environment: Variables that it gets beside those of this process.

        Raises:
            UserError: There is no such script or interpreter.
        """
        check(script, python)
        self.script, self.patience, self.threads = script, patience, threads
        self.versions: dict[str, str] = {}
        self._complaints = tempfile.TemporaryFile()
        one = {name: str(threads) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
        command = [python or sys.executable, str(script)]
        pipe = subprocess.PIPE
        try:
            self._process = subprocess.Popen(
                command,
                stdin=pipe,
                stdout=pipe,
                stderr=self._complaints,
                text=True,
                env=os.environ | one | dict(environment or {}),
            )
        except OSError as error:
            self._complaints.close()
            raise UserError(f"--peer_python {python!r} does not start: {error.strerror}") from error
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def close(self) -> None:
        """End it, whatever it is doing."""
        self._process.kill()
        self._process.wait()
        self._listener.join(timeout=5.0)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe:
                try:
                    pipe.close()
                except BrokenPipeError:  # a question that it did not read
                    pass
        self._complaints.close()

    def cases(self, scenes: Sequence[Scenes]) -> list[PeerCase]:
        """Return what it can do of the sizes of ``scenes``.

        Raises:
            UserError: It died, was silent for too long, complained, or gave no such answer.
        """
        question = {"cases": [each._asdict() for each in scenes], "threads": self.threads}
        answer = self._ask(question, "its cases", self.patience)
        try:
            self.versions = {str(key): str(value) for key, value in answer["versions"].items()}
            return [
                PeerCase(
                    str(answer["name"]), str(case["name"]), int(case["scenes"]), int(case["people"]),
                    float(case["step_seconds"]), str(case["note"]), self._side(number, str(case["name"])),
                )
                for number, case in enumerate(answer["cases"])
            ]  # fmt: skip
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise self._refused(
                f"gave cases that are none ({error!r}): {json.dumps(answer)[:200]}"
            ) from error

    def _side(self, number: int, name: str) -> Side:
        def side(seconds: float) -> float:
            question = {"run": number, "seconds": seconds}
            answer = self._ask(question, f"{name!r} for {seconds:g} s", seconds + self.patience)
            speed = answer.get("agent_steps_per_s")
            if not isinstance(speed, int | float) or not speed > 0:
                raise self._refused(f"gave no agent_steps_per_s for {name!r}: {json.dumps(answer)[:200]}")
            return float(speed)

        return side

    def _ask(self, question: dict[str, Any], what: str, patience: float) -> dict[str, Any]:
        # a peer that does not read must not keep us from looking at the clock
        threading.Thread(target=self._tell, args=(json.dumps(question) + "\n",), daemon=True).start()
        try:
            line = self._lines.get(timeout=patience)
        except queue.Empty:
            self._process.kill()
            raise self._refused(f"did not answer within {patience:g} s when asked for {what}") from None
        if line is None:
            self._lines.put(None)  # the next question need not wait for it
            code = self._process.wait()
            raise self._refused(f"ended with exit code {code} when asked for {what}")
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            answer = None
        if not isinstance(answer, dict):
            self._process.kill()
            raise self._refused(f"printed {line.strip()[:100]!r} in place of a JSON object for {what}")
        if "error" in answer:
            raise self._refused(f"cannot do {what}: {answer['error']}")
        return answer

    def _tell(self, line: str) -> None:
        assert self._process.stdin
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError):
            pass  # it has ended or was closed, which the caller will see when it waits for an answer

    def _listen(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def _refused(self, what: str) -> UserError:
        self._complaints.seek(0)
        said = self._complaints.read().decode(errors="replace").strip().splitlines()[-3:]
        message = f"; it said: {' / '.join(line.strip() for line in said)}" if said else ""
        return UserError(f"peer {self.script.name} {what}{message} (its interpreter: --peer_python)")


def check(script: Path, python: str) -> None:
    """Raise the error that a script or an interpreter gives which is not there."""
    if not script.is_file():
        known = "tools/bench/peers/vmas_navigation.py"
        raise UserError(f"no peer {str(script)!r}: expected a script such as {known}")
    if python and not shutil.which(python):
        raise UserError(f"--peer_python {python!r} does not start: expected an interpreter of Python")


@contextmanager
def running(settings: Settings) -> Iterator[list[Peer]]:
    """Start the peers of a run, and end them after the block."""
    with ExitStack() as stack:
        peers = []
        folders = {"CROWDNAV": str(settings.crowdnav.resolve())} if settings.crowdnav else {}
        for script in settings.peers:
            peer = Peer(script, settings.peer_python, settings.threads, environment=folders)
            stack.callback(peer.close)
            peers.append(peer)
        yield peers
