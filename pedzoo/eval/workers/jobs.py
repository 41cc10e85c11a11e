"""The inside of a worker: it receives all jobs once, then does them by number."""

import traceback
import warnings
from collections.abc import Callable, Sequence
from functools import cached_property
from pickle import PicklingError
from typing import Any, NamedTuple

import cloudpickle
import torch
from tensordict.nn.probabilistic import interaction_type, set_interaction_type  # not torchrl: 1.3 s

from pedzoo.core.errors import UserError


class JobResult(NamedTuple):
    """What became of a job.

    Attributes:
        result: What the function returned, pickled; None after an error.
        error: What it raised, or None.
        warned: The warnings it gave: text, category, file, line.
    """

    result: bytes | None
    error: Exception | None
    warned: Sequence[tuple[str, type[Warning], str, int]] = ()


def packed(jobs: Sequence[Any], work: Callable[[Any], Any]) -> bytes:
    """Return the jobs, their function, and the caller's gradient mode and exploration type, pickled.

    What was defined in ``__main__`` or a notebook travels by value.

    Raises:
        UserError: Something of it cannot be pickled.
    """
    try:
        return cloudpickle.dumps((jobs, work, torch.is_grad_enabled(), interaction_type()))
    except (TypeError, AttributeError, PicklingError) as error:
        raise UserError(
            f"other processes cannot be sent these jobs or their function: {error}; use workers=1, or give "
            "them names and files in place of what is open or running"
        ) from error


class Worker:
    """Does one job after the other with one thread of torch."""

    def __init__(self, payload: bytes) -> None:
        """Take what `packed` returned."""
        torch.set_num_threads(1)
        self._payload = payload

    @cached_property
    def _sent(self) -> tuple[Any, ...]:
        try:
            return cloudpickle.loads(self._payload)
        except (ImportError, AttributeError) as error:
            raise UserError(
                f"a worker cannot load the jobs or their function: {error}; define them in a file that "
                "can be imported there, or in the script or notebook itself"
            ) from error

    def do(self, number: int) -> bytes:
        """Do a job and return its `JobResult`, pickled."""
        result, error = None, None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            try:
                jobs, work, gradients, exploration = self._sent
                with torch.set_grad_enabled(gradients), set_interaction_type(exploration):
                    result = cloudpickle.dumps(work(jobs[number]))
            except Exception as raised:  # the caller gets any error of a job
                error = _portable(raised, number)
        warned = [(str(each.message), each.category, each.filename, each.lineno) for each in caught]
        return cloudpickle.dumps(JobResult(result, error, warned))


def _portable(error: Exception, job: int) -> Exception:
    """Return the error with the worker's traceback as a note, as something that can be pickled."""
    note = f"in job {job} in a worker:\n{''.join(traceback.format_exception(error)).rstrip()}"
    try:
        cloudpickle.loads(cloudpickle.dumps(error))
    except Exception:  # rebuilding an exception calls its class, which may raise anything
        error = RuntimeError(f"{type(error).__qualname__}: {error}")
    error.add_note(note)
    return error
