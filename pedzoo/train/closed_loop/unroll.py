"""Recorded people walked by a policy from where a window's observed part ends, without an environment.

What the environment would tell them in the open, step by step and differentiable: `pedzoo.sim.env` with the
scenario `replay` and no walls gives the same observations. B scenes, A people, N steps of 0.4 s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of, goals_of, maps_of
from pedzoo.core.geometry import passes_goal
from pedzoo.core.types import AHEAD_SECONDS, GOAL_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim import kernel
from pedzoo.sim.dynamics import STRIDE
from pedzoo.sim.observation import observed, state_of
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.recorded_people import top_speed_of
from pedzoo.sim.rules import Rules
from pedzoo.sim.scenario import SLOWEST
from pedzoo.sim.script import Script
from pedzoo.sim.state import TRACE_PER_STEP, Contacts, MotionInput, State

Walk = Callable[[TensorDict], Tensor]
"""Returns each person's next displacement (B, A, 2), metres, for an observation."""

_NEAR = 1e-6
"""Metres within which a person is at a place."""


class Unrolled(NamedTuple):
    """How the people of recorded windows walk on.

    Attributes:
        xy: Positions at the end of each step (B, A, N, 2), metres; the last one where they have left.
        walked: Which people a policy moves in the step (B, A, N) bool; the step in which they arrive is the
        last.
        present: Which people are present meanwhile (B, A, N) bool: these, and played-back people.
    """

    xy: Tensor
    walked: Tensor
    present: Tensor


def unroll(walk: Walk, batch: TensorDict, steps: int, key: Tensor | None = None) -> Unrolled:
    """Return the result of ``walk`` when all people of recorded windows walk together.

    In every step the goal is the point ``pref_speed`` x 3.2 s ahead on the straight line from a person to
    their destination, and beyond it. ``pref_speed`` is that observed, at least 0.3 m/s. The top speed is that
    of the scenario ``replay``. People leave within 0.3 m of their destination, at the latest when they
    really left. People at their destination from the beginning are played back, not controlled. No person is
    set back to their track. There are no walls.

    Gradients flow through all that people see, others included, but not through times of leaving.

    Args:
        walk: The policy.
        batch: Recorded windows with the goal protocol ``destination`` and at least ``steps`` of future.
        steps: N.
        key: Keys (B,) long, by which a `pedzoo.policies.walker.Walker` draws noise; 0 to B - 1 if
            None.

    Raises:
        UserError: The windows have no goals.
    """
    agents, maps, there = agents_of(batch), maps_of(batch), known_to_be_there(batch)
    destination = goals_of(batch, "walking on")[0]
    walks = agents["mask"] & _controlled(agents["history"][:, :, -1], destination)
    key = torch.arange(len(batch), device=there.device) if key is None else key
    state = state_of(batch, destination, walks, key)
    liked = state.pref_speed.clamp_min(SLOWEST)
    script = Script.of_windows(state.position, agents["future"], there, state.group)
    here = state.mask & there[..., 0]
    slot, scene = state.person, torch.arange(len(batch), device=there.device)
    state = state._replace(
        scene=scene,
        pref_speed=liked,
        top_speed=top_speed_of(liked),
        mask=here,
        controlled=walks & here,
        person=script.people_in_slots(scene, 0 * scene),
    )
    rules = Rules(_straight, TRACE_PER_STEP, STRIDE, script=script)
    guidance, physics, result = _straight(state), OpenFloor(), []
    for _ in range(steps):
        moving, here = state.controlled, state.mask
        seen = state._replace(person=slot.where(here, -1))  # a walker draws noise by the slot
        action = walk(observed(seen, guidance, maps)) / STEP_SECONDS
        state, guidance, _ = kernel.step(state, action, physics, rules)
        result.append((state.position, moving, here))
    return Unrolled(*(torch.stack(values, 2) for values in zip(*result, strict=True)))


def _straight(state: State) -> Guidance:
    """Return goals on the straight line to where people go, and beyond it."""
    position, goal = state.position, state.goal_point
    way = goal - position
    unit = _towards(position, goal)
    ahead = unit * state.pref_speed.unsqueeze(-1)
    distance = way.square().sum(-1).clamp_min(_NEAR**2).sqrt()
    return Guidance(position + ahead * AHEAD_SECONDS, ahead, goal, goal, distance)


def recorded(batch: TensorDict, steps: int) -> Unrolled:
    """Return how they really went on, with ``walked`` as a policy that walks like them would have it.

    They are ``present`` until they really leave, even if they stand about at their destination before.
    """
    agents, there = agents_of(batch), known_to_be_there(batch)[..., :steps]
    destination, xy = goals_of(batch, "walking on")[0], agents["future"][:, :, :steps]
    before = torch.cat((agents["history"][:, :, -1:], xy[:, :, :-1]), 2)
    arrives = passes_goal(before, xy, destination.unsqueeze(2))
    had = torch.cat((torch.zeros_like(arrives[..., :1]), arrives[..., :-1]), 2).cummax(2).values
    walked = there & ~had & _controlled(before[:, :, 0], destination).unsqueeze(2)
    return Unrolled(xy, walked, there)


def known_to_be_there(batch: TensorDict) -> Tensor:
    """Return which people are present from begin to end of each future step (B, A, T) bool."""
    agents = agents_of(batch)
    known: Tensor = agents["future_valid"] & agents["mask"].unsqueeze(2)
    return torch.cummin(known, 2).values


def _controlled(position: Tensor, destination: Tensor) -> Tensor:
    """Return which people are not at their destination already (B, A) bool."""
    return (destination - position).norm(dim=-1) > GOAL_RADIUS


def _towards(position: Tensor, destination: Tensor) -> Tensor:
    """Return unit vectors (B, A, 2), zero where a person is."""
    way = destination - position
    return way / way.square().sum(-1, keepdim=True).clamp_min(_NEAR**2).sqrt()


class OpenFloor(Torch):
    """Moves agents straight, or as they were recorded; differentiable."""

    def __init__(self) -> None:
        """Take no floor plan."""
        super().__init__(MapBank())

    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        nothing = torch.zeros_like(path[:, :, :, 0, 0], dtype=torch.bool)
        return Contacts(nothing, nothing)
