"""Many workers for a list of jobs: TorchRL's collectors, over processes or over a Ray cluster."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import chain
from typing import Any, Literal, TypeVar, get_args

import cloudpickle
import torch
from torch import Tensor

from pedzoo.errors import UserError, unknown
from pedzoo.eval.shares import grouped

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
        workers: Processes or Ray actors, at most one for each job. With one, ``processes`` stays in the
            caller's own.
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
    if workers < 1:
        raise UserError(f"workers {workers}: expected at least 1")
    if backend == "ray" and find_spec("ray") is None:
        raise UserError("backend ray needs Ray: pip install ray (or use the backend processes)")
    groups = grouped(range(len(jobs)) if group is None else [group(job) for job in jobs])
    workers = min(workers, len(jobs))
    if not jobs or (workers == 1 and backend == "processes"):
        return _here(jobs, work, groups)
    if backend == "ray":
        from pedzoo.eval.ray_workers import outcomes
    else:
        from pedzoo.eval.processes import outcomes
    return _opened(outcomes(jobs, work, groups, workers))


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


def _opened(outcomes: Generator[Tensor, None, None]) -> Generator[tuple[int, Any], None, None]:
    """Yield the results in ``outcomes``, show the jobs' warnings and raise their errors."""
    try:
        for data in outcomes:
            outcome = cloudpickle.loads(data.numpy().tobytes())
            for text, category, file, line in outcome.warned:
                warnings.warn_explicit(text, category, file, line, registry=_warned)
            if outcome.error is not None:
                raise outcome.error
            yield outcome.job, outcome.result
    finally:
        outcomes.close()  # now, and not when the error's traceback is forgotten
