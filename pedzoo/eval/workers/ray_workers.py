"""Workers that are actors of a Ray cluster."""

import os
import sys
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import ray  # pyright: ignore[reportMissingImports]  # optional
from ray.exceptions import RayError  # pyright: ignore[reportMissingImports]

from pedzoo.core.errors import UserError
from pedzoo.eval.workers.jobs import Worker


class RayActors:
    """Actors that do jobs by number, with the same methods as `pedzoo.eval.workers.processes.Processes`."""

    deaths = (RayError,)

    def __init__(self, payload: bytes, count: int) -> None:
        """Use the cluster there is, or start one on this machine for the time.

        Raises:
            UserError: More workers than the cluster has processors.
        """
        self._own = not ray.is_initialized()
        if self._own:
            quiet = {"log_to_driver": False, "logging_level": "error"}
            try:
                ray.init(address="auto", **quiet)
            except ConnectionError:
                os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
                ray.init(address="local", num_cpus=count, include_dashboard=False, **quiet)
        self._actors: list[Any] = []  # Ray's types of actors differ from call to call
        if (processors := int(ray.cluster_resources().get("CPU", 0))) < count:
            self.end()
            raise UserError(f"workers {count}: the Ray cluster has {processors} processors")
        state = ray.put(payload), os.getcwd(), [str(Path(entry).resolve()) for entry in sys.path]
        self._actors = [ray.remote(num_cpus=1)(_Actor).remote(*state) for _ in range(count)]

    def submit(self, worker: int, job: int) -> Future[bytes]:
        """Return the future outcome of a job."""
        return self._actors[worker].do.remote(job).future()

    def death(self, worker: int, error: BaseException) -> str:
        """Return how a worker ended, for people."""
        return f"dead: {str(error).splitlines()[0]}"

    def end(self) -> None:
        """End all actors, and the cluster if it was started here."""
        for actor in self._actors:
            ray.kill(actor)
        if self._own:
            ray.shutdown()


class _Actor(Worker):
    def __init__(self, payload: bytes, folder: str, path: list[str]) -> None:
        super().__init__(payload)
        if Path(folder).is_dir():  # it may be on another machine
            os.chdir(folder)
        sys.path += [entry for entry in path if entry not in sys.path and Path(entry).exists()]
