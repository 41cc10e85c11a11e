"""Social GAN's discriminator: is this trajectory a person's? It sees trajectories only."""

from typing import Literal

from torch import Tensor, nn

from pedzoo.models.blocks.mlp import ACTIVATIONS, Activation, init_like_sgan, mlp
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.people.pooling import SocialPooling
from pedzoo.models.blocks.recurrent import DisplacementEncoder


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
