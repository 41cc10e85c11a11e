"""What models with anchors are made of: losses, people as they are seen, and what is said about them."""

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from pedzoo.models.blocks.people.crowd import Crowd


@dataclass(frozen=True)
class AnchorLosses:
    """Losses of the training, metres unless they say otherwise.

    Attributes:
        final_weight: Weight of the best final error beside the best average one.
        guess_weight: Weight of the average error of the one best guess.
        choice_weight: Weight of the cross-entropy, nats, of the mode that was best.
        reverse: Whether half of the batches run backwards in time.
    """

    final_weight: float = 0.5
    guess_weight: float = 0.5
    choice_weight: float = 0.1
    reverse: bool = True


class AnchorInputs(NamedTuple):
    """The people of a batch, each in their own frame.

    Attributes:
        history: Positions (P, 8, 2) from the last one, metres.
        goal: Goal and desired velocity (P, 4), metres and m/s; None without a goal.
        base: Positions (P, T, 2) that anchors are added to, metres.
        speed: Last displacement's length (P,), metres.
        unit: Metres (P, 1) of one unit of the anchors.
        heading: Directions of the frames (P, 2).
        crowd: The packing.
    """

    history: Tensor
    goal: Tensor | None
    base: Tensor
    speed: Tensor
    unit: Tensor
    heading: Tensor
    crowd: Crowd


class ModePredictions(NamedTuple):
    """What a model says about P people, in units of the anchors.

    Attributes:
        path: Positions (P, M + 1, T, 2) from the base: modes, and last the one best guess.
        logits: Unnormalised log probabilities of the modes (P, M).
        log_scale: Log standard deviations of displacements (P, M, T, 2).
    """

    path: Tensor
    logits: Tensor
    log_scale: Tensor
