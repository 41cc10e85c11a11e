"""What workers do in tests; without pytest, which would take them half a second to import."""

import multiprocessing
import os
import signal
import time
import warnings
from pathlib import Path
from typing import Any

import torch

from pedzoo.core.errors import UserError


def answer(job: tuple[int, str]) -> dict[str, Any]:
    """Say what a job sees, warn, and leave a semaphore, as tqdm does: its file goes when the process ends."""
    seed, folder = job
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{seed}\n")
    warnings.warn(f"job {seed} is odd", UserWarning, stacklevel=1)
    _locks.append(multiprocessing.get_context("spawn").Lock())
    Path(folder, f"lock{seed}").write_text(f"/dev/shm/sem.{_locks[-1]._semlock.name.lstrip('/')}")
    weights = torch.randn(200, 200, generator=torch.Generator().manual_seed(seed))
    return {
        "product": (weights @ weights).sum().item(),
        "text": "ä" * 1000 * seed,  # results of any length
        "values": (float("inf"), None, [True]),
        "state": (torch.get_num_threads(), os.getcwd()),
        "home": os.environ.get("PEDZOO_HOME"),
    }


_locks = []


def process_of(job: int) -> tuple[int, int]:
    return job, os.getpid()


class OwnError(Exception):
    """It cannot be unpickled, for it is rebuilt with one argument."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def fail(job: str) -> None:
    if job == "user":
        raise UserError("no map 'x': expected a file")
    if job == "own":
        raise OwnError("cannot be ", "rebuilt")
    if job == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "long":
        time.sleep(20)


def pause(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()
