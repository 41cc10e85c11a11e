"""What Social GAN's parts compute from their parameters alone, before they see anybody."""

from __future__ import annotations

from typing import NamedTuple

from pedzoo.models.blocks.mlp import MLP, Layers
from pedzoo.models.blocks.people.pooling import PoolingWeights, SocialPooling
from pedzoo.models.blocks.recurrent import (
    DecoderWeights,
    DisplacementDecoder,
    DisplacementEncoder,
    EncoderWeights,
    FirstWeights,
)


class Folded(NamedTuple):
    """What the parts' ``fold`` compute from parameters alone; None where each call shall do so."""

    encoder: EncoderWeights | None = None
    pooling: PoolingWeights | None = None
    to_decoder: Layers | None = None
    first: FirstWeights | None = None
    decoder: DecoderWeights | None = None


NOTHING = Folded()


def fold(
    encoder: DisplacementEncoder, pooling: SocialPooling | None, to_decoder: MLP, decoder: DisplacementDecoder
) -> Folded:
    """Return all of it."""
    pooled = None if pooling is None else pooling.fold()
    return Folded(encoder.fold(), pooled, to_decoder.fold(), decoder.fold_first(), decoder.fold())
