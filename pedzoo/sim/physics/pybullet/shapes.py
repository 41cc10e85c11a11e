"""What robots of a URDF file touch on their way: closest points of their real shape."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC, speed_and_turn
from pedzoo.core.geometry import TURNS_FROM, direction_of, heading_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.dynamics import driven
from pedzoo.sim.physics.pybullet.robots import STEPS, WheelCommand
from pedzoo.sim.physics.pybullet.scene import PlacedScene, as_array, moved
from pedzoo.sim.state import Contacts, MotionInput, OwnedMotion, State


def headings(state: State, inputs: MotionInput) -> Tensor:
    """Return where agents face at all sub-steps (B, A, S, M), radians; between trace points they turn evenly.

    Agents on the common path face as the kernel turns them, agents that the backend owns turn evenly.
    """
    wheels = state.drive != HOLONOMIC
    command = torch.zeros_like(state.velocity) if inputs.command is None else inputs.command
    now, points = state, [state.heading]
    for tick in range(inputs.velocity.shape[1]):
        velocity = inputs.velocity[:, tick : tick + 1]
        _, heading, rate = driven(now, command.movedim(-1, 0), velocity)
        moved = velocity[:, 0].movedim(0, -1)
        heading = torch.where(wheels, heading, heading_of(moved, now.heading, TURNS_FROM))
        now = now._replace(heading=heading, turn_rate=rate, velocity=moved)
        points.append(heading)
    turned = torch.stack(points, dim=-1)
    if inputs.owned is not None:
        share = torch.linspace(0, 1, turned.shape[-1], device=turned.device)
        own = state.heading.unsqueeze(-1) + share * _short(inputs.owned.heading - state.heading).unsqueeze(-1)
        turned = torch.where((inputs.moving | ~wheels).unsqueeze(-1), turned, own)
    step = torch.arange(1, inputs.substeps + 1, device=turned.device) / inputs.substeps
    return turned[..., :-1, None] + step * _short(turned.diff(dim=-1)).unsqueeze(-1)


def _short(angle: Tensor) -> Tensor:
    return torch.atan2(angle.sin(), angle.cos())


def drive_by_wheels(
    placed: Iterable[PlacedScene], state: State, command: Tensor, ticks: int, substeps: int
) -> OwnedMotion:
    """Return how the robots that are ``present`` drive by their wheels; see `Physics.move_owned`."""
    path = as_array(state.position)[:, :, None, None].repeat(ticks, 2).repeat(substeps, 3)
    heading, rate = as_array(state.heading).copy(), np.zeros(state.mask.shape)
    speed = (state.velocity * direction_of(state.heading)).sum(-1)
    wanted, turn = speed_and_turn(command.unbind(-1), state.drive, state.track)
    wanted = wanted.clamp(-state.top_speed, state.top_speed)
    columns = state.heading, speed, state.turn_rate, wanted, turn
    values = as_array(torch.stack((*columns, state.acceleration, state.turn_acceleration, state.track), -1))
    at = np.round(np.arange(1, ticks * substeps + 1) * (STEPS / substeps)).astype(np.int64) - 1
    for asked in placed:
        linear, shift = asked.affine[:, :2], asked.affine[:, 2]
        mirror = 1.0 if np.linalg.det(linear) > 0 else -1.0
        drives = []
        for agent in asked.present:
            angle, v, omega, wanted_v, wanted_omega, *limits = values[asked.index, agent].tolist()
            x, y = (linear @ [math.cos(angle), math.sin(angle)]).tolist()
            turns = v, mirror * omega, wanted_v, mirror * wanted_omega
            place = asked.places[agent].tolist()
            drives.append(WheelCommand(agent, place, math.atan2(y, x), *turns, *limits))
        if not drives:
            continue
        moved_to = asked.bullet.driven.run(drives, ticks)
        places = (moved_to[:, at, :2] - shift) @ linear
        path[asked.index, asked.present] = places.reshape(len(drives), ticks, substeps, 2)
        angles = moved_to[..., 2]
        x, y = (np.stack((np.cos(angles[:, -1]), np.sin(angles[:, -1])), -1) @ linear).T
        heading[asked.index, asked.present] = np.arctan2(y, x)
        last = np.unwrap(angles[:, -STEPS - 1 :], axis=1) if ticks > 1 else np.unwrap(angles, axis=1)
        seconds = TRACE_SECONDS * (last.shape[1] - 1) / STEPS
        rate[asked.index, asked.present] = mirror * (last[:, -1] - last[:, 0]) / seconds
    tensors = (torch.from_numpy(values).to(state.velocity) for values in (path, heading, rate))
    return OwnedMotion(*tensors)


def with_shapes(
    placed: Iterable[PlacedScene],
    contacts: Contacts,
    state: State,
    path: Tensor,
    heading: Tensor,
    usual: float,
    margin: float = 0.0,
) -> Contacts:
    """Return contacts of people, and those of robots by their shapes.

    Args:
        placed: The scenes.
        contacts: Of people.
        state: Bodies.
        path: Positions at all sub-steps (B, A, S, M, 2), metres.
        heading: Where agents face at them (B, A, S, M), radians.
        usual: Radius of capsules, metres.
        margin: Metres from which on bodies touch.
    """
    agent, wall = (values.cpu().numpy().copy() for values in contacts)
    paths, radius = as_array(path), as_array(state.radius)
    ahead = as_array(direction_of(heading))
    robots = ((state.kind == ROBOT) & state.mask).cpu().numpy()
    for asked in placed:
        at, affine = asked.index, asked.affine
        x, y = np.moveaxis(ahead[at] @ affine[:, :2].T, -1, 0)
        way, faced = moved(affine, paths[at]), np.arctan2(y, x)
        _touch(asked, robots[at], way, faced, radius[at], usual, margin, agent[at], wall[at])
    return Contacts(*(torch.from_numpy(values).to(path.device) for values in (agent, wall)))


def _touch(
    asked: PlacedScene,
    robots: NDArray[np.bool_],
    path: NDArray[np.float64],
    angle: NDArray[np.float64],
    radius: NDArray[np.float64],
    usual: float,
    margin: float,
    agent: NDArray[np.bool_],
    wall: NDArray[np.bool_],
) -> None:
    """Note what the robots of a scene touch, and which people touch them.

    Args:
        asked: The scene.
        robots: Which agents have the body of the file (A,).
        path: Positions at all sub-steps (A, S, M, 2) in pybullet's frame, metres.
        angle: Where agents face at them (A, S, M) in this frame, radians.
        radius: Of all bodies (A,), metres.
        usual: Radius of capsules, metres.
        margin: Metres from which on bodies touch.
        agent: Agents that touch one another (A, S), to be written.
        wall: Agents that touch a wall (A, S), to be written.
    """
    scene, bodies = asked.bullet, asked.bullet.robots
    assert bodies is not None
    bodies.clear()
    low, high = np.split(scene.boxes, 2, axis=1)
    wide = np.where(robots, bodies.reach, radius) + margin
    mine = [number for number in asked.present if robots[number]]
    for robot in mine:
        # two robots meet once
        others = [other for other in asked.present if not robots[other] or other > robot]
        apart = np.linalg.norm(path[others] - path[robot], axis=-1)
        near = apart < (wide[others] + wide[robot])[:, None, None]
        margins = np.full(2, wide[robot])
        beside = (path[robot][..., None, :] > low - margins) & (path[robot][..., None, :] < high + margins)
        boxes = beside.all(-1)
        for tick, step in np.argwhere(near.any(0) | boxes.any(-1)).tolist():
            body = bodies.put(robot, path[robot, tick, step].tolist(), angle[robot, tick, step])
            for other in np.array(others, dtype=np.int64)[near[:, tick, step]].tolist():
                if agent[robot, tick] and agent[other, tick]:
                    continue
                place = path[other, tick, step].tolist()
                if robots[other]:
                    met, extra = bodies.put(other, place, angle[other, tick, step]), margin
                else:
                    met, extra = scene.capsule(other, place), float(radius[other]) - usual + margin
                if scene.nearer(body, met, extra):
                    agent[[robot, other], tick] = True
            if not wall[robot, tick]:
                around = scene.walls(np.flatnonzero(boxes[tick, step]))
                wall[robot, tick] = any(scene.nearer(body, part, margin) for part in around)
    bodies.clear()
