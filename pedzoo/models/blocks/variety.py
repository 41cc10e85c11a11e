"""Losses of forecasts with noise: the best of several, two at random, the one without; a discriminator."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.blocks.mlp import ACTIVATIONS, Activation, init_like_sgan, mlp
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.people.pooling import SocialPooling
from pedzoo.models.blocks.recurrent import DisplacementEncoder

Kind = Literal["squared_displacement", "distance"]


def scene_error(kind: Kind, batch: TensorDict, crowd: Crowd) -> Callable[..., Tensor]:
    """Return a function of displacements (K, P, T, 2) and, if not the truth is meant, others (P, T, 2).

    It returns the mean error (B, K) over the people and known steps of each scene of a batch, packed by
    ``crowd``. ``squared_displacement`` is the published loss, per step; ``distance`` of positions is the ADE.
    """
    squared, truth = kind == "squared_displacement", crowd.pack(true_displacements(batch))
    known = crowd.pack(known_displacements(batch) if squared else agents_of(batch)["future_valid"])
    count = crowd.sum_per_scene(known.sum(1).to(truth.dtype)).clamp(min=1).unsqueeze(1)

    def error(path: Tensor, other: Tensor | None = None) -> Tensor:
        wrong = path - (truth if other is None else other)
        # the root has no slope at zero
        off = (wrong if squared else wrong.cumsum(-2)).square().sum(-1)
        off = off if squared else (off + 1e-8).sqrt()
        return crowd.sum_per_scene((off * known).sum(2).t()) / count

    return error


@dataclass(frozen=True)
class VarietyLoss:
    """The variety loss, the energy score and the error of the most likely forecast, weighed.

    The variety loss is the error of the best of ``best_k`` samples, best for all people of a scene together
    (Gupta et al., CVPR 2018, eq. 8). Only the winners have a gradient: they run again.

    Attributes:
        best_k: Samples of the variety loss.
        error: Error of a sample; see `scene_error`.
        variety_weight: Weight of the variety loss.
        mode_weight: Weight of the same loss on the noise-free prediction.
        energy_weight: Weight of the energy score of two random samples, E|X - y| - E|X - X'| / 2, whose
            minimum is the true distribution (Gneiting and Raftery, JASA 2007, eq. 21).
        map_dropout: Share of a floor plan's features left out in training: recordings have few plans.
    """

    best_k: int = 20
    error: Kind = "squared_displacement"
    variety_weight: float = 1.0
    mode_weight: float = 0.0
    energy_weight: float = 0.0
    map_dropout: float = 0.0

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: no sample, or an energy score of squared errors."""
        if self.best_k < 1:
            raise UserError(f"best_k {self.best_k}: expected at least 1 sample")
        if self.energy_weight and self.error != "distance":
            raise UserError(
                "energy_weight needs error: distance; a squared error's energy score rewards the mean alone"
            )

    def __call__(
        self,
        decode: Callable[[Tensor], Tensor],
        z: Tensor,
        batch: TensorDict,
        crowd: Crowd,
        sample: bool = True,
    ) -> tuple[Tensor, Tensor | None]:
        """Return the loss, summed over scenes, and, if wanted, a random ``sample`` (P, T, 2).

        ``decode`` returns displacements (K, P, T, 2) for noise ``z`` (K, P, Z) of ``best_k`` samples, at
        least two, of the scenes in a ``batch`` that ``crowd`` packs.
        """
        error = scene_error(self.error, batch, crowd)
        chosen = {"sample": z[-1]} if sample or self.energy_weight else {}
        chosen["winner"] = z[-1]
        if self.best_k > 1 and self.variety_weight:
            with torch.no_grad():
                best = error(decode(z[-self.best_k :])).argmin(1)
            chosen["winner"] = z[-self.best_k :][best[crowd.scene], torch.arange(z.shape[1], device=z.device)]
        if self.energy_weight:
            chosen["other"] = z[-2]
        if self.mode_weight:
            chosen["mode"] = torch.zeros_like(z[-1])
        paths = decode(torch.stack(list(chosen.values())))
        path = dict(zip(chosen, paths, strict=True))

        def cost(name: str, other: Tensor | None = None) -> Tensor:
            return error(path[name].unsqueeze(0), other).sum()

        loss = self.variety_weight * cost("winner")
        if self.energy_weight:
            miss = cost("sample") + cost("other") - cost("sample", path["other"])
            loss = loss + self.energy_weight * miss / 2
        if self.mode_weight:
            loss = loss + self.mode_weight * cost("mode")
        return loss, path.get("sample")


class Discriminator(nn.Module):
    """An LSTM over all steps of a window and a classifier (Gupta et al., CVPR 2018, section 3.2).

    ``local`` judges each person alone; ``global`` pools the people of a scene around where they started.
    """

    def __init__(
        self,
        kind: Literal["local", "global"] = "local",
        embedding_dim: int = 16,
        hidden_dim: int = 48,
        mlp_dim: int = 64,
        signed: bool = False,
        activation: Activation = "relu",
    ) -> None:
        """Create the parameters.

        Args:
            kind: ``local`` or ``global``.
            embedding_dim: Width of the embedded displacement.
            hidden_dim: Width of the LSTM.
            mlp_dim: Width of the classifier's hidden layer.
            signed: Scores may be negative; where the published ones are zero, nothing is learnt.
            activation: Inside the classifier.
        """
        super().__init__()
        self.encoder = DisplacementEncoder(embedding_dim, hidden_dim)
        self.pooling = SocialPooling(hidden_dim, embedding_dim, 512, hidden_dim) if kind == "global" else None
        classifier = mlp(hidden_dim, mlp_dim, 1, layer=ACTIVATIONS[activation])
        self.classifier = nn.Sequential(*list(classifier)[:-1]) if signed else classifier
        init_like_sgan(self)

    def forward(self, displacements: Tensor, start: Tensor, crowd: Crowd) -> Tensor:
        """Return scores (P,) of displacements (P, T, 2), metres, from places ``start`` (P, 2) in the world.

        They are never negative unless ``signed``; real people should score high.
        """
        return self._classify(self.encoder(displacements), start, crowd)

    def of_futures(self, observed: Tensor, futures: Tensor, start: Tensor, crowd: Crowd) -> Tensor:
        """Return scores (N * P,) of futures (N, P, T, 2) of people who were observed (P, 7, 2), metres.

        The observed part is read only once. The crowd has N copies of all scenes.
        """
        hidden, cell = (state.repeat(1, len(futures), 1) for state in self.encoder.states(observed))
        hidden, _ = self.encoder.states(futures.flatten(0, 1), (hidden, cell))
        return self._classify(hidden[0], start.repeat(len(futures), 1), crowd)

    def _classify(self, hidden: Tensor, start: Tensor, crowd: Crowd) -> Tensor:
        if self.pooling is not None:
            hidden = self.pooling(hidden, start, crowd)
        return self.classifier(hidden).squeeze(-1)
