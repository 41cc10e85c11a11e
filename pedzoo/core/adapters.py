"""All private attributes of other libraries that pedzoo uses, each with its reason. Imports nothing heavy.

A test fails where one is used elsewhere. Versions of these libraries are pinned in ``pyproject.toml``.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser
    from lightning import Trainer
    from torch import Tensor, nn

tensor_version = attrgetter("_version")
"""torch: how often a tensor was written in place. Only autograd reads it; there is no public counter."""


def submodules_of(module: nn.Module) -> dict[str, nn.Module | None]:
    """Return the table of a module's children. torch: ``children()`` takes five times as long."""
    return module._modules


def parameters_of(module: nn.Module) -> dict[str, nn.Parameter | None]:
    """Return the table of a module's own parameters. torch: for the reason of `submodules_of`."""
    return module._parameters


def assert_on_device(condition: Tensor, message: str) -> None:
    """Raise on the device where ``condition`` () bool is false. torch: all else reads the value back."""
    import torch

    torch.ops.aten._assert_async.msg(condition, message)


def untraceable_error() -> type[Exception]:
    """Return what ``torch.export`` raises of a model that it cannot trace. torch: it has no public name."""
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
