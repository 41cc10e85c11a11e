"""Baseline: typical futures of the training data, without a network; the floor under every best of K."""

from dataclasses import dataclass

from pedzoo.core.types import PRED_LEN
from pedzoo.models.blocks.anchored import AnchorForecaster, AnchorLosses


@dataclass(frozen=True)
class Architecture:
    """What belongs to the weights.

    Attributes:
        steps: Predicted steps of 0.4 s.
        modes: Centroids of every class of speeds.
    """

    steps: int = PRED_LEN
    modes: int = 20


class Anchors(AnchorForecaster):
    """The centroids of training futures in people's frames, their shares, and how far futures are off."""

    def __init__(self, architecture: Architecture = Architecture()) -> None:
        """Make room for the centroids; `prepare` finds them."""
        super().__init__(architecture.steps, architecture.modes, None, AnchorLosses())
        self.built_with(architecture)
