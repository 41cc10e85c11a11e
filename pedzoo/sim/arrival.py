"""When people reach a goal, on the 0.1 s trace and not only at decisions, and what they do next."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.sim.scenario import Scenario
from pedzoo.types import GOAL_RADIUS

LEAST_SECONDS = 20.0
"""Everybody has at least so long for a goal."""

WAYS = 4.0
"""And so many times as long as the way to it takes at the speed that they like."""


def arrived(path: Tensor, goal: Tensor, wanted: Tensor) -> Tensor:
    """Return who has come within 0.3 m of their goal until each trace point (B, A, S) bool.

    Args:
        path: Sub-steps (B, A, S, M, 2), metres.
        goal: Goals (B, A, 2).
        wanted: Who has one (B, A) bool.
    """
    # people last, (2, S, M, B, A): as `dynamics.walk` has them in memory
    x, y = path.permute(4, 2, 3, 0, 1) - goal.permute(2, 0, 1)[:, None, None]
    near = torch.addcmul(x * x, y, y).amin(1) < GOAL_RADIUS**2
    return (near & wanted).cummax(0).values.permute(1, 2, 0)


def renewed(
    scenario: Scenario, key: Tensor, goal_id: Tensor, drawn: Tensor, hit: Tensor
) -> tuple[Tensor, Tensor]:
    """Return goals and how many were drawn (B, A), with another goal for everybody who ``hit`` (B, A) one."""
    scene, slot = hit.nonzero(as_tuple=True)
    if not len(scene):
        return goal_id, drawn
    drawn = drawn + hit
    goal = scenario.next_goal(Draws(key[scene]), slot, drawn[scene, slot], goal_id[scene, slot])
    return goal_id.index_put((scene, slot), goal), drawn


def planned(way: Tensor) -> Tensor:
    """Return how far people have to walk whose ways (B, A) to their goals are so long, metres."""
    return (way.detach() - GOAL_RADIUS).clamp_min(0)


def deadline(clock: Tensor, way: Tensor, pref_speed: Tensor) -> Tensor:
    """Return when a goal at the end of ``way`` (B, A) must be reached: four times the time that it takes.

    At least 20 s from ``clock`` (B,), the end of the decision in which the goal was drawn; everything in
    seconds and metres.
    """
    return clock.unsqueeze(1) + torch.clamp(WAYS * way / pref_speed, min=LEAST_SECONDS)
