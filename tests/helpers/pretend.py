"""A pretended GPU: tensors that compute on the CPU, say that they are elsewhere, and refuse host reads.

An operation with tensors of two devices raises, index tensors included, and so does one that reads values.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("cuda", 0)
"""What the tensors say: code takes the ways that it takes on a GPU. Torch itself is told ``meta``."""

_META = torch.device("meta")
_READS = {torch.Tag.data_dependent_output, torch.Tag.dynamic_output_shape}
_INDEXING = ("index.Tensor", "index_put.default", "index_put_.default")
_ASSERTIONS = ("_assert_async.default", "_assert_async.msg")


class HostReadError(RuntimeError):
    """The host reads a value from the device."""


class MixedDevicesError(RuntimeError):
    """An operation meets tensors of two devices, or a tensor is copied from the host."""


class There(Tensor):
    """A tensor on the pretended device; its values are in ``here``, on the CPU."""

    here: Tensor

    @staticmethod
    def __new__(cls, here: Tensor) -> There:
        """Wrap values."""
        size = here.shape, here.stride(), here.storage_offset()
        with torch.inference_mode(False):  # torch makes no subclass of its inference tensors
            result = Tensor._make_wrapper_subclass(cls, *size, dtype=here.dtype, device=_META)
        result.here = here
        return result

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        """The pretended one."""
        return DEVICE

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Refuse: the mode answers."""
        raise RuntimeError(f"{func} outside of `pretended`")


class _Operations(TorchDispatchMode):
    """Runs operations on the values, if a device could run them without waiting."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given, name = dict(kwargs or {}), str(func).removeprefix("aten.")
        tensors = [leaf for leaf in tree_leaves((args, given)) if isinstance(leaf, Tensor)]
        there, target = any(isinstance(leaf, There) for leaf in tensors), given.get("device")
        if there and ((target is not None and target != _META) or _reads(func, name, args)):
            raise HostReadError(f"{name} of {[tuple(leaf.shape) for leaf in tensors]}")
        # as in torch, a single number may come from the host
        strangers = [tuple(leaf.shape) for leaf in tensors if not isinstance(leaf, There) and leaf.dim()]
        if there and strangers:
            raise MixedDevicesError(f"{name}: tensors of shapes {strangers} are on the CPU")
        if target is not None:
            given["device"] = torch.device("cpu")
        here = tree_map(lambda leaf: leaf.here if isinstance(leaf, There) else leaf, (args, given))
        result = func(*here[0], **here[1])
        if not there and target != _META:
            return result
        if _in_place(name.split(".")[0]):
            return args[0]
        return tree_map(lambda leaf: There(leaf) if isinstance(leaf, Tensor) else leaf, result)


class _Arrivals(TorchFunctionMode):
    """Makes tensors on `DEVICE`, which torch refuses by itself; numbers of Python are copied there, too."""

    def __init__(self, copies: bool) -> None:
        super().__init__()
        self.copies = copies

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = dict(kwargs or {})
        targets = [*args[1:], *given.values()] if func is Tensor.to else [given.get("device")]
        if not any(isinstance(to, There) or to in (DEVICE, "cuda") for to in targets if to is not None):
            return func(*args, **given)
        if func is not Tensor.to and func not in (torch.tensor, torch.as_tensor):
            return func(*args, **given | {"device": _META})
        result = args[0] if func is Tensor.to else func(*args, **given | {"device": "cpu"})
        for to in targets:
            dtype = to.dtype if isinstance(to, There) else to
            result = result.to(dtype) if isinstance(dtype, torch.dtype) else result
        if not (self.copies or isinstance(result, There)):
            raise MixedDevicesError(f"a tensor of shape {tuple(result.shape)} is copied from the CPU")
        return result if isinstance(result, There) else There(result)


def _in_place(name: str) -> bool:
    """Return whether an operation writes its first argument: ``add_`` and ``__iand__`` do."""
    return name.endswith("_") and (not name.startswith("__") or name.startswith("__i"))


def _reads(func: Any, name: str, args: Any) -> bool:
    """Return whether an operation reads values back: single ones, or how many there are."""
    if name in _INDEXING:
        return any(index is not None and index.dtype == torch.bool for index in args[1])
    return name not in _ASSERTIONS and bool(_READS & set(func.tags))


@contextmanager
def pretended(copies: bool = True) -> Iterator[None]:
    """Pretend, without gradients; with ``copies=False`` nothing is copied from the host any more."""
    with torch.no_grad(), _Arrivals(copies), _Operations():
        yield
