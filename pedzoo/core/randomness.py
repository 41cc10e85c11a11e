"""Random numbers by counter: a scene's numbers depend on its seed and number alone.

A stream of numbers would make a scene depend on how many others were drawn before it. Here every number is a
hash of (seed, episode, purpose, index): the same for every batch size, device and number of workers, and
reproducible at any time. See Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011; the
mixing function is SplitMix64's (Steele et al., OOPSLA 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from zlib import crc32

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import as_integer


def signed(value: int) -> int:
    """Return the int64 of the same 64 bits."""
    return value - 2**64 if value >= 2**63 else value


_GOLDEN = signed(0x9E3779B97F4A7C15)
_FIRST = signed(0xBF58476D1CE4E5B9)
_SECOND = signed(0x94D049BB133111EB)
_ARRAY = np.array([_GOLDEN, _FIRST, _SECOND]).view(np.uint64)


def _shifted(x: Tensor, bits: int) -> Tensor:
    """Shift right, filling with zeros: torch has signed integers only."""
    return (x >> bits) & (2 ** (64 - bits) - 1)


def mix(x: Tensor) -> Tensor:
    """Return a hash of every int64: each bit of it depends on each bit of ``x``."""
    x = (x ^ _shifted(x, 30)) * _FIRST
    x = (x ^ _shifted(x, 27)) * _SECOND
    return x ^ _shifted(x, 31)


def join(key: Tensor, *parts: Tensor | int | str) -> Tensor:
    """Return keys of their own for ``key`` int64 and anything that broadcasts against it."""
    if all(isinstance(part, int | str) or _is_array(part) for part in (key, *parts)):
        return _joined_arrays(key, parts)
    for part in parts:
        number = crc32(part.encode()) if isinstance(part, str) else part
        mixed = _mixed(number) if isinstance(number, int) else mix(torch.as_tensor(number) * _GOLDEN + 1)
        key = mix((key + _GOLDEN) ^ mixed)
    return key


def _is_array(x: Tensor) -> bool:
    """Return whether NumPy may hash a tensor: on the CPU it takes half the time for the few of a scene."""
    plain = type(x) is Tensor and x.device.type == "cpu" and x.dtype == torch.int64 and x.dim() > 0
    return plain and not torch.compiler.is_compiling()


def _joined_arrays(key: Tensor, parts: Sequence[Tensor | int | str]) -> Tensor:
    """Do what `join` does in NumPy, whose integers have no sign."""
    result: NDArray[np.uint64] = key.numpy().view(np.uint64)
    for part in parts:
        number = crc32(part.encode()) if isinstance(part, str) else part
        if isinstance(number, Tensor):
            mixed = _mix_array(number.numpy().view(np.uint64) * _ARRAY[0] + np.uint64(1))
        else:
            mixed = np.uint64(_mixed(int(number)) % 2**64)
        result = _mix_array((result + _ARRAY[0]) ^ mixed)
    return torch.from_numpy(result.view(np.int64)) if parts else key


def _mix_array(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = (x ^ (x >> np.uint64(30))) * _ARRAY[1]
    x = (x ^ (x >> np.uint64(27))) * _ARRAY[2]
    return x ^ (x >> np.uint64(31))


@lru_cache(4096)
def _mixed(number: int) -> int:
    """Return ``mix(number * _GOLDEN + 1)`` of one number: ten operations on tensors fewer."""
    return int(mix(torch.tensor(signed((number * _GOLDEN + 1) % 2**64))))


def uniform(key: Tensor) -> Tensor:
    """Return float32 numbers in (0, 1), one per key."""
    return (_shifted(key, 40).to(torch.float32) + 0.5) / 2**24


def normal(key: Tensor) -> Tensor:
    """Return float32 numbers from the standard normal distribution, one per key."""
    return torch.special.ndtri((_shifted(key, 24).to(torch.float64) + 0.5) / 2**40).to(torch.float32)


class Draws:
    """The random numbers of B scenes.

    Attributes:
        key: One key per scene (B,) int64: scene ``episode`` of ``seed``.
        episode: Numbers of the scenes (B,) long, for scenarios that go through a list; None where only the
            keys are known.
    """

    def __init__(self, key: Tensor, episode: Tensor | None = None) -> None:
        """Take the scenes' keys; see `for_episodes`."""
        self.key, self.episode = key, episode

    @classmethod
    def for_episodes(cls, seed: int | Tensor, episode: Tensor) -> Draws:
        """Return the numbers of the scenes ``episode`` (B,) long of a seed, or of seeds (B,) long.

        Raises:
            UserError: The seed is no whole number.
        """
        several = isinstance(seed, Tensor) and seed.dim()
        number = seed if several else signed(as_integer("seed", seed) % 2**64)
        return cls(join(torch.zeros_like(episode) + number, episode), episode)

    def keys(self, what: str, *shape: int) -> Tensor:
        """Return keys (B, *shape). A larger first dimension keeps the numbers of a smaller one."""
        size = 1
        for length in shape:
            size *= length
        index = torch.arange(size, device=self.key.device)
        return join(self.key.unsqueeze(1), what, index).view(len(self.key), *shape)

    def uniform(self, what: str, *shape: int) -> Tensor:
        """Return numbers (B, *shape) in (0, 1)."""
        return uniform(self.keys(what, *shape))

    def normal(self, what: str, *shape: int) -> Tensor:
        """Return numbers (B, *shape) from the standard normal distribution."""
        return normal(self.keys(what, *shape))

    def integers(self, what: str, count: int, *shape: int) -> Tensor:
        """Return whole numbers (B, *shape) long from 0 to ``count - 1``."""
        return (self.uniform(what, *shape) * count).long().clamp_max(count - 1)

    def uniform_at(self, what: str, *index: Tensor) -> Tensor:
        """Return one number (B,) in (0, 1) per scene, the one at ``index``, each (B,) long."""
        return uniform(join(self.key, what, *index))
