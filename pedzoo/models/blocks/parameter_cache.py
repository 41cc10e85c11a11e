"""A cache of values that depend on a module's parameters alone."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from operator import is_
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from pedzoo.core.adapters import parameters_of, submodules_of, tensor_version
from pedzoo.models.blocks.mlp import MLP, Layers
from pedzoo.models.blocks.people.pooling import PoolingWeights, SocialPooling
from pedzoo.models.blocks.recurrent import (
    DecoderWeights,
    DisplacementDecoder,
    DisplacementEncoder,
    EncoderWeights,
    FirstWeights,
)

M = TypeVar("M", bound=nn.Module)
T = TypeVar("T")


class ParameterCache(Generic[M, T]):
    """Caches the value of a function of a module's parameters until a parameter changes.

    Parameters stay while they are the same objects, in the same memory, of the same version: optimizers,
    ``load_state_dict``, ``.to()`` and edits in place all change one of these. As for autograd, only what is
    written in place into ``parameter.data`` goes unseen. A copy of a module begins with an empty cache.
    """

    def __init__(self, make: Callable[[M], T], nothing: T) -> None:
        """Start empty.

        Args:
            make: A function, defined at the top of a file, that reads nothing but parameters of its module.
            nothing: The value where nothing can be cached, above all while a gradient is computed.
        """
        self._make, self._nothing = make, nothing
        self._cached: tuple[T, _Origin] | None = None

    def __call__(self, module: M) -> T:
        """Return the function's value for ``module``."""
        if torch.is_grad_enabled():
            return self._nothing
        cached = self._cached
        try:
            if cached is not None and cached[1].stays(module):
                return cached[0]
            origin = _Origin(module)
        except RuntimeError:
            # parameters made in inference mode or without memory of their own: no change can be detected
            return self._nothing
        # the next caller may run under autocast or not
        with torch.autocast(origin.parameters[0].device.type, enabled=False):
            value = self._make(module)
        self._cached = value, origin
        return value

    def __reduce__(self) -> tuple[type[ParameterCache], tuple[Callable[[M], T], T]]:
        """Copy and pickle without the value."""
        return ParameterCache, (self._make, self._nothing)


class _Origin:
    """The parameters of a module, noted to be compared at every call: hence in few steps."""

    def __init__(self, module: nn.Module) -> None:
        """Note all parameters."""
        parts = list(module.modules())
        self.module = module
        self.parents = [submodules_of(part) for part in parts]
        self.owners = [owned for part in parts if (owned := parameters_of(part))]
        self.children, self.parameters = _values(self.parents), _values(self.owners)
        self.state = _state(self.parameters)
        # held so that their addresses are not given to other numbers
        self.memory = [parameter.untyped_storage() for parameter in self.parameters]

    def stays(self, module: nn.Module) -> bool:
        """Return whether ``module`` and its parameters are unchanged."""
        if module is not self.module or _values(self.parents) != self.children:
            return False
        now = _values(self.owners)
        return (
            len(now) == len(self.parameters)
            and all(map(is_, now, self.parameters))
            and _state(now) == self.state
        )


def _values(parts: list[dict[str, Any]]) -> list[Any]:
    # a layer without a bias has None for it
    return [value for value in chain.from_iterable(map(dict.values, parts)) if value is not None]


def _state(parameters: list[Tensor]) -> list[int]:
    return [*map(tensor_version, parameters), *map(Tensor.data_ptr, parameters)]


class FusedWeights(NamedTuple):
    """Results of the parts' ``fuse``, from parameters alone; None where each call computes them."""

    encoder: EncoderWeights | None = None
    pooling: PoolingWeights | None = None
    to_decoder: Layers | None = None
    first: FirstWeights | None = None
    decoder: DecoderWeights | None = None


NOTHING = FusedWeights()


def fuse(
    encoder: DisplacementEncoder, pooling: SocialPooling | None, to_decoder: MLP, decoder: DisplacementDecoder
) -> FusedWeights:
    """Return all of it."""
    pooled = None if pooling is None else pooling.fuse()
    return FusedWeights(encoder.fuse(), pooled, to_decoder.fuse(), decoder.fuse_first(), decoder.fuse())
