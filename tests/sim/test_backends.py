"""Clauses 8 and 10 of the loop contract, for every physics backend and for wide bodies too."""

import math
from pathlib import Path

import pytest
import torch
from helpers.bodies import BACKENDS, Wide, commands, free_places, put
from torch import Tensor

from pedzoo.core.geometry import blended, direction_of, identity_pose, limited
from pedzoo.core.registry import PHYSICS
from pedzoo.maps.bank import MapBank
from pedzoo.sim.dynamics import SKIN
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_physics
from pedzoo.sim.physics._base import Bodies, Physics
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.state import Motion, MotionInput, State

WIDTHS = (0.15, 0.5)
MAP = "apartment.7"


def home(width: float, scenes: int, map: str = MAP) -> PedestrianEnv:
    """Return the environment of a building after its reset, with bodies of one radius."""
    env = make_env(Wide(map, width), scenes, warm_start="static")
    env.reset()
    return env


def decided(env: PedestrianEnv, state: State, wanted: Tensor) -> MotionInput:
    """Return what the kernel makes of commands (B, A, 2)."""
    command = limited(wanted.movedim(-1, 0), state.top_speed)
    velocity = limited(blended(state.velocity.movedim(-1, 0), command, env.rules.ticks), state.top_speed)
    return MotionInput(wanted, velocity, state.controlled, state.controlled, env.rules.substeps)


def moved(state: State, motion: Motion) -> State:
    past = torch.cat((state.past[:, :, motion.trace.shape[2] :], motion.trace), dim=2)
    return state._replace(past=past, velocity=(past[:, :, -1] - past[:, :, -2]) / 0.1)


def test_the_registry_lists_them_all() -> None:
    assert PHYSICS.names() == sorted(BACKENDS)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("other", ["torch", "bullet"])
def test_backends_move_agents_alike(other: str, width: float) -> None:
    """Random commands for 8 s in an apartment: traces of each decision are equal to 1e-4 m.

    At a corner a rounded digit decides whether a stride is taken. Decisions that differ for it are 0.2 to
    1 %, as many as torch itself has after a shift of 1e-6 m, and differ by a stride or two.
    """
    if other == "bullet":
        pytest.importorskip("pybullet")
    env = home(width, scenes=4 if other == "bullet" else 24)
    ours, theirs = env.physics, make_physics(other, env.bank, 0.15)
    state = put(env.state, free_places(env, width))
    generator = torch.Generator().manual_seed(1)
    apart, rounded, flags = [], [], []
    for _ in range(20):
        inputs = decided(env, state, commands(env, generator))
        one, two = ours.advance(state, inputs), theirs.advance(state, inputs)
        shift = 1e-6 * torch.randn(state.position.shape, generator=generator)
        nearly = Torch(env.bank).advance(put(state, state.position + shift), inputs)
        apart.append((one.trace - two.trace).norm(dim=-1).amax(-1))
        rounded.append((nearly.trace - one.trace).norm(dim=-1).amax(-1) > 1e-4)
        for key in ("agent_contact", "wall_contact", "reached"):
            flags.append(getattr(one, key) == getattr(two, key))
        state = moved(state, one)
    off, stride = torch.stack(apart), float(env.state.top_speed.max()) * 0.1
    rounding = float(torch.stack(rounded).float().mean())
    assert (off > 1e-4).float().mean() <= 1.5 * rounding + 2e-3 and rounding < 0.02
    assert off.max() < 2 * stride
    assert torch.stack(flags).float().mean() > 0.998
    theirs.close()


def hold(env: PedestrianEnv, physics: Physics, width: float, steps: int) -> float:
    """Return the least distance to a wall at trace points, above what a body is held at, metres."""
    state = put(env.state, free_places(env, width))
    generator, least = torch.Generator().manual_seed(2), math.inf
    for _ in range(steps):
        motion = physics.advance(state, decided(env, state, commands(env, generator)))
        gap, _ = env.bank.closest_wall(motion.trace.flatten(1, 2), state.map_id, state.pose)
        least = min(least, float(gap.min()) - (width - SKIN))
        state = moved(state, motion)
    return least


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", [Torch, Compiled])
@pytest.mark.parametrize("map", [MAP, "igibson_rs"])
def test_walls_hold_against_random_commands_at_top_speed(
    shared: Path, kind: type[Physics], width: float, map: str
) -> None:
    """In an apartment, and in a building that was measured."""
    plan = map if map == MAP else str(shared / "maps" / f"{map}.yaml")
    env = home(width, 16, map=plan)
    assert hold(env, kind(env.bank), width, 250) > -1e-3


def test_rays_meet_bodies_where_the_formula_says() -> None:
    """Bodies of all widths, some absent, some that a ray begins in, one that is nowhere."""
    generator = torch.Generator().manual_seed(0)
    position, radius = torch.rand(20, 7, 2, generator=generator) * 4, torch.rand(20, 7, generator=generator)
    position[0, 0] = torch.nan
    map_id = torch.full((20, 1), -1)
    mask = torch.rand(20, 7, generator=generator) < 0.8
    people = Bodies(position, mask, map_id, identity_pose(20), radius)
    origin = torch.rand(20, 50, 2, generator=generator) * 4
    direction = direction_of(torch.rand(20, 50, generator=generator) * 7)
    result = Torch(MapBank()).rays(people, origin, direction, 3.0)
    # |origin + t direction - position| = radius, the smaller t
    away = origin.unsqueeze(2) - position.unsqueeze(1)
    along = (away * direction.unsqueeze(2)).sum(-1)
    outside = away.square().sum(-1) - radius.unsqueeze(1) ** 2
    root = along.square() - outside
    met = (root > 0) & (along < 0) & (outside > 0) & mask.unsqueeze(1)
    expected = torch.where(met, -along - root.sqrt(), 3.0).amin(-1).clamp_max(3.0)
    torch.testing.assert_close(result, expected)
    assert 0.2 < (result < 3).float().mean() < 0.9
