"""Which scenes go into a batch together, and with which seed."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DistributedSampler


class Draw(NamedTuple):
    """One batch to come: its scenes (B,) and the seed of everything random about it."""

    scenes: Tensor
    seed: int


class BucketSampler(DistributedSampler[Draw]):
    """Batches of scenes of similar crowd size, so that padding is small and pooling runs over few groups.

    Scenes are ordered by size with ties in random order and cut into batches of at most ``batch_size``
    scenes and ``max_pairs`` ordered pairs of people; the batches come in random order. An epoch depends
    on nothing but ``seed`` and its number, so a resumed run sees what an uninterrupted one would. Without
    ``shuffle`` all epochs are the same.

    It is a `DistributedSampler`, though nothing is inherited, so that Lightning leaves it alone: of others it
    takes each process's share, which would be a share of the share.
    """

    def __init__(
        self,
        sizes: Tensor,
        batch_size: int,
        max_pairs: int,
        shuffle: bool,
        seed: int = 0,
        rank: int = 0,
        replicas: int = 1,
        groups: Tensor | None = None,
    ) -> None:
        """Cut the batches.

        Args:
            sizes: People in each scene (S,).
            batch_size: Scenes in a batch, at most.
            max_pairs: Ordered pairs of people in a batch, at most.
            shuffle: Another order in every epoch.
            seed: Of the order.
            rank: Of the process.
            replicas: Processes, each of which gets its share.
            groups: Which scenes may be in a batch together (S,) long: those of the same number; None for all.
        """
        self.sizes = sizes.numpy()
        self.groups = np.zeros_like(self.sizes) if groups is None else groups.numpy()
        self.shuffle, self.seed, self.rank, self.replicas = shuffle, seed, rank, replicas
        self.epoch = 0
        self.cuts: list[tuple[int, int]] = []
        for group in np.unique(self.groups):
            before = int((self.groups < group).sum())
            group_cuts = _cuts(np.sort(self.sizes[self.groups == group]), batch_size, max_pairs)
            self.cuts += [(before + start, before + stop) for start, stop in group_cuts]

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        """Return the number of batches, the same in every epoch and for every rank."""
        return -(-len(self.cuts) // self.replicas)

    def __iter__(self) -> Iterator[Draw]:
        """Yield the batches of the current epoch."""
        random = np.random.default_rng((self.seed, self.epoch if self.shuffle else 0))
        tie = random.permutation(len(self.sizes)) if self.shuffle else np.arange(len(self.sizes))
        order = np.lexsort((tie, self.sizes, self.groups))
        batches = random.permutation(len(self.cuts)) if self.shuffle else np.arange(len(self.cuts))
        seeds = random.integers(2**62, size=len(self.cuts))
        for i in np.resize(batches, len(self) * self.replicas)[self.rank :: self.replicas]:
            start, stop = self.cuts[i]
            yield Draw(torch.from_numpy(order[start:stop]), int(seeds[i]))


def _cuts(sizes: np.ndarray, batch_size: int, max_pairs: int) -> list[tuple[int, int]]:
    """Return where to cut ascending ``sizes``; a scene with more than ``max_pairs`` pairs stands alone."""
    pairs = np.concatenate(([0], np.cumsum(sizes.astype(np.int64) ** 2)))
    cuts, start = [], 0
    while start < len(sizes):
        most = int(np.searchsorted(pairs, pairs[start] + max_pairs, side="right")) - 1
        stop = min(max(most, start + 1), start + batch_size, len(sizes))
        cuts.append((start, stop))
        start = stop
    return cuts
