"""Anchors moved by a small network that sees nothing but a person's own track."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import nn

from pedzoo.core.types import OBS_LEN, PRED_LEN
from pedzoo.models.base import Walking
from pedzoo.models.blocks.anchored import UNIT, AnchorForecaster, AnchorInputs, AnchorLosses, ModePredictions
from pedzoo.models.blocks.mlp import init_with_zeros, mlp


@dataclass(frozen=True)
class Architecture:
    """The network's architecture; it belongs to the weights.

    Attributes:
        steps: Predicted steps of 0.4 s.
        modes: Modes, each of which begins as an anchor.
        hidden_dim: Width of the two hidden layers.
    """

    steps: int = PRED_LEN
    modes: int = 20
    hidden_dim: int = 256


class AnchorMLP(AnchorForecaster):
    """One network writes the corrections of all anchors at once; others are not seen."""

    def __init__(
        self,
        architecture: Architecture = Architecture(),
        losses: AnchorLosses = AnchorLosses(),
        walking: Walking = Walking(),
    ) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        a = architecture
        super().__init__(a.steps, a.modes, None, losses)
        self.built_with(architecture, losses, walking)
        width = a.hidden_dim
        self.body = mlp(2 * OBS_LEN, width, width, layer=nn.GELU)
        self.paths = nn.Linear(width, (a.modes + 1) * a.steps * 2)
        self.choice = nn.Linear(width, a.modes)
        self.widths = nn.Linear(width, a.steps * 2)
        init_with_zeros(self.paths, self.choice, self.widths)  # untrained, it leaves the anchors as they are

    def write(self, batch: TensorDict, seen: AnchorInputs) -> ModePredictions:
        """Return the anchors with their corrections."""
        anchors = super().write(batch, seen)
        moved = seen.history.diff(dim=1) / seen.unit.unsqueeze(-1)
        speed = torch.stack((seen.speed, (seen.unit[:, 0] / UNIT).log()), -1)
        hidden = self.body(torch.cat((moved.flatten(1), speed), -1))
        return ModePredictions(
            anchors.path + self.paths(hidden).view_as(anchors.path),
            anchors.logits + self.choice(hidden),
            anchors.log_scale + self.widths(hidden.detach()).view(-1, 1, self.steps, 2),
        )
