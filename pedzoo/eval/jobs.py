"""What runs inside a worker: an environment whose every step is one job."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from pickle import PicklingError
from typing import Any, NamedTuple

import cloudpickle
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, exploration_type, set_exploration_type

from pedzoo.errors import UserError


class Sent(NamedTuple):
    """What every worker gets: the jobs, and the state of the caller's process that they may depend on.

    Attributes:
        payload: The jobs and their function, pickled.
        folder: The working directory.
        path: Where Python looks for modules.
        environ: Variables of the environment; None leaves the worker's own (it may be on another machine).
        gradients: Whether gradients are recorded. A collector switches them off; the caller may not have.
        exploration: TorchRL's exploration type, which a collector sets, too.
    """

    payload: bytes
    folder: str
    path: list[str]
    environ: dict[str, str] | None
    gradients: bool
    exploration: ExplorationType | None


def packed(jobs: Sequence[Any], work: Callable[[Any], Any], environ: dict[str, str] | None) -> Sent:
    """Return what every worker gets. What was defined in ``__main__`` or a notebook travels by value.

    Raises:
        UserError: Something of it cannot be pickled.
    """
    try:
        payload = cloudpickle.dumps((jobs, work))
    except (TypeError, AttributeError, PicklingError) as error:
        raise UserError(
            f"other processes cannot be sent these jobs or their function: {error}; use workers=1, or give "
            "them names and files in place of what is open or running"
        ) from error
    folder, path = os.getcwd(), [str(Path(entry).resolve()) for entry in sys.path]
    return Sent(payload, folder, path, environ, torch.is_grad_enabled(), exploration_type())


class Outcome(NamedTuple):
    """What became of a job.

    Attributes:
        job: Its number.
        result: What the function returned.
        error: What it raised, or None.
        warned: The warnings it gave: text, category, file, line.
    """

    job: int
    result: Any
    error: Exception | None
    warned: list[tuple[str, type[Warning], str, int]]


class JobEnv(EnvBase):
    """One step does one job; what is observed is its `Outcome`, pickled, as bytes of any number.

    A collector that steps it starts the processes, brings every step home and notices who died. An
    environment that has no job left waits until its process is ended.
    """

    def __init__(self, sent: Sent, take: Callable[[int | None], tuple[int, int] | None]) -> None:
        """Do the jobs that ``take`` hands out, as `pedzoo.eval.shares.Shares` does."""
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([]))
        torch.set_num_threads(1)
        _end_when_told()
        self.sent = sent
        self.take = take
        self.group: int | None = None
        self.unpacked: tuple[Sequence[Any], Callable[[Any], Any]] | None = None
        self.observation_spec = Composite(outcome=Unbounded(torch.Size([-1]), dtype=torch.uint8))
        self.action_spec = Unbounded(torch.Size([1]))
        self.reward_spec = Unbounded(torch.Size([1]))

    def _set_seed(self, seed: int | None) -> None:
        """A job brings its seeds."""

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        return TensorDict({"outcome": torch.zeros(0, dtype=torch.uint8)}, [])

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        taken = self.take(self.group)
        if taken is None:
            threading.Event().wait()  # until this process is ended
        assert taken is not None
        job, self.group = taken
        outcome = torch.frombuffer(bytearray(self._do(job)), dtype=torch.uint8)
        over = torch.zeros(1, dtype=torch.bool)
        return TensorDict(
            {"outcome": outcome, "reward": torch.zeros(1), "done": over, "terminated": over}, []
        )

    def _do(self, job: int) -> bytes:
        result, error = None, None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            try:
                jobs, work = self._unpack()
                with torch.set_grad_enabled(self.sent.gradients), set_exploration_type(self.sent.exploration):
                    result = work(jobs[job])
                cloudpickle.dumps(result)
            except Exception as raised:  # all of them are the caller's, who gets them as they are
                result, error = None, _portable(raised, job)
        warned = [(str(each.message), each.category, each.filename, each.lineno) for each in caught]
        return cloudpickle.dumps(Outcome(job, result, error, warned))

    def _unpack(self) -> tuple[Sequence[Any], Callable[[Any], Any]]:
        if self.unpacked is None:
            sent = self.sent
            if sent.environ is not None:  # a fork server has those of the time when it was started
                os.environ.clear()
                os.environ.update(sent.environ)
            if Path(sent.folder).is_dir():
                os.chdir(sent.folder)
            sys.path += [entry for entry in sent.path if entry not in sys.path and Path(entry).exists()]
            try:
                self.unpacked = cloudpickle.loads(sent.payload)
            except (ImportError, AttributeError) as error:
                raise UserError(
                    f"a worker cannot load the jobs or their function: {error}; define them in a file that "
                    "can be imported there, or in the script or notebook itself"
                ) from error
        assert self.unpacked is not None
        return self.unpacked


def _portable(error: Exception, job: int) -> Exception:
    """Return the error with the worker's traceback as a note, as something that can be pickled."""
    note = f"in job {job} in a worker:\n{''.join(traceback.format_exception(error)).rstrip()}"
    try:
        cloudpickle.loads(cloudpickle.dumps(error))
    except Exception:  # rebuilding an exception calls its class, which may raise anything
        error = RuntimeError(f"{type(error).__qualname__}: {error}")
    error.add_note(note)
    return error


def _end_when_told() -> None:
    """Let this process end in good order when it is terminated, and when the one that started it is gone.

    In good order: else Python complains of whatever a job has left (tqdm has a semaphore in every process).
    Without a word from the parent, which may have been killed, it would go on until the job is done.
    """
    parent = multiprocessing.parent_process()
    if parent is None:  # Ray looks after its own
        return

    def follow() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    threading.Thread(target=follow, daemon=True).start()
