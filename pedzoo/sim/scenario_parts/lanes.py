"""Lanes in which people come to an encounter, one behind the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.maps.plans import Point

SPACING = 0.9
"""Metres between people one behind the other."""

ABREAST = 0.8
"""Metres between lanes."""

BEYOND = 4.0
"""Metres of the goals behind the place of the encounter."""

APART = 0.5
"""Metres between people of different lanes when they start, at least."""

FREE = 0.3
"""Metres between starts and walls, at least."""

_ASIDE = 0.45
"""Metres between the outermost lanes and walls."""


class Lane(NamedTuple):
    """People one behind the other.

    Attributes:
        people: How many.
        heading: Unit vector in which they walk.
        middle: Where they meet others, metres.
        goals: Their goals after that, metres; all take the first, but for a share of strays.
        before: Metres that they all start farther back.
        side: Lanes of one side start aside by the same length.
        aside: Metres that they start to the left or to the right of the lane, at most.
        delay: Seconds that the first of them comes late, at most.
    """

    people: int
    heading: Point
    middle: Point
    goals: tuple[Point, ...]
    before: float = 0.0
    side: int = 0
    aside: float = 0.0
    delay: float = 0.0


class Places(NamedTuple):
    """Each person's place in a lane, on each of V variants of a scene, with the lane's properties.

    Attributes:
        row: How many are before them in their lane (V, A) long.
        lane: Number of the lane (V, A) long.
        side: As of the lane (V, A) long.
        heading: As of the lane (V, A, 2).
        middle: As of the lane (V, A, 2).
        before: Metres that they start farther back (V, A).
        aside: As of the lane (V, A).
        delay: As of the lane (V, A).
        leader: The person beside them (V, A) long: the first of their side and row.
    """

    row: Tensor
    lane: Tensor
    side: Tensor
    heading: Tensor
    middle: Tensor
    before: Tensor
    aside: Tensor
    delay: Tensor
    leader: Tensor

    @classmethod
    def of(cls, variants: Sequence[Sequence[Lane]]) -> Places:
        """Return each person's place: first those in front, lane by lane, then those behind them."""
        tables = []
        for lanes in variants:
            slots = sorted((row, number) for number, lane in enumerate(lanes) for row in range(lane.people))
            row, lane = torch.tensor(slots).unbind(1)
            said = [torch.tensor([getattr(one, name) for one in lanes])[lane] for name in cls._fields[2:-1]]
            side = said[0]
            beside = (row == row.unsqueeze(1)) & (side == side.unsqueeze(1))
            places = cls(row, lane, *said, leader=beside.int().argmax(1))
            tables.append(places._replace(before=places.before + SPACING * row))
        return cls(*(torch.stack(table) for table in zip(*tables, strict=True)))

    def of_scenes(self, variant: Tensor) -> Places:
        """Return the places of B scenes (B, ...), each on the variant (B,) long of its own."""
        return Places(*(table.to(variant.device)[variant] for table in self))


def abreast(
    people: int, heading: Point, most: int, beyond: float = BEYOND, right: float = 0.0, before: float = 0.0
) -> list[Lane]:
    """Return people on their way past the origin in lanes side by side.

    Args:
        people: How many, shared out evenly.
        heading: Unit vector in which they walk.
        most: Lanes, at most.
        beyond: Metres of the goals behind the origin.
        right: Metres that the middle of the lanes keeps to the right of it.
        before: Metres that they all start farther back.
    """
    count = min(most, people)
    lanes = []
    for number in range(count):
        left = (number - (count - 1) / 2) * ABREAST - right
        middle = (-heading[1] * left, heading[0] * left)
        goal = (middle[0] + beyond * heading[0], middle[1] + beyond * heading[1])
        mine = people // count + (number < people % count)
        lanes.append(Lane(mine, heading, middle, (goal,), before))
    return lanes


def beside(lanes: Sequence[Lane], width: float) -> float:
    """Return the room beside lanes in a corridor around the origin, metres, without `FREE`."""
    across = [lane.heading[0] * lane.middle[1] - lane.heading[1] * lane.middle[0] for lane in lanes]
    return width / 2 - FREE - max((abs(value) for value in across), default=0.0)


def lanes_in(width: float) -> int:
    """Return how many lanes fit between two walls, at least one."""
    return max(1, 1 + math.floor((width - 2 * _ASIDE) / ABREAST + 1e-6))


def block(people: int) -> int:
    """Return how many lanes a group in the open has that is as broad as deep, five at most."""
    return min(5, math.ceil(math.sqrt(people)))
