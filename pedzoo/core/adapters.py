"""All private attributes of other libraries that pedzoo uses, each with its reason. Imports nothing heavy.

A test fails where one is used elsewhere. Versions of these libraries are pinned in ``pyproject.toml``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import torch
    from jsonargparse import ArgumentParser
    from lightning import Trainer
    from sklearn.ensemble import HistGradientBoostingClassifier
    from tensordict import NonTensorData, TensorDict, TensorDictBase
    from torch import Tensor


@contextmanager
def pieces_as_they_come() -> Iterator[None]:
    """Let huggingface_hub write what it downloads at once, and quietly. Else 10 MB are waited for."""
    import logging

    from huggingface_hub import constants

    logging.getLogger("huggingface_hub.file_download").setLevel(logging.ERROR)  # each new try
    usual = constants.DOWNLOAD_CHUNK_SIZE
    constants.DOWNLOAD_CHUNK_SIZE = None  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        constants.DOWNLOAD_CHUNK_SIZE = usual


def assert_on_device(condition: Tensor, message: str) -> None:
    """Raise on the device where ``condition`` () bool is false. torch: all else reads the value back."""
    import torch

    torch.ops.aten._assert_async.msg(condition, message)


def tensordict_of(values: dict[str, Any], batch_size: torch.Size, device: torch.device | None) -> TensorDict:
    """Return ``TensorDict(values, batch_size, device)``, in a fifth of the time where all values fit.

    tensordict: its constructor takes 3 us a value; those of an observation take longer than a small step.
    """
    from tensordict import TensorDict

    dims = len(batch_size)
    if all(value.device == device and value.shape[:dims] == batch_size for value in values.values()):
        return TensorDict._new_unsafe(values, batch_size, device)
    return TensorDict(values, batch_size, device)


def put(tensordict: TensorDict, values: dict[str, Any]) -> None:
    """Set values that fit, batch size and device. tensordict: its setter takes 7 us a value for checks."""
    tensordict._tensordict.update(values)


def copied(tensordict: TensorDictBase) -> TensorDictBase:
    """Return a copy with the same tensors. tensordict: ``copy`` takes 0.1 ms and looks into floor plans."""
    from tensordict import TensorDict, TensorDictBase

    if not isinstance(tensordict, TensorDict):
        return tensordict.copy()
    values = {
        key: copied(part) if isinstance(part, TensorDictBase) else part for key, part in tensordict.items()
    }
    return TensorDict._new_unsafe(values, tensordict.batch_size, tensordict.device)


def non_tensor_of(data: Any, batch_size: torch.Size, device: torch.device) -> NonTensorData:
    """Return data that are no tensor, for a TensorDict. tensordict: its constructor takes 16 us."""
    from tensordict import NonTensorData

    fields = {"data": data, "_is_non_tensor": True, "_metadata": None}
    return NonTensorData._from_tensordict(tensordict_of({}, batch_size, device), fields)


def untraceable_error() -> type[Exception]:
    """Return the errors of ``torch.export`` for a model that it cannot trace. torch: no public name."""
    from torch._dynamo.exc import UserError

    return UserError


def logged_step(trainer: Trainer) -> int:
    """Return the step under which Lightning logs metrics now. Lightning: counts of batches differ from it."""
    return trainer.fit_loop.epoch_loop._batches_that_stepped


def option_types(parser: ArgumentParser) -> dict[str, Any]:
    """Return the options of a parser, ``--`` included, with their types, None where none was declared.

    argparse and jsonargparse: neither lists its options.
    """
    known = parser._option_string_actions
    return {name: getattr(action, "_typehint", None) for name, action in known.items()}


def worker_number() -> int:
    """Return the number of this process among those that Python has started; 0 in the first one.

    multiprocessing: its name has the number, but may be changed.
    """
    from multiprocessing import current_process

    number = 0
    for part in current_process()._identity:  # pyright: ignore[reportAttributeAccessIssue]
        number = number * 1000 + part
    return number


def split_gains(trees: HistGradientBoostingClassifier, features: int) -> np.ndarray:
    """Return what the splits at each feature gain in all (F,). scikit-learn: these trees do not say it."""
    import numpy as np

    nodes = np.concatenate([tree.nodes for trees_of_step in trees._predictors for tree in trees_of_step])
    inner = nodes[nodes["is_leaf"] == 0]
    return np.bincount(inner["feature_idx"], inner["gain"], features)
