"""Social GAN's generator, composed with a goal and a floor plan.

Gupta et al., "Social GAN: Socially acceptable trajectories with generative adversarial networks", CVPR
2018; the goal and the map as in "Interactive Pedestrian Simulation in iGibson". One class is every
variant: an option that is off costs nothing and leaves the published network.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import agents_of, goals_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import PRED_LEN, STEP_SECONDS, TIMED, GoalProtocol
from pedzoo.models.base import Forecaster, Random, Walking, normal
from pedzoo.models.blocks.map_encoders import ENCODERS, Viewpoints
from pedzoo.models.blocks.mlp import ACTIVATIONS, Activation, init_like_sgan, init_with_zeros, mlp
from pedzoo.models.blocks.people import ego_frame, linear_extrapolation
from pedzoo.models.blocks.people.approach import ApproachPooling, OwnFramePooling
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.people.pooling import SocialPooling
from pedzoo.models.blocks.recurrent import DisplacementDecoder, DisplacementEncoder
from pedzoo.models.blocks.variety import VarietyLoss

CATCHING_UP = 0.5
"""Of the difference from the speed that people like, in a step: about as the model gets faster and slower."""

TURNED, FACING = 0.5, 0.9
"""Cosines between the way and a step: those who turn farther away walk as the model says, as they turn."""


class Encoded(NamedTuple):
    """Values that do not depend on the noise: computed once for all samples of a batch."""

    context: Tensor  # decoder state without its noise (P, decoder_dim - noise_dim)
    first: Tensor  # last observed displacement (P, 2), in each person's frame
    base: Tensor | None  # displacements in the world (P, T, 2) that the network's output is added to
    heading: Tensor | None  # direction of each person's frame (P, 2); None for the world's
    crowd: Crowd


@dataclass(frozen=True)
class Architecture:
    """The network's architecture; it belongs to the weights.

    Attributes:
        embedding_dim: Width of embedded displacements.
        encoder_dim: Width of the encoder LSTM.
        decoder_dim: Width of the decoder LSTM.
        mlp_dim: Width of the hidden layer between encoder and decoder.
        noise_dim: Width of the noise z.
        noise: One z per ``scene`` (published models) or per ``agent``; ``mixed`` likewise, and half of it is
            redrawn at every step of walking people.
        bottleneck_dim: Width of social pooling; 0 for none.
        activation: Of the layer before the decoder.
        conditions: Where features of goal and floor plan go: through the ``context`` layer before the
            decoder, or beside its result into the ``decoder``, as in the paper.
        goal_dim: Width of the goal's linear layer; 0 for no goal.
        goal_protocol: The goal protocol of the training data.
        map: Floor plan encoder; None for no floor plan.
        map_dim: Width of its features.
        approach_dim: Width of features of people's closest approach; 0 for none.
        trait_dim: Width of the network by which noise changes the reading of a situation; 0 for none.
        frame: Directions in the ``world``, or in each person's own ``heading``, so that turning the scene
            turns the answer. Social pooling is in the same frame. ``way`` is the direction to the goal,
            which does not turn with every small step.
        residual: The trivial continuation that the output is added to.
    """

    embedding_dim: int = 16
    encoder_dim: int = 32
    decoder_dim: int = 32
    mlp_dim: int = 64
    noise_dim: int = 8
    noise: Literal["scene", "agent", "mixed"] = "scene"
    bottleneck_dim: int = 0
    activation: Activation = "relu"
    conditions: Literal["context", "decoder"] = "context"
    goal_dim: int = 0
    goal_protocol: GoalProtocol = "none"
    map: Literal["patch", "alexnet", "rings"] | None = None
    map_dim: int = 32
    approach_dim: int = 0
    trait_dim: int = 0
    frame: Literal["world", "heading", "way"] = "world"
    residual: Literal["none", "constant_velocity", "bent_line"] = "none"

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: settings that do not go together."""
        if not 0 < self.noise_dim < self.decoder_dim:
            raise UserError(
                f"noise_dim {self.noise_dim}: expected 1 to {self.decoder_dim - 1}, a part of decoder_dim "
                f"{self.decoder_dim}"
            )
        if self.residual == "bent_line" and not self.goal_dim:
            raise UserError(
                "residual bent_line bends to the goal: set goal_dim, or residual constant_velocity"
            )
        if self.frame == "way" and not self.goal_dim:
            raise UserError("frame way is that of the way to the goal: set goal_dim, or frame heading")


class ContextNoise(nn.Module):
    """Adds to a context the output of a small network for it and the noise together.

    A decoder that starts from [context; z] adds the two in every gate, so z can shift what people do and
    hardly choose between two ways of doing it. Untrained, it adds nothing.
    """

    def __init__(self, context_dim: int, noise_dim: int, hidden_dim: int) -> None:
        """Create the parameters."""
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(context_dim + noise_dim, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, context_dim)
        )
        init_with_zeros(cast("nn.Linear", self.net[-1]))

    def forward(self, context: Tensor, z: Tensor) -> Tensor:
        """Return the context (..., C) of people with the noise ``z`` (..., noise_dim)."""
        return context + self.net(torch.cat((context, z), -1))


class SGAN(Forecaster):
    """Encoder, pooling, conditions, noise, decoder."""

    mode_at_zero = True

    def __init__(
        self,
        architecture: Architecture = Architecture(),
        losses: VarietyLoss = VarietyLoss(),
        walking: Walking = Walking(),
    ) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        super().__init__()
        self.built_with(architecture, losses, walking)
        a = architecture
        self.goal_protocol, self.losses = a.goal_protocol, losses
        self.noise_dim, self.noise, self.frame, self.residual = a.noise_dim, a.noise, a.frame, a.residual
        self.walking_noise = "mixed" if a.noise == "mixed" else "episode"
        map_dim = a.map_dim if a.map else 0
        self.needs = frozenset(["goal"] * (a.goal_dim > 0) + ["map"] * (a.map is not None))
        self.encoder = DisplacementEncoder(a.embedding_dim, a.encoder_dim)
        self.pooling = None
        if a.bottleneck_dim:
            widths = a.encoder_dim, a.embedding_dim, 512, a.bottleneck_dim
            world = a.frame == "world"
            self.pooling = (
                SocialPooling(*widths) if world else OwnFramePooling(a.encoder_dim, a.bottleneck_dim)
            )
        self.goal = nn.Linear(4, a.goal_dim) if a.goal_dim else None
        seen = a.encoder_dim + a.bottleneck_dim + a.approach_dim
        self.beside = (a.goal_dim + map_dim) * (a.conditions == "decoder")
        seen += a.goal_dim + map_dim - self.beside
        context_dim = a.decoder_dim - a.noise_dim - self.beside
        self.to_decoder = mlp(seen, a.mlp_dim, context_dim, layer=ACTIVATIONS[a.activation])
        self.decoder = DisplacementDecoder(a.embedding_dim, a.decoder_dim)
        init_like_sgan(self)
        # after the published initialisation: these bring their own
        self.map = ENCODERS[a.map](dim=map_dim) if a.map else None
        self.map_dropout = nn.Dropout(losses.map_dropout)
        self.approach = ApproachPooling(a.encoder_dim, a.approach_dim) if a.approach_dim else None
        if late := map_dim * (not self.beside) + a.approach_dim:
            # the untrained network looks at neither: they are listened to as far as they help
            nn.init.zeros_(cast("nn.Linear", self.to_decoder[0]).weight[:, -late:])
        given = a.decoder_dim - a.noise_dim, a.noise_dim, a.trait_dim
        self.trait = ContextNoise(*given) if a.trait_dim else None
        if a.residual != "none":
            # the untrained network is the trivial continuation itself
            init_with_zeros(self.decoder.output)

    def encode(self, batch: TensorDict, steps: int, alone: bool = False) -> Encoded:
        """Return all that does not depend on the noise; ``alone``: all people twice, then without others."""
        agents = agents_of(batch)
        crowd = Crowd.of(agents["mask"])
        history = crowd.pack(agents["history"])
        position, moved = history[:, -1], history.diff(dim=1)
        last_step = moved[:, -1]
        aims = goal = heading = None
        if self.goal is not None:
            goal, wanted = (crowd.pack(value) for value in goals_of(batch, "this model"))
            goal = goal - position
            aims = torch.stack((goal, wanted), 1)
        if self.frame == "way" and goal is not None:
            heading = ego_frame.way(moved, goal)
        elif self.frame != "world" or self.map is not None or self.approach is not None:
            heading = ego_frame.heading(moved, goal)
        frame = None if self.frame == "world" else heading
        moved = ego_frame.into(frame, moved)
        hidden = self.encoder(moved)
        features, beside = [hidden], []
        if isinstance(self.pooling, SocialPooling):
            features.append(self.pooling(hidden, position, crowd))
        elif self.pooling is not None and heading is not None:
            features.append(self.pooling(position, last_step, heading, hidden, crowd))
        conditions = beside if self.beside else features
        if self.goal is not None and aims is not None:
            conditions.append(self.goal(ego_frame.into(frame, aims).flatten(1)))
        if self.map is not None and heading is not None:
            seen = self.map(Viewpoints.of(batch, crowd.scene, position, heading))
            conditions.append(self.map_dropout(seen))
        if self.approach is not None and heading is not None:
            features.append(self.approach(position, last_step, heading, hidden, crowd))
        seen, first, base = torch.cat(features, -1), moved[:, -1], self._base(last_step, goal, steps)
        if alone:
            nobody = seen.clone()
            if self.approach is not None:
                nobody[:, -self.approach.dim :] = 0.0
            seen, first = torch.cat((seen, nobody)), first.repeat(2, 1)
            base, frame = (None if one is None else torch.cat((one, one)) for one in (base, frame))
        context = self.to_decoder(seen)
        if beside:
            context = torch.cat((context, *(one.repeat(1 + alone, 1) for one in beside)), 1)
        return Encoded(context, first, base, frame, crowd)

    def _base(self, last_step: Tensor, goal: Tensor | None, steps: int) -> Tensor | None:
        if self.residual == "none":
            return None
        if self.residual == "constant_velocity" or goal is None:
            return linear_extrapolation.constant_velocity(last_step, steps)
        return linear_extrapolation.bent_line(last_step, goal, steps, self.goal_protocol in TIMED)

    def draw(self, encoded: Encoded, samples: int, generator: Random = None) -> Tensor:
        """Return noise (K, P, noise_dim), the same for all people of a scene or not, as ``noise`` says."""
        crowd, like = encoded.crowd, encoded.context
        rows = crowd.shape[0] if self.noise == "scene" else len(like)
        z = normal(like.new_empty(samples, rows, self.noise_dim), generator)
        return z[:, crowd.scene] if self.noise == "scene" else z

    def decode(self, encoded: Encoded, z: Tensor, steps: int) -> Tensor:
        """Return displacements in the world (K, P, T, 2) for noise ``z`` (K, P, noise_dim)."""
        samples, people = z.shape[:2]
        context, first = encoded.context, encoded.first
        if encoded.base is not None:
            # the network's own output is fed back: the residual, of which nothing has been observed yet
            first = torch.zeros_like(first)
        if samples > 1:
            context, first = context.repeat(samples, 1), first.repeat(samples, 1)
        z = z.flatten(0, 1)
        if self.trait is not None:
            context = self.trait(context, z)
        path = self.decoder(torch.cat((context, z), 1), first, steps)
        path = ego_frame.out_of(encoded.heading, path.view(samples, people, steps, 2))
        return path if encoded.base is None else path + encoded.base[:, :steps]

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return random futures (B, K, A, T, 2)."""
        encoded = self.encode(batch, steps)
        path = self.decode(encoded, self.draw(encoded, samples, generator), steps)
        return encoded.crowd.unpack_samples(path)

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the future (B, 1, A, T, 2) at the mode of the noise, z = 0."""
        return self.next_steps(batch, None, steps, steps).unsqueeze(1)

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first steps of one future (B, A, steps, 2); no others are decoded."""
        encoded = self.encode(batch, horizon)
        zero = encoded.context.new_zeros(encoded.context.shape[0], self.noise_dim)
        z = zero if noise is None else encoded.crowd.pack(noise)
        return encoded.crowd.unpack(self.decode(encoded, z.unsqueeze(0), steps)[0])

    def step_and_wish(self, batch: TensorDict, noise: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the next steps (B, A, 2), metres, twice; alone, people keep their speed if they shall."""
        if not self.walking.keep_speed:
            return super().step_and_wish(batch, noise)
        encoded = self.encode(batch, PRED_LEN, alone=True)
        pack, agents = encoded.crowd.pack, agents_of(batch)
        history, wanted = pack(agents["history"]), pack(agents["desired_velocity"]) * STEP_SECONDS
        z = history.new_zeros(len(history), self.noise_dim) if noise is None else pack(noise)
        step, alone = self.decode(encoded, z.repeat(2, 1).unsqueeze(0), 1)[0, :, 0].chunk(2)
        step = encoded.crowd.unpack(at_own_speed(step, alone, history[:, -1] - history[:, -2], wanted))
        return step, step

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return the variety loss, summed over scenes."""
        return self.variety(batch, generator, sample=False)[0]

    def variety(
        self,
        batch: TensorDict,
        generator: Random = None,
        encoded: Encoded | None = None,
        sample: bool = True,
    ) -> tuple[Tensor, Tensor | None]:
        """Return the loss and, if ``sample``, a random sample (P, T, 2) for a discriminator.

        See `VarietyLoss`. ``encoded`` is the result of `encode` for this batch, if computed already.
        """
        steps = agents_of(batch)["future"].shape[2]
        seen = encoded or self.encode(batch, steps)
        z = self.draw(seen, max(self.losses.best_k, 2), generator)
        return self.losses(lambda noise: self.decode(seen, noise, steps), z, batch, seen.crowd, sample)


def at_own_speed(step: Tensor, alone: Tensor, last: Tensor, wanted: Tensor) -> Tensor:
    """Return steps (P, 2) of people who would walk at their own speed if they were alone.

    As much of a step as others leave of a step alone, they leave of it at that speed, too. A model's speed
    alone is off by -7 to +30 %.

    Args:
        step: What the model says (P, 2), metres, as all that follow.
        alone: What it would say if there were no others.
        last: Their last steps.
        wanted: Along the way, at the speed that they like.
    """
    ahead = functional.normalize(alone + 0.1 * wanted, dim=-1)
    facing = (ahead * functional.normalize(wanted, dim=-1)).sum(-1, keepdim=True)
    # some walk at an angle to their way: as much too fast on their path as they are too slow on the way
    own = wanted.norm(dim=-1, keepdim=True) / facing.clamp_min(FACING).sqrt()
    speed = torch.lerp((last * ahead).sum(-1, keepdim=True), own, CATCHING_UP)
    left = (step * ahead).sum(-1, keepdim=True) / (alone * ahead).sum(-1, keepdim=True).clamp_min(1e-3)
    share = ((facing - TURNED) / (FACING - TURNED)).clamp(0, 1) * left.clamp(0, 1)
    return step + share * (speed * ahead - alone)
