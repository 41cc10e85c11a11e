"""Anchors moved by one decoder that they share, with neighbours, a goal and the floor plan.

The anchors are centroids of training futures. Networks with trajectory anchors: Chai et al., "MultiPath",
CoRL 2019; a decoder that is asked for each mode by its anchor: Shi et al., "TUTR", ICCV 2023.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import unrotate
from pedzoo.core.types import OBS_LEN, PRED_LEN, GoalProtocol
from pedzoo.models.base import Walking
from pedzoo.models.blocks.anchored import UNIT, AnchorForecaster, AnchorInputs, AnchorLosses, ModePredictions
from pedzoo.models.blocks.map_encoders import ENCODERS, Viewpoints
from pedzoo.models.blocks.mlp import init_with_zeros, mlp

NEAR = 5.0  # metres: farther people are not seen

BOUND = 4.0
"""By how much the network may change the log probability of a mode, before they are made to add up to 1."""

HEADS = 4  # of the attention; each has a share of the width


@dataclass(frozen=True)
class Architecture:
    """The network's architecture; it belongs to the weights.

    Attributes:
        steps: Predicted steps of 0.4 s.
        modes: Modes.
        width: Width of the decoder and of the attention, a multiple of 4.
        own_dim: Width of the layers that read a person's own track.
        anchors: Whether modes begin as anchors; without them every mode is learned from nothing.
        neighbours: Nearest people within 5 m that are seen; 0 for none.
        goal: Whether it sees a goal; its modes then begin at the bent line to it.
        goal_protocol: The goal protocol of the training data.
        map: Encoder of the floor plan; None for no floor plan.
        map_dim: Width of its features.
    """

    steps: int = PRED_LEN
    modes: int = 20
    width: int = 96
    own_dim: int = 256
    anchors: bool = True
    neighbours: int = 8
    goal: bool = False
    goal_protocol: GoalProtocol = "none"
    map: Literal["patch", "rings"] | None = None
    map_dim: int = 16

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: a value is out of range, or settings do not go together."""
        if self.width < HEADS or self.width % HEADS or self.neighbours < 0:
            raise UserError(
                f"width {self.width}, neighbours {self.neighbours}: expected a multiple of {HEADS}, and 0 or "
                "more"
            )
        if self.goal != (self.goal_protocol != "none"):
            raise UserError(
                f"goal {self.goal} with goal_protocol {self.goal_protocol}: expected none for a model "
                "without goals, and another protocol for one that sees them"
            )


class AnchorNet(AnchorForecaster):
    """Own track, attention over neighbours, goal and plan make a context; a decoder moves each anchor."""

    def __init__(
        self,
        architecture: Architecture = Architecture(),
        losses: AnchorLosses = AnchorLosses(),
        walking: Walking = Walking(),
    ) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        a = architecture
        super().__init__(a.steps, a.modes, a.goal_protocol if a.goal else None, losses)
        self.built_with(architecture, losses, walking)
        self.architecture, width = a, a.width
        self.needs = frozenset(["goal"] * a.goal + ["map"] * (a.map is not None))
        self.own = mlp(2 * OBS_LEN + 6 * a.goal, a.own_dim, a.own_dim, layer=nn.GELU)
        if a.neighbours:
            self.other = mlp(2 * OBS_LEN + 3, width, width, layer=nn.GELU)
            self.ask, self.answer = nn.Linear(a.own_dim, width), nn.Linear(width, 2 * width)
            self.alone = nn.Parameter(torch.zeros(1, 1, 2 * width))
        self.map = ENCODERS[a.map](dim=a.map_dim) if a.map else None
        seen = a.own_dim + (width if a.neighbours else 0) + (a.map_dim if a.map else 0)
        self.context = nn.Linear(seen, width)
        self.anchor = nn.Linear(2 * a.steps, width) if a.anchors else None
        self.query = nn.Parameter(0.5 * torch.randn(a.modes + 1, width))
        self.decoder = nn.Sequential(nn.GELU(), nn.Linear(width, width), nn.GELU(), nn.Linear(width, width))
        self.paths = nn.Linear(width, 2 * a.steps)
        self.choice = nn.Linear(width, 1)
        self.widths = nn.Linear(width, 2 * a.steps)
        # the untrained network leaves the anchors as they are
        init_with_zeros(self.choice, self.widths, *([self.paths] if a.anchors else []))

    def write(self, batch: TensorDict, seen: AnchorInputs) -> ModePredictions:
        """Return the modes: anchors with what the decoder adds to them."""
        anchors, a = super().write(batch, seen), self.architecture
        context = self._context(batch, seen)
        hidden = context.unsqueeze(1) + self.query
        if self.anchor is not None:
            hidden = hidden + self.anchor(anchors.path.flatten(2))
        hidden = functional.gelu(hidden + self.decoder(hidden))
        path = self.paths(hidden).view_as(anchors.path)
        # bounded: no mode is ever impossible
        choice = BOUND * (self.choice(hidden[:, :-1]).squeeze(-1) / BOUND).tanh()
        return ModePredictions(
            path + anchors.path if a.anchors else path,
            anchors.logits + choice if a.anchors else choice,
            anchors.log_scale + self.widths(context.detach()).view(-1, 1, a.steps, 2),
        )

    def _context(self, batch: TensorDict, seen: AnchorInputs) -> Tensor:
        """Return all that is known about people (P, width)."""
        moved = seen.history.diff(dim=1) / seen.unit.unsqueeze(-1)
        own = [moved.flatten(1), (seen.unit / UNIT).log(), seen.speed.unsqueeze(-1)]
        if seen.aims is not None:
            goal, wanted = seen.aims.unbind(1)
            # far goals say no more than their direction
            near = goal / (1 + goal.norm(dim=-1, keepdim=True) / 4)
            own += [near, seen.base[:, -1] / seen.unit, wanted]
        own = self.own(torch.cat(own, -1))
        features = [own]
        if self.architecture.neighbours:
            features.append(self._neighbours(batch, seen, own))
        if self.map is not None:
            position = seen.crowd.pack(agents_of(batch)["history"])[:, -1]
            features.append(self.map(Viewpoints.of(batch, seen.crowd.scene, position, seen.heading)))
        return self.context(torch.cat(features, -1))

    def _neighbours(self, batch: TensorDict, seen: AnchorInputs, own: Tensor) -> Tensor:
        """Return what people (P, width) see of the others; one attention layer, in no order."""
        agents, crowd = agents_of(batch), seen.crowd
        there = agents["mask"]
        history = torch.where(there[..., None, None], agents["history"], 0.0)
        here = history[:, :, -1]
        count = there.shape[1]
        with torch.no_grad():
            apart = (here.unsqueeze(1) - here.unsqueeze(2)).square().sum(-1)
            alone = torch.eye(count, dtype=torch.bool, device=there.device)
            apart = apart.masked_fill(~there.unsqueeze(1) | alone, torch.inf)
            apart, other = apart.topk(min(self.architecture.neighbours, count), 2, largest=False)
        apart, other = crowd.pack(apart), crowd.pack(other)
        scene = crowd.scene.unsqueeze(1)
        place = history[scene, other] - crowd.pack(here)[:, None, None]  # (P, k, 8, 2)
        place = unrotate(place, seen.heading[:, None, None])
        distance = (place[:, :, -1].square().sum(-1, keepdim=True) + 1e-6).sqrt()
        moves = (place[:, :, -1] - place[:, :, -2]) / seen.unit.unsqueeze(1)
        features = torch.cat((place.flatten(2) / 3, moves, (-distance / 1.5).exp()), -1)
        answers = torch.cat((self.answer(self.other(features)), self.alone.expand(len(own), -1, -1)), 1)
        absent = torch.cat((apart >= NEAR**2, apart.new_zeros(len(own), 1, dtype=torch.bool)), 1)
        width = self.architecture.width
        key, value = (part.unflatten(2, (HEADS, -1)).transpose(1, 2) for part in answers.split(width, 2))
        query = self.ask(own).view(-1, HEADS, 1, width // HEADS)
        read = functional.scaled_dot_product_attention(query, key, value, ~absent[:, None, None])
        return read.flatten(1)
