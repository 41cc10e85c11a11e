"""What workers do in tests; without pytest, which would take them half a second to import."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
import warnings
from pathlib import Path

import torch
from tensordict.nn.probabilistic import interaction_type

from pedzoo.core.errors import UserError


def answer(job: tuple[int, str]) -> dict:
    seed, folder = job
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{seed}\n")
    weights = torch.randn(200, 200, generator=torch.Generator().manual_seed(seed))
    kind = interaction_type()
    return {
        "product": (weights @ weights).sum().item(),
        "text": "ä" * 1000 * seed,  # results of any length
        "values": (float("inf"), None, [True]),
        "state": (torch.get_num_threads(), torch.is_grad_enabled(), kind and kind.name, os.getcwd()),
        "home": os.environ.get("PEDZOO_HOME"),
    }


def process_of(job: int) -> tuple[int, int]:
    return job, os.getpid()


def lock(job: int) -> str:
    """Leave a semaphore, as tqdm does, whose file goes when the process ends in good order; return it."""
    _locks.append(multiprocessing.get_context("spawn").Lock())
    return f"/dev/shm/sem.{_locks[-1]._semlock.name.lstrip('/')}"


_locks = []


class OwnError(Exception):
    """It cannot be unpickled, for it is rebuilt with one argument."""

    def __init__(self, first: str, second: str) -> None:
        """Take two arguments."""
        super().__init__(first + second)


def fail(job: str) -> None:
    if job == "user":
        raise UserError("no map 'x': expected a file")
    if job == "own":
        raise OwnError("cannot be ", "rebuilt")
    if job == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "exit":
        sys.exit(7)
    if job == "long":
        time.sleep(20)


def pause(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def complain(job: int) -> int:
    warnings.warn(f"job {job} is odd", UserWarning, stacklevel=1)
    return job
