"""Jobs in actors of a Ray cluster, which TorchRL's Ray collector starts and listens to."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import Any

import ray  # pyright: ignore[reportMissingImports]  # optional
import torch
from ray.exceptions import RayError  # pyright: ignore[reportMissingImports]
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.eval.jobs import JobEnv, packed
from pedzoo.eval.shares import Shares


def outcomes(
    jobs: Sequence[Any], work: Callable[[Any], Any], groups: Sequence[Sequence[int]], workers: int
) -> Generator[Tensor, None, None]:
    """Yield what became of each job: bytes (N,), a pickled `pedzoo.eval.jobs.Outcome`.

    Raises:
        UserError: Jobs that cannot be pickled, or more workers than the cluster has processors.
        RuntimeError: An actor died.
    """
    sent = packed(jobs, work, None)
    with _cluster(workers):
        collector = _collector(sent, groups, workers, len(jobs))
        try:
            frames = iter(collector)
            for _ in jobs:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # of a policy without weights
                    frame = next(frames)
                yield frame["next", "outcome"][0]
        except RayError as error:
            raise RuntimeError(f"a Ray worker died: {error}") from error
        finally:
            collector.shutdown()


def _collector(sent: Any, groups: Sequence[Sequence[int]], workers: int, jobs: int) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deprecated bases and of a policy without weights
        from torchrl.collectors.distributed import RayCollector

        shares = ray.remote(num_cpus=0)(Shares).remote(groups, [0] * len(groups), nullcontext())
        return RayCollector(
            [partial(JobEnv, sent, partial(_take, shares))] * workers,
            frames_per_batch=1,
            total_frames=jobs + 1,  # at the end it would wait for all workers, and they wait for jobs
            collector_class="single",  # pyright: ignore[reportArgumentType]  # its annotation is too narrow
            collector_kwargs=[{"use_buffers": False} for _ in range(workers)],
            remote_configs=[{"num_cpus": 1}] * workers,
            weight_sync_schemes={},
            device=torch.device("cpu"),
        )


def _take(shares: Any, group: int | None) -> tuple[int, int] | None:
    return ray.get(shares.take.remote(group))


@contextmanager
def _cluster(workers: int) -> Iterator[None]:
    """Use the cluster there is, or start one on this machine for the time."""
    own = not ray.is_initialized()
    if own:
        quiet = {"log_to_driver": False, "logging_level": "error"}
        try:
            ray.init(address="auto", **quiet)
        except ConnectionError:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
    try:
        processors = int(ray.cluster_resources().get("CPU", 0))
        if processors < workers:
            raise UserError(f"workers {workers}: the Ray cluster has {processors} processors")
        yield
    finally:
        if own:
            ray.shutdown()
