"""Jobs in processes of this machine, which TorchRL's asynchronous collector starts and listens to."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator, MutableSequence, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing import forkserver
from multiprocessing.process import BaseProcess
from reprlib import repr as short_repr
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from pedzoo.eval.collectors import RoomyCollector
from pedzoo.eval.jobs import JobEnv, packed
from pedzoo.eval.shares import Shares

# A fork server imports torch and TorchRL once (seconds); a worker forked from it is there in a tenth of one.
START = "forkserver" if sys.platform == "linux" else "spawn"
ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"
)


def outcomes(
    jobs: Sequence[Any], work: Callable[[Any], Any], groups: Sequence[Sequence[int]], workers: int
) -> Generator[Tensor, None, None]:
    """Yield what became of each job: bytes (N,), a pickled `pedzoo.eval.jobs.Outcome`.

    Raises:
        UserError: Jobs that cannot be pickled.
        RuntimeError: A worker died.
    """
    sent = packed(jobs, work, {**os.environ, **ONE_THREAD})
    context = multiprocessing.get_context(START)
    shares = Shares(groups, context.RawArray("l", len(groups)), context.Lock())
    doing = context.RawArray("l", [-1] * workers)
    others = multiprocessing.active_children()
    threads = torch.get_num_threads()
    collector = None

    def end() -> None:
        _end(collector.procs if collector is not None else [p for p in _children() if p not in others])

    atexit.register(end)  # an iterator that is never closed: Python waits for processes before it closes it
    try:
        with _starting(work):
            collector = RoomyCollector(
                [JobEnv] * workers,
                create_env_kwargs=[
                    {"sent": sent, "take": partial(_take, shares, doing, worker)} for worker in range(workers)
                ],
                frames_per_batch=1,
                total_frames=-1,
                use_buffers=False,  # a buffer would have to be as long as the longest outcome
                num_threads=threads,
                device="cpu",
            )
        frames = iter(collector)
        for _ in jobs:
            yield next(frames)["next", "outcome"][0]
    except (EOFError, OSError, RuntimeError, ValueError) as error:
        processes = [] if collector is None else collector.procs
        raise RuntimeError(_what_died(processes, doing, jobs) or str(error)) from error
    finally:
        end()
        atexit.unregister(end)
        if collector is not None:
            collector.shutdown(raise_on_error=False)
        torch.set_num_threads(threads)  # TorchRL leaves the number it finds fit


def _take(
    shares: Shares, doing: MutableSequence[int], worker: int, group: int | None
) -> tuple[int, int] | None:
    """Return the next job of a worker, and note it for the case that the worker dies."""
    taken = shares.take(group)
    doing[worker] = -1 if taken is None else taken[0]
    return taken


@contextmanager
def _starting(work: Callable[[Any], Any]) -> Iterator[None]:
    """Start processes as is best here, whatever the caller's process has chosen for itself.

    They do not run the caller's script (all that is needed of it travels by value), so that a script needs no
    ``if __name__ == "__main__"``.
    """
    main, method = sys.modules["__main__"], multiprocessing.get_start_method(allow_none=True)
    kept = {name: os.environ.get(name) for name in ONE_THREAD}
    sys.modules["__main__"] = ModuleType("__main__")
    multiprocessing.set_start_method(START, force=True)
    os.environ.update(ONE_THREAD)
    try:
        if START == "forkserver":
            _run_fork_server(getattr(work, "__module__", ""))
        yield
    finally:
        sys.modules["__main__"] = main
        multiprocessing.set_start_method(method, force=True)
        for name, value in kept.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _run_fork_server(module: str) -> None:
    """Run the server, unless it runs, deaf to Ctrl-C: the process that started the workers ends them.

    Returns when it is ready, which takes seconds. A worker asked for before would begin after Ctrl-C, look
    for what is gone by then, and complain.
    """
    own = [module] if module.startswith("pedzoo.") else []  # others' may start threads, which do not survive
    forkserver.set_forkserver_preload(["pedzoo.eval.collectors", "pedzoo.eval.jobs", *own])
    heard = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, heard)
    idle = multiprocessing.get_context(START).Process()
    idle.start()
    idle.join()


def _what_died(processes: Sequence[BaseProcess], doing: Sequence[int], jobs: Sequence[Any]) -> str:
    """Return the message about the first process that is dead, or nothing."""
    for number, process in enumerate(processes):
        try:
            code = process.exitcode
        except ValueError:  # TorchRL has ended and closed it because of another one
            continue
        if code is not None:
            how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"gone with exit code {code}"
            job = doing[number]
            where = f"job {job}, {short_repr(jobs[job])}" if job >= 0 else "no job"
            return (
                f"worker {number} of {len(processes)} is {how} (in {where}); "
                "if the memory was too small for so many at once, use fewer workers"
            )
    return ""


def _children() -> list[BaseProcess]:
    """Return the processes that TorchRL has started."""
    return [
        each for each in multiprocessing.active_children() if type(each).__module__.startswith("torchrl.")
    ]


def _end(processes: Sequence[BaseProcess]) -> None:
    """End workers at once: they hold nothing that is still wanted."""
    alive = set(processes) & set(multiprocessing.active_children())
    for process in alive:
        process.terminate()
    for process in alive:
        process.join(5)
        if process.is_alive():
            process.kill()
            process.join()
