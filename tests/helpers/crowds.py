"""Crowds about a door, for the safety layer."""

import math
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.geometry import identity_pose, limit_speed
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.maps.walls import LocalWalls
from pedzoo.policies.clearance import ProposedSteps
from pedzoo.sim.make import make_env

ROOM = rectangles(
    [*room((-3.0, -3.0), (3.0, 3.0), 0.1), *wall((0.0, -3.0), (0.0, 3.0), 0.1, doors=[(3.0, 0.8)])]
)
"""Six metres square, with a wall along x = 0 and a door of 0.8 m in its middle."""


def around(scenes: int) -> LocalWalls:
    """Return the walls of the room as the people of scenes see them."""
    return MapBank([ROOM]).walls_around(torch.full((scenes,), ROOM.map_id), identity_pose(scenes))


def crowd(people: int, seed: int = 0, scenes: int = 64, mixed: bool = False) -> ProposedSteps:
    """Return people on a grid of 0.55 m about the door, going anywhere and coming from anywhere."""
    random = torch.Generator().manual_seed(seed)
    side = math.ceil(math.sqrt(people))
    cell = torch.cartesian_prod(torch.arange(side), torch.arange(side))[:people] - (side - 1) / 2

    def draw(*more: int) -> Tensor:
        return torch.rand(scenes, people, *more, generator=random)

    position = 0.55 * cell + 0.15 * (draw(2) - 0.5) + torch.rand(scenes, 1, 2, generator=random) - 0.5
    longest = STEP_SECONDS * (1.3 + 0.4 * draw())
    velocity = limit_speed(0.8 * torch.randn(position.shape, generator=random), longest / STEP_SECONDS)
    step = 0.4 * torch.randn(position.shape, generator=random)
    present, absent = draw() >= 0, draw() > 1
    if not mixed:
        radius = torch.full_like(longest, BODY_RADIUS)
        return ProposedSteps(position, step, longest, present, present, absent, radius, absent, velocity)
    present = draw() > 0.1
    moved = present & (draw() > 0.15)
    return ProposedSteps(
        position, step, longest, present, moved, draw() > 0.8, 0.12 + 0.1 * draw(), draw() > 0.85, velocity
    )


def steps(position: Any, step: Any, longest: float = 0.8, **more: Tensor) -> ProposedSteps:
    """Return the steps of one scene, or of several, of people who stand so far."""
    position, step = (torch.as_tensor(values, dtype=torch.float32) for values in (position, step))
    position, step = (values if values.dim() == 3 else values.unsqueeze(0) for values in (position, step))
    there = torch.ones(position.shape[:2], dtype=torch.bool)
    other = {"longest": torch.full(there.shape, longest), "present": there, "moved": there}
    other |= {"waits": torch.zeros_like(there), "robot": torch.zeros_like(there)}
    other |= {"radius": torch.full(there.shape, BODY_RADIUS), "velocity": torch.zeros_like(step.detach())}
    return ProposedSteps(position, step, **other | more)


def contacts(policy: Any, scenario: str, scenes: int = 8, decisions: int = 20, **env: Any) -> tuple[int, ...]:
    """Return how often people touch others and walls, and how many are left, after some decisions."""
    made = make_env(scenario, scenes, "compiled", **env)
    seen: Any = made.reset(seed=3)
    agent = wall = 0
    for _ in range(decisions):
        seen = made.step(policy(seen))["next"]
        info = seen["agents", "info"]
        agent, wall = agent + int(info["agent_contact"].sum()), wall + int(info["wall_contact"].sum())
        if bool(seen["done"].all()):
            break
    return agent, wall, int(made.state.mask.sum())
