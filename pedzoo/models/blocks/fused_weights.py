"""Products of Social GAN's parameters that do not depend on people."""

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


class FusedWeights(NamedTuple):
    """Results of the parts' ``fuse``, from parameters alone; None where each call computes them."""

    encoder: EncoderWeights | None = None
    pooling: PoolingWeights | None = None
    to_decoder: Layers | None = None
    first: FirstWeights | None = None
    decoder: DecoderWeights | None = None


NOTHING = FusedWeights()


def fuse(
    encoder: DisplacementEncoder, pooling: SocialPooling | None, to_decoder: MLP, decoder: DisplacementDecoder
) -> FusedWeights:
    """Return all of it."""
    pooled = None if pooling is None else pooling.fuse()
    return FusedWeights(encoder.fuse(), pooled, to_decoder.fuse(), decoder.fuse_first(), decoder.fuse())
