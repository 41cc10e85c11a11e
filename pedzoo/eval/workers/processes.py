"""Workers that are processes of this machine. Each has its own executor, which gives it its own jobs."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

PATIENCE = 5.0
"""Seconds that a worker has to end in good order."""

_SAFE_PATH = "PYTHONSAFEPATH"

_payload = b""  # of a process


class Processes:
    """Processes that do jobs by number.

    Attributes:
        deaths: Exceptions of a future that say that its worker has died.
    """

    deaths = (BrokenProcessPool, SystemExit)

    def __init__(self, payload: bytes, count: int) -> None:
        """Take what `pedzoo.eval.workers.jobs.packed` returned; a process starts with its first job."""
        self._context = _Context()
        begin = payload, os.environ.get(_SAFE_PATH)
        with _signals_left():  # the first executor starts Python's process that cleans up after semaphores
            self._executors = [ProcessPoolExecutor(1, self._context, _begin, begin) for _ in range(count)]

    def submit(self, worker: int, job: int) -> Future[bytes]:
        """Return the future outcome of a job; the first jobs go to the workers in their order."""
        try:
            return self._executors[worker].submit(_do, job)
        except BrokenProcessPool as error:
            broken: Future[bytes] = Future()
            broken.set_exception(error)
            return broken

    def death(self, worker: int, error: BaseException) -> str:
        """Return how a worker ended."""
        self._executors[worker].shutdown()
        code = error.code if isinstance(error, SystemExit) else self._context.started[worker].exitcode
        if isinstance(code, int) and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"gone with exit code {code}"

    def end(self) -> None:
        """End all processes at once: their results are not wanted any more."""
        processes = [process for process in self._context.started if process.pid]
        for process in processes:
            process.terminate()
        late = threading.Timer(PATIENCE, lambda: [process.kill() for process in processes])
        late.start()
        for executor in self._executors:
            executor.shutdown(cancel_futures=True)
        late.cancel()
        late.join()
        for process in processes:
            process.close()


class _Process(SpawnProcess):
    """A process that does not run the caller's script, and leaves signals to the caller's process."""

    def start(self) -> None:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            with _signals_left():
                super().start()
        finally:
            sys.modules["__main__"] = main


@contextmanager
def _signals_left() -> Iterator[None]:
    """Start processes that leave to the caller's what a terminal or Slurm sends to all of them.

    Python starts them with code, and would look for its modules in the working directory first.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    signals = set() if os.name == "nt" else {signal.SIGINT, signal.SIGHUP, signal.SIGUSR1}
    heard = signal.pthread_sigmask(signal.SIG_BLOCK, signals) if signals else None
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before
        if heard is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, heard)


class _Context(SpawnContext):
    def __init__(self) -> None:
        self.started: list[_Process] = []

    def Process(self, *args: Any, **settings: Any) -> _Process:  # noqa: N802  # multiprocessing's name
        self.started.append(_Process(*args, **settings))
        return self.started[-1]


def _begin(payload: bytes, safe_path: str | None) -> None:
    """Prepare a worker; it ends when its parent is gone."""
    global _payload
    _payload = payload
    if safe_path is None:
        del os.environ[_SAFE_PATH]  # it is for the start alone
    threading.Thread(target=_follow_parent, daemon=True).start()
    for library in ("OMP", "MKL", "OPENBLAS"):
        os.environ[f"{library}_NUM_THREADS"] = "1"


@cache
def _worker() -> Any:
    """Return the worker; from now on the process ends in good order when it is terminated."""
    from pedzoo.eval.workers.jobs import Worker  # imports torch, which reads the variables above

    # not before: without a job there is nothing to end, and Python prints what is raised within an import
    signal.signal(signal.SIGTERM, _leave)
    return Worker(_payload)


def _do(job: int) -> bytes:
    return _worker().do(job)


def _leave(*_: Any) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the executor may send another one
    sys.exit()


def _follow_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE)
    os._exit(1)  # the signal came during a job, which it has ended, and the executor waits for the next one
