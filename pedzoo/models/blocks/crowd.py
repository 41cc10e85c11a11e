"""The border between padded scene batches and packed people.

Outside a model a batch is padded, (B, A, ...); inside, all people that are really there stand in one
row, (P, ...), and pooling runs over groups of scenes of equal size, so nothing is computed for padding.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Crowd:
    """Who is where: the packed order of a batch's people.

    Attributes:
        scene: Scene of each person (P,), ascending.
        slot: Column of each person in the padded batch (P,).
        groups: For each distinct crowd size n, the people (G, n) of the G scenes of that size.
        shape: The padded (B, A).
        full: Nothing is padding, as in most simulations: packing is a matter of shape.
    """

    scene: Tensor
    slot: Tensor
    groups: tuple[Tensor, ...]
    shape: tuple[int, int]
    full: bool = False

    @classmethod
    def of(cls, mask: Tensor) -> Crowd:
        """Return the packing of a presence mask (B, A) bool."""
        scene, slot = mask.nonzero(as_tuple=True)
        shape = (mask.shape[0], mask.shape[1])
        if 0 < len(scene) == mask.numel():
            return cls(scene, slot, (torch.arange(len(scene), device=mask.device).view(shape),), shape, True)
        sizes = mask.sum(1)
        starts = sizes.cumsum(0) - sizes
        groups = tuple(
            starts[sizes == n].unsqueeze(1) + torch.arange(n, device=mask.device)
            for n in sizes.unique().tolist()
            if n > 0
        )
        return cls(scene, slot, groups, shape)

    def pack(self, padded: Tensor) -> Tensor:
        """Return the people (P, ...) of a padded tensor (B, A, ...)."""
        return padded.flatten(0, 1) if self.full else padded[self.scene, self.slot]

    def unpack(self, packed: Tensor) -> Tensor:
        """Return the padded tensor (B, A, ...) of packed people (P, ...), zero where nobody is."""
        if self.full:
            return packed.unflatten(0, self.shape)
        padded = packed.new_zeros(*self.shape, *packed.shape[1:])
        return padded.index_put((self.scene, self.slot), packed)

    def sum_per_scene(self, values: Tensor) -> Tensor:
        """Return the sums (B, ...) over the people of each scene of ``values`` (P, ...)."""
        if self.full:
            return values.unflatten(0, self.shape).sum(1)
        return values.new_zeros(self.shape[0], *values.shape[1:]).index_add(0, self.scene, values)
