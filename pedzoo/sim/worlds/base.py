"""What every world answers, whatever it is made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.geometry import move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.local_walls import LocalWalls
from pedzoo.sim.dynamics import SKIN
from pedzoo.sim.worlds.camera import Camera
from pedzoo.types import BODY_RADIUS

REACH = 5.0
"""Metres beyond which nobody asks what is there."""


class People(NamedTuple):
    """Who is where in B scenes.

    Attributes:
        position: Scene positions (B, A, 2), metres.
        mask: Who is present (B, A) bool.
        map_id: Floor plan of each scene (B, 1) long, -1 for none.
        pose: How each scene lies on its floor plan (B, 4).
    """

    position: Tensor
    mask: Tensor
    map_id: Tensor
    pose: Tensor


class Distances(NamedTuple):
    """How near others and walls are to each person; absent people have the reach and no normals.

    Attributes:
        agent: Least distance between centres (B, A), metres; the reach where nobody is nearer.
        wall: Signed distance from the centre to the nearest wall (B, A), metres, at most the reach.
        agent_normal: Unit vectors (B, A, 2) away from the nearest person, 0 where nobody is within reach.
        wall_normal: Unit vectors (B, A, 2) away from the nearest wall, 0 where none is within reach.
    """

    agent: Tensor
    wall: Tensor
    agent_normal: Tensor
    wall_normal: Tensor


class Contacts(NamedTuple):
    """Who touches whom at each trace point.

    Attributes:
        agent: Whether another person is touched at trace point s (B, A, S) bool.
        wall: Whether a wall is touched (B, A, S) bool.
    """

    agent: Tensor
    wall: Tensor


class World(ABC):
    """Answers questions about people at given places on given floor plans, and never moves anybody.

    A world keeps nothing between two questions, so one world serves any number of scenes on the floor plans
    of its bank. People whose position is not finite are treated as absent.

    Attributes:
        bank: The floor plans.
        body_radius: Radius of everybody's body, metres.
    """

    def __init__(self, bank: MapBank, body_radius: float = BODY_RADIUS) -> None:
        """Take the floor plans.

        Raises:
            UserError: The radius is too small.
        """
        if not body_radius > SKIN:
            raise UserError(
                f"body_radius {body_radius}: expected metres above {SKIN}, by which a body gives at walls, "
                f"like {BODY_RADIUS}"
            )
        self.bank = bank
        self.body_radius = body_radius

    @abstractmethod
    def distances(self, people: People, reach: float = REACH) -> Distances:
        """Return the distances to the nearest person and wall, as far as ``reach`` metres.

        Raises:
            UserError: ``reach`` is farther than the bank knows walls.
        """

    @abstractmethod
    def contacts(self, path: Tensor, people: People, walls: LocalWalls | None = None) -> Contacts:
        """Return who touches somebody or a wall on the way.

        People touch when their centres are closer than two body radii, a wall is touched by a centre closer
        than one. A trace point counts when any of its sub-steps does.

        Args:
            path: Positions after ``people.position`` (B, A, S, M, 2): M sub-steps up to each trace point.
            people: Where everybody starts, and who is present.
            walls: As people see them (`MapBank.walls_of_people`), from those who have them at hand.
        """

    @abstractmethod
    def rays(self, people: People, origin: Tensor, direction: Tensor, reach: float = REACH) -> Tensor:
        """Return how far rays go before they meet a wall or a body (B, R), metres; else ``reach``.

        A ray that starts inside a body does not see that body; one that starts inside a wall goes nowhere.

        Args:
            people: Whose bodies are in the way.
            origin: Where each ray starts (B, R, 2), scene positions.
            direction: Unit vectors (B, R, 2).
            reach: Greatest length, metres.
        """

    @abstractmethod
    def image(
        self, people: People, scene: int, size: tuple[int, int] = (640, 480), camera: Camera | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture (H, W, 3) uint8 RGB of one scene.

        Args:
            people: Who is where.
            scene: Which of the B scenes.
            size: Width and height in pixels.
            camera: Where it is taken from; by default from the top, all free space of the floor plan, or
                all people where there is none.
        """

    def close(self) -> None:  # noqa: B027 (most worlds hold nothing)
        """Give back what the world holds outside of Python; it cannot be asked afterwards."""

    def __enter__(self) -> World:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _present(self, people: People) -> Tensor:
        return people.mask & people.position.isfinite().all(-1)

    def _check_reach(self, reach: float) -> None:
        if self.bank.grids and reach > self.bank.max_distance:
            raise UserError(
                f"reach {reach} m is more than floor plans are measured for ({self.bank.max_distance} m): "
                f"make the bank with MapBank(..., max_distance={reach})"
            )

    def _plan(self, people: People, scene: int) -> OccupancyGrid | None:
        row = int(self.bank.index(people.map_id[scene].view(1)))
        return self.bank.grids[row] if row >= 0 else None

    def _framed(self, people: People, scene: int, size: tuple[int, int], camera: Camera | None) -> Camera:
        """Return a camera whose center and width are known."""
        camera = camera or Camera()
        if camera.center is not None and camera.width is not None:
            return camera
        grid = self._plan(people, scene)
        if grid is None:
            found = camera.around(people.position[scene][people.mask[scene]], size)
        else:
            corners = torch.from_numpy(_corners(grid, self.bank.unknown)).to(people.pose)
            found = camera.around(move_to_scene(corners[None], people.pose[[scene]]), size, margin=0.4)
        width = found.width if camera.width is None else camera.width
        return Camera(camera.view, camera.center or found.center, width, camera.heading, camera.pitch)


def _corners(grid: OccupancyGrid, unknown: Unknown) -> NDArray[np.float64]:
    """The corners (4, 2) of the rectangle around all free cells, in the map's frame, metres."""
    free = ~grid.occupied(unknown)
    if not free.any():
        free = ~free
    (top, bottom), (left, right) = (np.flatnonzero(free.any(axis=axis))[[0, -1]] for axis in (1, 0))
    left, right, top, bottom = left - 0.5, right + 0.5, top - 0.5, bottom + 0.5
    cells = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return grid.cells_to_map(cells)
