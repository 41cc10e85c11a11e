"""Many workers for a list of jobs: processes of this machine, or a Ray cluster."""

import warnings
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from itertools import chain
from reprlib import repr as short_repr
from typing import Any, Literal, TypeVar, get_args

import cloudpickle
import torch

from pedzoo.core.errors import at_least_one, need, unknown
from pedzoo.eval.workers.jobs import JobResult, packed

J = TypeVar("J")
R = TypeVar("R")
Backend = Literal["processes", "ray"]

_warned: dict[Any, Any] = {}  # the warnings that have been shown, as Python keeps them for a module


def finished(
    jobs: Sequence[J],
    work: Callable[[J], R],
    workers: int = 1,
    backend: Backend = "processes",
    group: Callable[[J], Hashable] | None = None,
) -> Generator[tuple[int, R], None, None]:
    """Do all jobs and yield the number and result of each as soon as it is there.

    Every job is done once, by one thread of torch (else sums would depend on the number of cores), under
    the caller's exploration type and gradient mode. So results are equal to the bit for any number of
    workers, as long as a job draws random numbers from seeds that it brings. A worker takes the next job
    when it has finished one; the warnings of a job are given in the caller's process. Closing the
    iterator, an error and Ctrl-C end all workers.

    Args:
        jobs: What to do; taken in this order. Must be picklable.
        work: What to do with a job; what it returns must be picklable. It and the jobs may be defined in a
            script, which needs no ``if __name__ == "__main__"`` for it, or in a notebook.
        workers: Processes or Ray actors, at most one for each job. Each takes seconds to start. With one,
            ``processes`` stays in the caller's own.
        backend: ``processes`` of this machine, or ``ray``: the cluster this process is connected to, else
            the one that ``RAY_ADDRESS`` names or that runs on this machine, else one that is started for
            the time. pedzoo and the files that jobs read must be on all its machines.
        group: Jobs for which it returns the same share something that takes time to prepare. They come one
            after the other, and stay with one worker as long as others have something to do. Without it
            every job stands alone.

    Yields:
        The number of a job and what ``work`` returned for it.

    Raises:
        UserError: No such backend or number of workers, Ray is absent or its cluster too small, or something
            cannot be sent to another process. This and any other error of a job is raised as it is.
        RuntimeError: A worker was killed.
    """
    if backend not in get_args(Backend):
        raise unknown("backend", backend, get_args(Backend))
    workers = at_least_one("workers", workers)
    if backend == "ray":
        need("ray", "the backend ray")
    groups = grouped(range(len(jobs)) if group is None else [group(job) for job in jobs])
    workers = min(workers, len(jobs))
    if not jobs or (workers == 1 and backend == "processes"):
        return _here(jobs, work, groups)
    return _there(jobs, work, groups, workers, backend)


def _here(
    jobs: Sequence[J], work: Callable[[J], R], groups: list[list[int]]
) -> Generator[tuple[int, R], None, None]:
    for number in chain.from_iterable(groups):
        with _one_thread():
            result = work(jobs[number])
        yield number, result


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _there(
    jobs: Sequence[J], work: Callable[[J], R], groups: list[list[int]], workers: int, backend: Backend
) -> Generator[tuple[int, R], None, None]:
    """Keep every worker busy, yield the results, show the jobs' warnings and raise their errors."""
    if backend == "ray":
        from pedzoo.eval.workers.ray_workers import RayActors as Pool
    else:
        from pedzoo.eval.workers.processes import Processes as Pool
    pool, shares = Pool(packed(jobs, work), workers), JobQueue(groups)
    running: dict[Future[bytes], tuple[int, int, int]] = {}

    def begin(worker: int, group: int | None) -> None:
        if taken := shares.take(group):
            running[pool.submit(worker, taken[0])] = worker, *taken

    def outcome(future: Future[bytes], worker: int, job: int) -> JobResult:
        try:
            return cloudpickle.loads(future.result())
        except pool.deaths as death:
            error = RuntimeError(
                f"worker {worker} of {workers} is {pool.death(worker, death)} "
                f"(in job {job}, {getattr(jobs[job], 'label', short_repr(jobs[job]))}); "
                "if the memory was too small for so many at once, use fewer workers"
            )
            error.__cause__ = death
            return JobResult(None, error)

    try:
        for worker in range(workers):
            begin(worker, None)
        while running:
            ended = [(future, *running.pop(future)) for future in wait(running, None, FIRST_COMPLETED).done]
            outcomes = [(outcome(future, worker, job), job) for future, worker, job, _ in ended]
            if all(each.error is None for each, _ in outcomes):
                for _, worker, _, group in ended:
                    begin(worker, group)
            for each, job in sorted(outcomes, key=lambda one: one[0].error is not None):
                for text, category, file, line in each.warned:
                    warnings.warn_explicit(text, category, file, line, registry=_warned)
                if each.error is not None:
                    raise each.error
                assert each.result is not None
                yield job, cloudpickle.loads(each.result)
    finally:
        pool.end()


class JobQueue:
    """Which job a worker does next: no worker waits while there is work, and jobs of a group stay together.

    A worker goes on with its group. When that is finished it begins the first group that no worker has
    begun. When there is none it helps with the group that has most left, and prepares once more what that
    group shares.
    """

    def __init__(self, groups: Sequence[Sequence[int]]) -> None:
        """Hand out the jobs of ``groups``: the numbers of the jobs of each."""
        self._groups = groups
        self._begun = [0] * len(groups)

    def take(self, group: int | None) -> tuple[int, int] | None:
        """Return the next job of a worker whose last one was of ``group``, and the job's group.

        Returns:
            None where all have been handed out.
        """
        left = [len(jobs) - begun for jobs, begun in zip(self._groups, self._begun, strict=True)]
        if group is None or not left[group]:
            untouched = (number for number, begun in enumerate(self._begun) if not begun)
            group = next(untouched, max(range(len(left)), key=left.__getitem__))
        if not left[group]:
            return None
        self._begun[group] += 1
        return self._groups[group][self._begun[group] - 1], group


def grouped(keys: Sequence[Hashable]) -> list[list[int]]:
    """Return the numbers of the jobs of each key, in the order in which the keys are first seen."""
    groups: dict[Hashable, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return list(groups.values())
