"""Baseline: people start with their last velocity and bend to where the straight walk ends."""

from pedzoo.models.architectures.straight_line import StraightLine
from pedzoo.models.blocks.people import linear_extrapolation


class BentLine(StraightLine):
    """The quadratic through the last velocity and the goal; under ``window_end`` it beats most networks."""

    path = staticmethod(linear_extrapolation.bent_line)
