"""The border between padded scene batches and packed people.

Outside a model a batch is padded, (B, A, ...). Inside, all present people stand in one row, (P, ...), and
pooling runs over groups of scenes of equal size: nothing is computed for padding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import torch
from torch import Tensor

REACH, FADES = 30.0, 25.0
"""Metres: nobody sees others beyond the first, and those beyond the second count less."""


@torch.no_grad()
def share_seen(away: Tensor) -> Tensor:
    """Return how much others count (...), 0 to 1, by where they are from a person (..., 2), metres."""
    return ((REACH - away.norm(dim=-1)) / (REACH - FADES)).clamp(0, 1)


class Crowd:
    """The packed order of a batch's people; its parts are computed when first asked for.

    In a graph for other programs (`torch.export`) padding stays, as the number of people is known only when
    it runs. Every slot then counts as a person, and pooling leaves absent people out.

    Attributes:
        shape: The padded (B, A).
        full: Nothing is taken out, as in most simulations: packing is a reshape.
        absent: Slots to leave out of pooling (B, A) bool; None where padding was taken out.
    """

    def __init__(self, mask: Tensor, full: bool, absent: Tensor | None = None) -> None:
        """Take a presence mask (B, A) bool, and what the attributes say; see `of`."""
        self._mask, self.full, self.absent = mask, full, absent
        self.shape = (mask.shape[0], mask.shape[1])

    @classmethod
    def of(cls, mask: Tensor) -> Crowd:
        """Return the packing of a presence mask (B, A) bool."""
        if torch.compiler.is_exporting():
            return cls(mask, True, ~mask)
        return cls(mask, mask.numel() > 0 and bool(mask.all()))

    @cached_property
    def _there(self) -> tuple[Tensor, ...]:
        return self._mask.nonzero(as_tuple=True)

    @cached_property
    def scene(self) -> Tensor:
        """Scene of each person (P,), ascending."""
        if self.full:
            scenes = torch.arange(self.shape[0], device=self._mask.device)
            return scenes.unsqueeze(1).expand(self.shape).flatten()
        return self._there[0]

    @cached_property
    def first(self) -> Tensor:
        """The first person of each person's scene (P,)."""
        if self.full:
            return self.scene * self.shape[1]
        return torch.searchsorted(self.scene, self.scene)

    @cached_property
    def groups(self) -> tuple[Tensor, ...]:
        """For each distinct crowd size n, the people (G, n) of the G scenes of that size."""
        device = self._mask.device
        if self.full:
            return (torch.arange(self._mask.numel(), device=device).view(self.shape),)
        sizes = self._mask.sum(1)
        starts = sizes.cumsum(0) - sizes
        return tuple(
            starts[sizes == n].unsqueeze(1) + torch.arange(n, device=device)
            for n in sizes.unique().tolist()
            if n > 0
        )

    def pack(self, padded: Tensor) -> Tensor:
        """Return the people (P, ...) of a padded tensor (B, A, ...)."""
        return padded.flatten(0, 1) if self.full else padded[self._there]

    def unpack(self, packed: Tensor) -> Tensor:
        """Return the padded tensor (B, A, ...) of packed people (P, ...), zero where no person is."""
        if self.full:
            return packed.view(*self.shape, *packed.shape[1:])
        padded = packed.new_zeros(*self.shape, *packed.shape[1:])
        return padded.index_put(self._there, packed)

    def unpack_samples(self, packed: Tensor) -> Tensor:
        """Return samples (B, K, A, ...) of packed ones (K, P, ...), zero where no person is."""
        return self.unpack(packed.transpose(0, 1)).transpose(1, 2)

    def most_of_others(self, seen: Callable[[Tensor, Tensor], Tensor], position: Tensor, dim: int) -> Tensor:
        """Return the maxima (P, D), over all others within reach, of a person's features of another.

        They are zeros for people alone. ``seen`` takes observers (G, 1, n) and observed people (G, n, 1),
        long, of the G scenes of each size n, and returns features (G, n, n, D), never negative. ``position``
        (P, 2), metres.
        """
        pooled = position.new_zeros(position.shape[0], dim)
        for group in self.groups:
            me, them = group.unsqueeze(1), group.unsqueeze(2)  # torch is slow at a maximum over the other one
            excluded = me == them
            if self.absent is not None:
                excluded = excluded | self.absent.unsqueeze(2)
            share = share_seen(position[them] - position[me]) * ~excluded
            most = (seen(me, them) * share.unsqueeze(-1)).amax(1)
            pooled = pooled.index_copy(0, group.flatten(), most.flatten(0, 1))
        return pooled

    def sum_per_scene(self, values: Tensor) -> Tensor:
        """Return the sums (B, ...) over the people of each scene of ``values`` (P, ...)."""
        if self.full:
            return values.unflatten(0, self.shape).sum(1)
        return values.new_zeros(self.shape[0], *values.shape[1:]).index_add(0, self.scene, values)
