"""Jobs done in this process, in several processes of this machine, or on a Ray cluster."""

import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from pickle import PicklingError
from reprlib import repr as short_repr
from types import ModuleType
from typing import Any, Literal, TypeVar, get_args

import cloudpickle
import torch

from pedzoo.core.errors import UserError, at_least_one, need, unknown

J = TypeVar("J")
R = TypeVar("R")
Backend = Literal["processes", "ray"]

_warned: dict[Any, Any] = {}  # warnings of jobs that have been shown, as Python keeps them for a module


def finished(
    jobs: Sequence[J],
    work: Callable[[J], R],
    workers: int = 1,
    backend: Backend = "processes",
    group: Callable[[J], Hashable] | None = None,
) -> Generator[tuple[int, R], None, None]:
    """Do all jobs, each once, and yield the number and result of each as soon as it is there.

    A job has one thread of torch. So results are equal to the bit for any number of workers, as long as a job
    draws random numbers from seeds that it brings, and sets modes that it needs, as that without gradients.
    Its warnings are given in the caller's process. Closing the iterator, an error and Ctrl-C end all workers.

    Args:
        jobs: What to do; taken in this order. Must be picklable.
        work: What to do with a job; what it returns must be picklable. It and the jobs may be defined in a
            script, which needs no ``if __name__ == "__main__"`` for it, or in a notebook.
        workers: Processes or Ray actors, at most one for each job. Each takes seconds to start. With one,
            ``processes`` stays in the caller's own.
        backend: ``processes`` of this machine, or ``ray``, whose machines need pedzoo and the files that jobs
            read. It is the cluster of this process, of ``RAY_ADDRESS`` or of this machine; without any, one
            is started for the time.
        group: Jobs for which it returns the same share something that takes time to prepare. They come one
            after the other, and stay with one worker as long as others have something to do.

    Raises:
        UserError: No such backend or number of workers, Ray is absent or its cluster too small, or something
            cannot be sent to another process. This and any other error of a job is raised as it is.
        RuntimeError: A worker was killed.
    """
    if backend not in get_args(Backend):
        raise unknown("backend", backend, get_args(Backend))
    workers = min(at_least_one("workers", workers), len(jobs))
    if backend == "ray":
        need("ray", "the backend ray")
    queue = JobQueue(range(len(jobs)) if group is None else [group(job) for job in jobs])
    if jobs and (workers > 1 or backend == "ray"):
        return _there(jobs, work, queue, workers, _processes if backend == "processes" else _ray_actors)
    return _here(jobs, work, queue)


class JobQueue:
    """Hands out jobs: no worker waits while there is work, and jobs of a group stay together.

    A worker goes on with its group, then begins the first one that no worker has begun. If all are begun, it
    helps with the group that has most left.
    """

    def __init__(self, keys: Sequence[Hashable]) -> None:
        """Take the key of each job's group; groups come in the order in which keys are first seen."""
        self._left: dict[Hashable, list[int]] = {key: [] for key in keys}
        self._begun: set[Hashable] = set()
        for number, key in enumerate(keys):
            self._left[key].append(number)

    def take(self, last: Hashable = None) -> tuple[int, Hashable] | None:
        """Return the next job and its group for a worker whose last one was of ``last``; None at the end."""
        if not self._left.get(last):
            fresh = (key for key in self._left if key not in self._begun)
            last = next(fresh, max(self._left, key=lambda key: len(self._left[key]), default=None))
        if not self._left.get(last):
            return None
        self._begun.add(last)
        return self._left[last].pop(0), last


def _here(jobs: Sequence[J], work: Callable[[J], R], queue: JobQueue) -> Generator[tuple[int, R], None, None]:
    last: Hashable = None
    while taken := queue.take(last):
        last = taken[1]
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            result = work(jobs[taken[0]])
        finally:
            torch.set_num_threads(threads)
        yield taken[0], result


def _there(
    jobs: Sequence[J], work: Callable[[J], R], queue: JobQueue, count: int, start: Callable[..., Any]
) -> Generator[tuple[int, R], None, None]:
    """Keep every worker busy, yield the results, show the jobs' warnings and raise their errors."""
    try:
        tasks = [cloudpickle.dumps((work, job)) for job in jobs]
    except (TypeError, AttributeError, PicklingError) as error:
        raise UserError(
            f"other processes cannot be sent these jobs or their function: {error}; use workers=1, or give "
            "them names and files in place of what is open or running"
        ) from error
    running: dict[Future[bytes], tuple[int, int, Hashable]] = {}

    def outcome(future: Future[bytes], worker: int, job: int) -> tuple[Any, Exception | None, list[Any]]:
        try:
            return cloudpickle.loads(future.result())
        except pool[worker].deaths as death:
            error = RuntimeError(
                f"worker {worker} of {count} is {pool[worker].death(death)} "
                f"(in job {job}, {getattr(jobs[job], 'label', short_repr(jobs[job]))}); "
                "if the memory was too small for so many at once, use fewer workers"
            )
            error.__cause__ = death
            return None, error, []

    with start(count) as pool:
        idle: list[tuple[int, Hashable]] = [(worker, None) for worker in range(count)]
        while idle:
            for worker, last in idle:
                if taken := queue.take(last):
                    running[pool[worker].submit(taken[0], tasks[taken[0]])] = worker, *taken
            ended = [(future, *running.pop(future)) for future in wait(running, None, FIRST_COMPLETED).done]
            idle = [(worker, group) for _, worker, _, group in ended]
            outcomes = [(job, *outcome(future, worker, job)) for future, worker, job, _ in ended]
            for job, result, error, warned in sorted(outcomes, key=lambda one: one[2] is not None):
                for text, category, file, line in warned:
                    warnings.warn_explicit(text, category, file, line, registry=_warned)
                if error is not None:
                    raise error
                yield job, cloudpickle.loads(result)


def _begin() -> None:
    """Prepare a worker; a process ends when its parent is gone."""
    torch.set_num_threads(1)
    if parent := parent_process():
        os.environ.pop("PYTHONSAFEPATH", None)  # it was for the start alone
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _do(number: int, task: bytes) -> bytes:
    """Do a job; return its pickled result, its error, and what it warned of: text, category, file, line."""
    result, error = b"", None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        try:
            try:
                work, job = cloudpickle.loads(task)
            except (ImportError, AttributeError) as absent:
                raise UserError(
                    f"a worker cannot load the jobs or their function: {absent}; define them in a file that "
                    "can be imported there, or in the script or notebook itself"
                ) from absent
            result = cloudpickle.dumps(work(job))
        except Exception as raised:  # the caller gets any error of a job
            error, note = raised, "".join(traceback.format_exception(raised)).rstrip()
            try:
                cloudpickle.loads(cloudpickle.dumps(error))
            except Exception:  # rebuilding an exception calls its class, which may raise anything
                error = RuntimeError(f"{type(error).__qualname__}: {error}")
            error.add_note(f"in job {number} in a worker:\n{note}")
    warned = [(str(one.message), one.category, one.filename, one.lineno) for one in caught]
    return cloudpickle.dumps((result, error, warned))


class _Process:
    """An executor with one spawned process: a forked one would inherit torch's threads."""

    deaths = BrokenProcessPool, SystemExit

    def __init__(self) -> None:
        with _starting():  # Python starts a process that cleans up after semaphores
            self.executor = ProcessPoolExecutor(1, get_context("spawn"), _begin)
        self.process: Any = None

    def submit(self, job: int, task: bytes) -> Future[bytes]:
        try:
            if self.process:
                return self.executor.submit(_do, job, task)
            known = set(active_children())
            with _starting():  # an interrupt waits until the process is known
                future = self.executor.submit(_do, job, task)
                self.process = next(iter(set(active_children()) - known), None)
        except BrokenProcessPool as error:  # it died while it had no job
            future = Future()
            future.set_exception(error)
        return future

    def death(self, error: BaseException) -> str:
        """Return how the process ended."""
        self.executor.shutdown()
        code = error.code if isinstance(error, SystemExit) else self.process and self.process.exitcode
        if isinstance(code, int) and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"gone with exit code {code}"


@contextmanager
def _processes(count: int) -> Iterator[list[_Process]]:
    """Yield executors of one process each: each job goes to a worker that is chosen here."""
    pool: list[_Process] = []
    try:
        pool += [_Process() for _ in range(count)]
        yield pool
    except BaseException:  # what they do is not wanted any more
        for one in pool:
            if one.process:
                one.process.kill()
        raise
    finally:
        for one in pool:
            one.executor.shutdown(cancel_futures=True)
            if one.process:
                one.process.close()


@contextmanager
def _starting() -> Iterator[None]:
    """Let processes start with one thread, without the caller's script, folder and signals of a terminal."""
    given = {"PYTHONSAFEPATH": "1"} | {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS")}
    before, main = {name: os.environ.get(name) for name in given}, sys.modules["__main__"]
    os.environ |= given
    sys.modules["__main__"] = ModuleType("__main__")
    signals = set() if os.name == "nt" else {signal.SIGINT, signal.SIGHUP, signal.SIGUSR1}
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signals) if signals else None
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class _RayActor:
    """What runs on the cluster, perhaps on another machine."""

    def __init__(self, folder: str, path: Sequence[str]) -> None:
        _begin()
        if Path(folder).is_dir():
            os.chdir(folder)
        sys.path += [entry for entry in path if entry not in sys.path and Path(entry).exists()]

    def do(self, job: int, task: bytes) -> bytes:
        return _do(job, task)


class _RayWorker:
    def __init__(self, actor: Any, deaths: type[Exception]) -> None:
        self.actor, self.deaths = actor, deaths

    def submit(self, job: int, task: bytes) -> Future[bytes]:
        return self.actor.do.remote(job, task).future()

    def death(self, error: BaseException) -> str:
        return f"dead: {str(error).splitlines()[0]}"


@contextmanager
def _ray_actors(count: int) -> Iterator[list[_RayWorker]]:
    """Yield one actor for each worker, on the cluster there is, or on one that is started for the time."""
    import ray  # pyright: ignore[reportMissingImports]  # optional
    from ray.exceptions import RayError  # pyright: ignore[reportMissingImports]

    own = not ray.is_initialized()
    pool: list[_RayWorker] = []
    try:
        if own:
            quiet = {"log_to_driver": False, "logging_level": "error"}
            try:
                ray.init(address="auto", **quiet)
            except ConnectionError:
                os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
                ray.init(address="local", num_cpus=count, include_dashboard=False, **quiet)
        if (processors := int(ray.cluster_resources().get("CPU", 0))) < count:
            raise UserError(f"workers {count}: the Ray cluster has {processors} processors")
        actor, path = ray.remote(num_cpus=1)(_RayActor), [str(Path(entry).resolve()) for entry in sys.path]
        pool += [_RayWorker(actor.remote(os.getcwd(), path), RayError) for _ in range(count)]
        yield pool
    finally:
        for one in pool:
            ray.kill(one.actor)
        if own:
            ray.shutdown()
