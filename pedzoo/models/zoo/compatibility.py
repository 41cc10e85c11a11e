"""Do settings and tensors of a file fit a model? Asked before the model is built, which takes memory."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import torch
from torch import Tensor, nn

from pedzoo.core.errors import UserError
from pedzoo.core.spec import setting_types
from pedzoo.models.zoo.typed_fields import check

LARGEST = 1e3
"""Of a weight. Those that ship are below 20; steps from layers of ten times as large ones are no numbers."""


def check_settings(cls: type, init: Mapping[str, Any]) -> None:
    """Check that settings of a file are of the kinds that a class takes; names are checked elsewhere.

    Raises:
        UserError: One is not, such as a text in the place of true or false.
    """
    types = setting_types(cls)
    for key in init.keys() & types.keys():
        check(init[key], types[key], key)


def check_tensors(state: Mapping[str, Any], source: str, own: bool = False) -> None:
    """Check that a state is one of weights: tensors of finite real numbers by name.

    Args:
        state: What was read.
        source: From where, for the message.
        own: Whether it is for a user's class, which may keep other numbers than weights.

    Raises:
        UserError: It holds something else, or a weight above `LARGEST`.
    """
    for key, value in state.items():
        if not isinstance(value, Tensor) or value.layout != torch.strided:
            raise UserError(f"{source!r}: {key:.80} is no dense tensor")
        if not (value.is_floating_point() or value.dtype == torch.bool):
            raise UserError(
                f"{source!r}: {key:.80} is of {value.dtype}, expected floating point numbers or truth values"
            )
        if not torch.isfinite(value).all():
            raise UserError(f"{source!r}: {key:.80} has NaN or infinite values: its training failed")
        largest = float(value.abs().max()) if value.numel() and value.is_floating_point() else 0.0
        if largest > (math.inf if own else LARGEST):
            raise UserError(
                f"{source!r}: {key:.80} has a weight of {largest:.3g}, at most {LARGEST:g} are read: its "
                "training diverged"
            )


def check_shapes(model: Callable[[], nn.Module], state: Mapping[str, Tensor]) -> None:
    """Check that a model would have tensors of just these names and shapes, without memory for them.

    Args:
        model: Builds it.
        state: Tensors by name.

    Raises:
        RuntimeError: It would have others, as torch's ``load_state_dict`` says it.
    """
    with torch.device("meta"):
        model().load_state_dict({key: value.to("meta") for key, value in state.items()}, assign=True)


def check_archive(path: Path) -> None:
    """Check that a checkpoint is an archive that is as large as what is in it, as torch writes them.

    Raises:
        UserError: It is cut off, of another form, or compressed: that could be of any size.
    """
    try:
        with ZipFile(path) as archive:
            entries = archive.infolist()
    except (BadZipFile, ValueError, EOFError, NotImplementedError, RuntimeError) as error:
        raise UserError(f"checkpoint {str(path)!r} cannot be read ({error}): is it cut off?") from error
    packed = [entry.filename for entry in entries if entry.compress_type != ZIP_STORED]
    if packed or sum(entry.file_size for entry in entries) > path.stat().st_size:
        raise UserError(f"checkpoint {str(path)!r} is compressed, and torch does not compress: is it one?")
