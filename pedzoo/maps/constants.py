"""Lengths and roundings that torch and compiled loops share."""

import math

CANDIDATES = 4  # edges that are compared in a quarter; where more compete, the nearest are kept
INTO = 1e-5  # half cells by which a position is taken to lie beyond the border that a ray has reached
WALL = -0.2  # half cells: lower bounds of distances are below it in walls only
NO_WALL = 1e6  # metres: agents without a wall in their way may go so far
BUCKET = 0.5  # metres: the side of a bucket of segments
ON_LINE = 1e-6  # cells: lines between centres miss other centres by far more, unless they meet them
EPSILON = 1e-6  # metres: an agent so near to a point is on it
LED_ON = 0.1  # metres: agents this near to a carrot are led on as much as to it

HALF = BUCKET * math.sqrt(0.5) * (1 + 1e-4)
"""Metres from the middle of a bucket to its corners, and some for rounding: it must not lose a candidate."""

ROUNDED = -1 << 7
"""The bits of a squared distance that count. Where the common corner of two segments is nearest, rounding
does not choose between them: the first one comes first."""

SPACING = 0.3
"""Metres between points of a line of sight: with the clearance around each, no wall fits between two."""
