"""Distances between futures, per scene: for variety losses and energy scores."""

from typing import Literal, cast

from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.blocks.people.crowd import Crowd

Kind = Literal["squared_displacement", "distance"]


class SceneError:
    """Mean error over the people and known steps of each scene of one batch of recordings.

    ``squared_displacement`` is the published loss, per step; ``distance`` of positions is the ADE itself.
    """

    def __init__(self, kind: Kind, batch: TensorDict, crowd: Crowd) -> None:
        """Take the truth of ``batch``, packed by ``crowd``."""
        self.kind, self.crowd = kind, crowd
        self.truth = crowd.pack(true_displacements(batch))
        known = (
            known_displacements(batch) if kind == "squared_displacement" else agents_of(batch)["future_valid"]
        )
        self.known = known = cast("Tensor", crowd.pack(known))
        self.count = crowd.sum_per_scene(known.sum(1).to(self.truth.dtype)).clamp(min=1)

    def __call__(self, path: Tensor, other: Tensor | None = None) -> Tensor:
        """Return errors (B, K) of displacements (K, P, T, 2), against the truth or ``other`` (P, T, 2)."""
        wrong = path - (self.truth if other is None else other)
        if self.kind == "squared_displacement":
            wrong = wrong.square().sum(-1)
        else:
            # the root has no slope at zero
            wrong = (wrong.cumsum(-2).square().sum(-1) + 1e-8).sqrt()
        return self.crowd.sum_per_scene((wrong * self.known).sum(2).t()) / self.count.unsqueeze(1)
