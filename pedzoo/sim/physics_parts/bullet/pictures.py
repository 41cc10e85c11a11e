"""Pictures of scenes in pybullet: from above, and as robots see them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.geometry import direction_of
from pedzoo.sim.physics_parts.bodies import Bodies
from pedzoo.sim.physics_parts.bullet.figure import Figure
from pedzoo.sim.physics_parts.bullet.looks import CUT_HEIGHT
from pedzoo.sim.physics_parts.bullet.scenes import PlacedScene, as_array
from pedzoo.sim.physics_parts.bullet.walls import WALL_HEIGHT
from pedzoo.sim.physics_parts.camera import VIEW_ANGLE, Camera, Lens


def from_above(
    asked: PlacedScene, people: Bodies, radius: Tensor, size: tuple[int, int], camera: Camera
) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) of a scene of bodies of ``radius`` (A,) metres; see `Physics.image`."""
    linear, shift = asked.affine[:, :2], asked.affine[:, 2]
    eye, target, up = (np.array(values) for values in camera.eye())
    for place in (eye, target):
        place[:2] = linear @ place[:2] + shift
    up[:2] = linear @ up[:2]
    figures = _figures(asked, people, radius)
    looks = asked.bullet.looks(CUT_HEIGHT)
    pinhole = eye.tolist(), target.tolist(), up.tolist()
    picture = looks.render(figures, size, pinhole, VIEW_ANGLE[camera.view])
    # in a mirrored scene, left is right
    return picture if np.linalg.det(linear) > 0 else np.ascontiguousarray(picture[:, ::-1])


def from_robots(
    placed: Iterable[PlacedScene], people: Bodies, radius: Tensor, heading: Tensor, lens: Lens
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return pictures and depths of R robots, the last of bodies of ``radius`` (B, A) metres.

    See `Physics.onboard`.
    """
    shape = (*heading.shape, lens.height, lens.width)
    pictures, depths = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
    ahead = as_array(direction_of(heading))
    first = radius.shape[1] - heading.shape[1]
    for asked in placed:
        linear = asked.affine[:, :2]
        # in a mirrored scene, left is right
        order = 1 if np.linalg.det(linear) > 0 else -1
        figures = _figures(asked, people, radius[asked.index])
        for robot in (agent for agent in asked.present if agent >= first):
            others = {agent: figure for agent, figure in figures.items() if agent != robot}
            at = asked.index, robot - first
            looks = asked.bullet.looks(WALL_HEIGHT)
            picture, depth = looks.onboard(others, figures[robot][:2], (linear @ ahead[at]).tolist(), lens)
            pictures[at], depths[at] = picture[:, ::order], depth[:, ::order]
    return pictures, depths


def _figures(asked: PlacedScene, people: Bodies, radius: Tensor) -> dict[int, Figure]:
    """Return how the agents of a scene are drawn in pybullet's frame; bodies have ``radius`` (A,) metres."""
    places, widths = asked.places.tolist(), radius.tolist()
    plain = {agent: Figure(*places[agent][:2], radius=round(widths[agent], 6)) for agent in asked.present}
    if people.stance is None:
        return plain
    heading, walked, speed, robot = (value[asked.index] for value in people.stance)
    ahead = as_array(direction_of(heading)) @ asked.affine[:, :2].T
    angle = np.arctan2(ahead[:, 1], ahead[:, 0]).tolist()
    columns = {"walked": walked.tolist(), "speed": speed.tolist(), "robot": robot.tolist()}
    return {
        agent: figure._replace(
            heading=angle[agent], **{name: values[agent] for name, values in columns.items()}
        )
        for agent, figure in plain.items()
    }
