"""The contract of users' models in training, checked on one batch before the first epoch."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.models.base import Forecaster

SAMPLES = 2  # K of the tried futures


def is_own(model: Forecaster) -> bool:
    """Return whether a model's class is not pedzoo's: the tests hold those."""
    return not type(model).__module__.startswith("pedzoo.")


def check_model(model: Forecaster, batch: TensorDict, by_loss: bool) -> None:
    """Let a copy of an untrained model predict recorded scenes and, ``by_loss`` of its own, learn once.

    No random number is taken from torch's.

    Raises:
        UserError: It takes other arguments or fails, its futures have another shape or are no numbers, its
            loss is no finite number, or nothing of it gets a gradient. The message says what to change.
    """
    tried, name = deepcopy(model), type(model).__name__
    devices = [batch.device] if batch.device is not None and batch.device.type == "cuda" else []
    with torch.random.fork_rng(devices), torch.enable_grad():
        _check_futures(tried, name, batch)
        if by_loss:
            _check_loss(tried, name, batch)


def _check_futures(model: Forecaster, name: str, batch: TensorDict) -> None:
    agents = agents_of(batch)
    scenes, people, steps, _ = agents["future"].shape
    usage = f"{name}.sample(batch, samples, steps, generator=None)"
    future = _called(model.sample, usage, batch, SAMPLES, steps)
    expected = scenes, SAMPLES, people, steps, 2
    if not isinstance(future, Tensor) or future.shape != expected:
        raise UserError(
            f"{name}.sample returned {_shown(future)}: expected displacements (B, K, A, T, 2), here "
            f"{expected}; pedzoo.models.base.for_all_samples makes them from one path (B, A, T, 2)"
        )
    here = agents["mask"][:, None, :, None, None].expand_as(future)
    if not bool(future[here].isfinite().all()):
        raise UserError(
            f"{name}.sample returned numbers that are not finite: divide by nothing that may be 0, and read "
            "no position of the history where agents/valid is false"
        )


def _check_loss(model: Forecaster, name: str, batch: TensorDict) -> None:
    loss = _called(model.loss, f"{name}.loss(batch, generator=None)", batch)
    if not isinstance(loss, Tensor) or loss.shape != ():
        raise UserError(
            f"{name}.loss returned {_shown(loss)}: expected one number, the sum over scenes: add .sum()"
        )
    if not bool(loss.isfinite()):
        raise UserError(
            f"{name}.loss is {loss.item()} on the first batch: leave out unknown steps (agents/future_valid) "
            "and padding (agents/mask) by torch.where, as products keep NaN"
        )
    learned = {key: value for key, value in model.named_parameters() if value.requires_grad}
    if not learned:
        raise UserError(f"{name} has no parameters to train: assign its networks to self in __init__")
    if not loss.requires_grad:
        raise UserError(
            f"no gradient of {name}.loss reaches its parameters: compute it from what they give, without "
            "detach(), item() or torch.no_grad()"
        )
    loss.backward()
    gradients = {key: value.grad for key, value in learned.items() if value.grad is not None}
    if wrong := [key for key, value in gradients.items() if not bool(value.isfinite().all())]:
        raise UserError(
            f"the gradient of {name}.loss with respect to {wrong[0]} is not finite on the first batch: "
            "sqrt() has no slope at 0, add a small number below the root; take padding out before it is used"
        )
    if left := [key for key in learned if key not in gradients]:
        print(f"note: {', '.join(left[:3])} of {name} get no gradient from its loss", file=sys.stderr)


def _shown(value: Any) -> str:
    return str(tuple(value.shape)) if isinstance(value, Tensor) else repr(value)[:60]


def _called(function: Callable[..., Any], usage: str, *given: Any) -> Any:
    """Return what a method of a model returns; mistakes in calls and keys become one line."""
    random = torch.Generator().manual_seed(0)
    try:
        inspect.signature(function).bind(*given, random)
    except TypeError as error:
        raise UserError(f"expected {usage}: {error}") from error
    try:
        return function(*given, random)
    except NotImplementedError as error:
        raise UserError(f"no {usage}: it returns displacements (B, K, A, T, 2) in metres") from error
    except KeyError as error:
        raise UserError(
            f"{usage} reads what the batch has not: {' '.join(str(error.args[0]).split())}; of a model with "
            "goals the class says needs = frozenset({'goal'}), and --data.goal gives them"
        ) from error
    except UserError:
        raise
    except Exception as error:  # a user's code may fail in any way
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "site-packages" not in frame.filename]
        place = f"{Path((own or frames)[-1].filename).name}:{(own or frames)[-1].lineno}"
        said = " ".join(str(error).split())
        keys = agents_of(given[0]).items(True, True)
        shapes = ", ".join(f"{key} {tuple(value.shape)}" for key, value in keys)
        raise UserError(
            f"{usage} failed at {place}: {type(error).__name__}: {said}; agents: {shapes}"
        ) from error
