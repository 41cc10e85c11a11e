"""Cases: where the robot and people start and where they go, drawn as CrowdNav draws them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.policies.local_planner import ObservedPeople, Robot
from pedzoo.sim.crowdnav.draws import Draws, on_circle
from pedzoo.sim.crowdnav.settings import RADIUS, SPEED, Setting

TEST = 1000
"""Offset of the test cases' seeds: case i of the test draws from seed 1000 + i, of the validation from i."""


class Cases(NamedTuple):
    """B cases, double precision.

    Attributes:
        robot: At its start.
        people: At their starts, at rest.
        goal: Of people (B, N, 2), metres.
        draws: What is left of each case's stream of numbers.
    """

    robot: Robot
    people: ObservedPeople
    goal: Tensor
    draws: Draws


def cases(setting: Setting, seeds: Sequence[int]) -> Cases:
    """Return the cases that are drawn from seeds.

    Args:
        setting: Whose crowd it is.
        seeds: Of numpy's legacy generator, one for each case.
    """
    draws = Draws.of_seeds(seeds)
    start, end = _errands(setting, draws)
    scenes, slots = len(start), setting.people
    place = start.new_full((scenes, slots, 2), torch.nan)
    rows = torch.arange(scenes)
    for slot in range(slots):
        others = torch.cat((start[:, None], end[:, None], place, -place), dim=1)
        place[:, slot] = free_place(setting, draws, rows, others)
    radius = place.new_full((scenes, slots), RADIUS)
    people = ObservedPeople(
        place, torch.zeros_like(place), radius, torch.ones(scenes, slots, dtype=torch.bool)
    )
    robot = Robot(start, torch.zeros_like(start), end, radius[:, 0], torch.full_like(radius[:, 0], SPEED))
    return Cases(robot, people, -place, draws)


def free_place(setting: Setting, draws: Draws, rows: Tensor, taken: Tensor) -> Tensor:
    """Return places (R, 2) near the circle that keep clear of others, each drawn until it does.

    Args:
        setting: Its circle and distances.
        draws: The streams, of which numbers are taken.
        rows: Of which cases (R,) long.
        taken: Where others are and where they go (R, K, 2), metres; NaN is nowhere.
    """
    result = taken.new_zeros(len(rows), 2)
    left = torch.arange(len(rows))
    while len(left):
        place = on_circle(setting.circle, draws.take(rows[left], 3), *setting.shift)
        result[left] = place
        apart = (place[:, None] - taken[left]).norm(dim=-1)
        left = left[(apart < 2 * RADIUS + setting.discomfort_dist).any(1)]
    return result


def _errands(setting: Setting, draws: Draws) -> tuple[Tensor, Tensor]:
    """Return the robots' starts and goals (B, 2), metres."""
    scenes = len(draws.taken)
    if setting.arena is None:
        start = torch.tensor([0.0, -setting.circle]).double().repeat(scenes, 1)
        return start, -start
    ends, left = torch.zeros(scenes, 4).double(), torch.arange(scenes)
    while len(left):
        ends[left] = setting.arena * (2 * draws.take(left, 4) - 1)
        left = left[(ends[left, :2] - ends[left, 2:]).norm(dim=-1) < setting.far]
    return ends[:, :2].clone(), ends[:, 2:].clone()
