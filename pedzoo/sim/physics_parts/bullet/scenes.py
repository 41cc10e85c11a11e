"""The floor plans of a bank in pybullet, and scenes of people in the frames of these floor plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.maps.bank import MapBank
from pedzoo.sim.physics_parts.bodies import Bodies
from pedzoo.sim.physics_parts.bullet.scene import BulletScene
from pedzoo.sim.physics_parts.frames import Affine, scene_to_grid

_AFFINES = 1024
"""Maps between frames that are kept."""


class PlacedScene(NamedTuple):
    """One scene of a question.

    Attributes:
        index: Which of the B scenes.
        bullet: Where its floor plan is built.
        affine: From the scene to pybullet's frame.
        places: Where agents are in pybullet's frame (A, 2), metres.
        present: Numbers of the agents that are there, in ascending order.
    """

    index: int
    bullet: BulletScene
    affine: Affine
    places: NDArray[np.float64]
    present: list[int]


class BulletScenes:
    """One pybullet client per floor plan, made when it is first asked about; copies make their own."""

    def __init__(self, bank: MapBank, body_radius: float, urdf: str | None = None) -> None:
        """Take the floor plans, the usual radius of bodies, metres, and the file of robots' bodies."""
        self.bank, self.body_radius, self.urdf = bank, body_radius, urdf
        self._scenes: dict[int, BulletScene] = {}
        self._affines: dict[tuple[float, ...], Affine] = {}
        self._closed = False

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_scenes": {}}

    def __getitem__(self, row: int) -> BulletScene:
        """Return the client of a floor plan by its row in the bank, -1 for the open floor.

        Raises:
            UserError: All were closed, or this client is gone.
        """
        if self._closed:
            raise UserError("this Bullet was closed: make a new one, Bullet(bank)")
        if row not in self._scenes:
            grid = self.bank.grids[row] if row >= 0 else None
            self._scenes[row] = BulletScene(grid, self.bank.unknown, self.body_radius, self.urdf)
        self._scenes[row].check()
        return self._scenes[row]

    def close(self) -> None:
        """Disconnect all clients."""
        for scene in self._scenes.values():
            scene.close()
        self._scenes.clear()
        self._closed = True

    def placed(self, people: Bodies, present: Tensor) -> Iterator[PlacedScene]:
        """Yield scene after scene, with those of their agents that are ``present`` (B, A) bool."""
        rows = self.bank.index(people.map_id[:, 0]).tolist()
        places, poses = as_array(people.position), people.pose.tolist()
        for index, (row, pose, here) in enumerate(zip(rows, poses, present.tolist(), strict=True)):
            affine = self._affine(row, pose)
            present_people = [person for person, there in enumerate(here) if there]
            yield PlacedScene(index, self[row], affine, moved(affine, places[index]), present_people)

    def _affine(self, row: int, pose: list[float]) -> Affine:
        """Return the map from a scene to pybullet's frame, made once: poses stay as they are."""
        key = (row, *pose)
        if key not in self._affines:
            if len(self._affines) >= _AFFINES:
                self._affines.clear()
            grid = self.bank.grids[row] if row >= 0 else None
            self._affines[key] = scene_to_grid(torch.tensor(pose), grid)
        return self._affines[key]


def as_array(points: Tensor) -> NDArray[np.float64]:
    """Return a tensor as numpy's doubles."""
    return points.detach().cpu().double().numpy()


def moved(affine: Affine, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (..., 2) by an affine map."""
    return points @ affine[:, :2].T + affine[:, 2]


def scene_rays(
    asked: PlacedScene,
    radius: list[float],
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float64]:
    """Return how far rays of one scene go (R,), metres, at most ``reach``.

    Args:
        asked: The scene.
        radius: Of all agents' bodies, metres.
        start: Where rays begin (R, 2) in pybullet's frame.
        along: Unit vectors (R, 2).
        reach: Metres.
    """
    asked.bullet.clear()
    for person in asked.present:
        asked.bullet.place(person, *asked.places[person], radius=radius[person])
    # pybullet hits some bodies from inside and others not: bodies around the start are taken away
    starts, of = np.unique(start, axis=0, return_inverse=True)
    apart = starts[:, None] - asked.places[None, asked.present]
    holds = np.square(apart).sum(-1) <= np.square([radius[person] for person in asked.present])
    groups, group = np.unique(holds, axis=0, return_inverse=True)
    group = group.reshape(-1)[of.reshape(-1)]
    result = np.full(len(start), reach)
    for number, held in enumerate(groups):
        taken = [person for person, inside in zip(asked.present, held, strict=True) if inside]
        for person in taken:
            asked.bullet.remove(person, radius[person])
        rays = np.flatnonzero(group == number)
        result[rays] = reach * asked.bullet.rays(start[rays], start[rays] + reach * along[rays])
        for person in taken:
            asked.bullet.place(person, *asked.places[person], radius=radius[person])
    result[asked.bullet.in_wall(start)] = 0.0
    return result
