"""Social-VRNN: a variational recurrent network whose output is a mixture of whole futures.

Brito, Zhu, Pan and Alonso-Mora, "Social-VRNN: One-Shot Multi-modal Trajectory Prediction for Interacting
Pedestrians", CoRL 2020, arXiv:2010.09056. The inputs x are people's tracks, the occupancy map around them
and the others' relative states. One pass gives a mixture of Gaussians over all future displacements y.

Beyond the paper: each person's own frame, displacements relative to the last one repeated, pooling instead
of an LSTM over the others, distances to walls instead of an autoencoder's features, and a loss of the most
likely future alone. The posterior sees the future, q(z | x, y) (Sohn et al., NeurIPS 2015): with x alone,
the bound is highest if the latent z means nothing. As in the published code, there is no diversity term.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence
from torch.nn import functional

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.models.base import Forecaster, Random, known_displacements, normal, true_displacements
from pedzoo.models.blocks.map_encoders import PatchEncoder, Viewpoints
from pedzoo.models.blocks.mixture import FutureMixture
from pedzoo.models.blocks.people import ego_frame, linear_extrapolation
from pedzoo.models.blocks.people.approach import RelativePooling
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.recurrent import DisplacementEncoder


class EncodedPeople(NamedTuple):
    """Values of the people of a batch that do not depend on a draw."""

    features: Tensor  # the inputs x (P, D), encoded
    prior: Normal  # distribution p(z | x) of the latents (P, latent_dim)
    last: Tensor  # last displacements (P, 2) in each person's frame
    heading: Tensor  # directions of these frames (P, 2)
    crowd: Crowd


@dataclass(frozen=True)
class Architecture:
    """The network's architecture; it belongs to the weights.

    Attributes:
        embedding_dim: Width of embedded displacements.
        state_dim: Width of the LSTM over a person's track.
        others_dim: Width of the features of others; 0 to leave them out.
        map: Encoder of the occupancy map around the person; None to leave it out.
        map_dim: Width of its features.
        latent_dim: Width of the latent z.
        hidden_dim: Width of all layers between.
        components: Futures in the mixture.
        min_scale: Smallest standard deviation, metres per step. Standing people are recorded at exactly one
            place, and without it the likelihood of that would have no bound.
    """

    embedding_dim: int = 16
    state_dim: int = 32
    others_dim: int = 16
    map: Literal["patch"] | None = "patch"
    map_dim: int = 8
    latent_dim: int = 8
    hidden_dim: int = 64
    components: int = 3
    min_scale: float = 0.02

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: a value is out of range."""
        if self.latent_dim < 1 or self.components < 1 or self.min_scale <= 0:
            raise UserError(
                f"latent_dim {self.latent_dim}, components {self.components}, min_scale {self.min_scale}: "
                "expected at least 1, at least 1, and above 0 m"
            )


@dataclass(frozen=True)
class Losses:
    """Losses of the training.

    Attributes:
        kl_weight: Weight of the divergence of posterior and prior; at 1 the loss is the bound itself.
        mode_weight: Weight of the mean distance, metres, of the one most likely future from the truth.
        map_dropout: Share of a floor plan's features left out in training: recordings have few floor plans,
            which a network soon knows by heart.
    """

    kl_weight: float = 1.0
    mode_weight: float = 0.0
    map_dropout: float = 0.0


class LatentHead(nn.Module):
    """A small network that says how a latent is distributed: a diagonal Gaussian per person."""

    def __init__(self, input_dim: int, hidden_dim: int, latent_dim: int) -> None:
        """Create the parameters."""
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(input_dim, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, 2 * latent_dim)
        )

    def forward(self, *inputs: Tensor) -> Normal:
        """Return the distribution of the latents (P, latent_dim), given ``inputs`` (P, ...) side by side."""
        mean, scale = self.net(torch.cat(inputs, -1)).chunk(2, -1)
        # 1 where the network says 0, and never so small that a divergence overflows
        return Normal(mean, functional.softplus(scale + 0.5413) + 1e-3, validate_args=False)


class MixtureDecoder(nn.Module):
    """An LSTM that writes all components of a `FutureMixture`, for any number of steps.

    Nothing sampled is fed back: one pass gives every component at every step. The LSTM starts from the
    context and reads the latent at each step.
    """

    def __init__(self, context_dim: int, a: Architecture) -> None:
        """Create the parameters: ``context_dim`` is the width of a person's features."""
        super().__init__()
        self.components, self.min_scale = a.components, a.min_scale
        self.start = nn.Linear(context_dim + a.latent_dim, a.hidden_dim)
        self.lstm = nn.LSTM(a.latent_dim, a.hidden_dim)
        self.output = nn.Linear(a.hidden_dim, 4 * a.components)
        self.logits = nn.Linear(a.hidden_dim, a.components)

    def forward(self, context: Tensor, latent: Tensor, base: Tensor) -> FutureMixture:
        """Return each person's mixture; its means are added to displacements ``base`` (P, T, 2)."""
        people, steps = base.shape[:2]
        start = self.start(torch.cat((context, latent), -1)).tanh()
        state = start.unsqueeze(0), torch.zeros_like(start).unsqueeze(0)
        hidden, _ = self.lstm(latent.expand(steps, *latent.shape), state)
        written = self.output(hidden).view(steps, people, self.components, 4).permute(1, 2, 0, 3)
        mean, scale = written.split(2, -1)
        # as large as walking people's changes of velocity at first, not as their velocities
        scale = 0.1 * functional.softplus(scale) + self.min_scale
        return FutureMixture(self.logits(start), base.unsqueeze(1) + 0.1 * mean, scale)


class SocialVRNN(Forecaster):
    """Encoders of state, others and map; prior and posterior of one latent; a decoder of mixtures."""

    def __init__(self, architecture: Architecture = Architecture(), losses: Losses = Losses()) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        super().__init__()
        self.built_with(architecture, losses)
        a = architecture
        self.latent_dim, self.noise_dim = a.latent_dim, a.latent_dim + 1
        self.losses = losses
        self.needs = frozenset(["map"] * (a.map is not None))
        self.state = DisplacementEncoder(a.embedding_dim, a.state_dim)
        self.others = RelativePooling(a.hidden_dim, a.others_dim) if a.others_dim else None
        self.map = PatchEncoder(dim=a.map_dim) if a.map else None
        self.map_dropout = nn.Dropout(losses.map_dropout)
        width = a.state_dim + a.others_dim + (a.map_dim if a.map else 0)
        self.future = DisplacementEncoder(a.embedding_dim, a.state_dim)
        self.prior = LatentHead(width, a.hidden_dim, a.latent_dim)
        self.posterior = LatentHead(width + a.state_dim, a.hidden_dim, a.latent_dim)
        self.decoder = MixtureDecoder(width, a)

    def see(self, batch: TensorDict) -> EncodedPeople:
        """Return the known features of all people."""
        agents = agents_of(batch)
        crowd = Crowd.of(agents["mask"])
        history = crowd.pack(agents["history"])
        position, moved = history[:, -1], history.diff(dim=1)
        heading = ego_frame.heading(moved, None)
        own = ego_frame.into(heading, moved)
        features = [self.state(own)]
        if self.others is not None:
            features.append(self.others(position, moved[:, -1], heading, crowd))
        if self.map is not None:
            features.append(self.map_dropout(self.map(Viewpoints.of(batch, crowd.scene, position, heading))))
        joined = torch.cat(features, -1)
        return EncodedPeople(joined, self.prior(joined), own[:, -1], heading, crowd)

    def mixture(self, seen: EncodedPeople, latent: Tensor, steps: int) -> FutureMixture:
        """Return p(y | z, x) in each person's frame, of K x P people for latents (K, P, latent_dim)."""
        samples = latent.shape[0]
        base = linear_extrapolation.constant_velocity(seen.last, steps).repeat(samples, 1, 1)
        written = self.decoder(seen.features.repeat(samples, 1), latent.flatten(0, 1), base)
        return FutureMixture(*(values.view(samples, -1, *values.shape[1:]) for values in written))

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return random futures (B, K, A, T, 2), of random latent, component and position in it."""
        seen = self.see(batch)
        z = _draw(seen.prior, samples, generator)
        mixture = self.mixture(seen, z, steps)
        component = mixture.at_quantile(torch.special.ndtr(normal(z[..., 0], generator)))
        path, scale = mixture.mean_of(component), mixture.scale_of(component)
        return self._world(seen, path + scale * normal(path, generator))

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the mean (B, 1, A, T, 2) of the most likely component, at the mode of the latent."""
        seen = self.see(batch)
        return self._world(seen, self._most_likely(seen, steps))

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first steps of one future (B, A, steps, 2); no others are decoded.

        The noise chooses latent and component; the component's mean is walked. What it leaves open is
        independent at each step, and noise that stays for an episode would make it a drift.
        """
        if noise is None:
            return self.mode(batch, steps)[:, 0]
        seen = self.see(batch)
        drawn = seen.crowd.pack(noise)
        z = seen.prior.mean + seen.prior.stddev * drawn[:, :-1]
        mixture = self.mixture(seen, z.unsqueeze(0), steps)
        component = mixture.at_quantile(torch.special.ndtr(drawn[:, -1]).unsqueeze(0))
        return self._world(seen, mixture.mean_of(component))[:, 0]

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return minus the evidence lower bound, nats per step, summed over people.

            E_q(z | x, y) [log p(y | z, x)] - KL(q(z | x, y) || p(z | x))

        with one draw of z, and ``mode_weight`` times the mean distance of `mode` from the truth.
        """
        seen = self.see(batch)
        truth, known, posterior = self._infer(batch, seen)
        mixture = self.mixture(seen, _draw(posterior, 1, generator), truth.shape[1])
        divergence = kl_divergence(posterior, seen.prior).sum(-1) * known.any(-1)
        cost = self.losses.kl_weight * divergence - mixture.log_prob(truth, known).squeeze(0)
        if self.losses.mode_weight:
            wrong = (self._most_likely(seen, truth.shape[1]).squeeze(0) - truth).cumsum(1)
            # the root has no slope at zero
            distance = (wrong.square().sum(-1) + 1e-8).sqrt()
            # after a gap in the displacements the way is not known any more
            cost = cost + self.losses.mode_weight * (distance * known.cumprod(1)).sum(-1)
        return cost.sum() / truth.shape[1]

    @torch.no_grad()
    def log_likelihood(self, batch: TensorDict, generator: Random = None, samples: int = 20) -> Tensor:
        """Return a lower bound of each person's log p(y | x) (B, A), nats; 0 where nothing of y is known.

        The importance-weighted bound (Burda et al., ICLR 2016, eq. 8), which rises to the likelihood with the
        number of ``samples`` K:

            log 1/K sum_k p(y | z_k, x) p(z_k | x) / q(z_k | x, y),  z_k ~ q.
        """
        seen = self.see(batch)
        truth, known, posterior = self._infer(batch, seen)
        z = _draw(posterior, samples, generator)
        weight = (seen.prior.log_prob(z) - posterior.log_prob(z)).sum(-1)
        nats = self.mixture(seen, z, truth.shape[1]).log_prob(truth, known) + weight
        bound = nats.logsumexp(0) - math.log(samples)
        return seen.crowd.unpack(bound * known.any(-1))

    def _most_likely(self, seen: EncodedPeople, steps: int) -> Tensor:
        """Return the likeliest component's mean (1, P, T, 2) in each person's frame, at the mode."""
        mixture = self.mixture(seen, seen.prior.mean.unsqueeze(0), steps)
        return mixture.mean_of(mixture.most_likely())

    def _infer(self, batch: TensorDict, seen: EncodedPeople) -> tuple[Tensor, Tensor, Normal]:
        """Return true displacements (P, T, 2) in people's frames, which are known, and the posterior."""
        truth = ego_frame.into(seen.heading, seen.crowd.pack(true_displacements(batch)))
        known = seen.crowd.pack(known_displacements(batch))
        surprise = (truth - seen.last.unsqueeze(1)) * known.unsqueeze(-1)
        return truth, known, self.posterior(seen.features, self.future(surprise))

    def _world(self, seen: EncodedPeople, path: Tensor) -> Tensor:
        """Return paths (K, P, T, 2) of each person's frame as displacements in the world (B, K, A, T, 2)."""
        return seen.crowd.unpack_samples(ego_frame.out_of(seen.heading, path))


def _draw(given: Normal, samples: int, generator: Random) -> Tensor:
    """Return draws (K, P, D) of a distribution (P, D), which pass gradients on to it."""
    like = given.mean.expand(samples, *given.mean.shape)
    return given.mean + given.stddev * normal(like, generator)
