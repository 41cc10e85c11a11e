"""The floor plans of a datamodule or an environment, and distances to their walls for all agents at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pedzoo.core.adapters import assert_on_device
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import turn_matrix
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.segments import Segments
from pedzoo.maps.walls import LocalWalls, Walls


@dataclass(frozen=True, eq=False)
class Atlas:
    """R maps' images of C channels under one another, and where each of them is; row -1 means "no map".

    Attributes:
        image: All images (1, C, H, W), each with a rim one pixel wide that repeats its border.
        linear: Map frame in metres to the atlas's coordinates in [-1, 1] (R + 1, 2, 2).
        shift: The same transform's constant part (R + 1, 2).
        low: Coordinates of the first pixel's centre of each image (R + 1, 2).
        high: Of the last pixel's centre (R + 1, 2).
    """

    image: Tensor
    linear: Tensor
    shift: Tensor
    low: Tensor
    high: Tensor

    @classmethod
    def stack(
        cls, images: Sequence[Tensor], to_pixel: Sequence[NDArray[np.float64]], nowhere: Tensor
    ) -> Atlas:
        """Return the atlas of ``images`` (C, h, w), one per map.

        ``to_pixel`` (2, 3) leads from a map's frame (metres) to (column, row), whole at pixel centres.
        ``nowhere`` (C,): values for people without a map.
        """
        # "No map" is a last image of one pixel that every position falls on: index -1 finds it.
        everything = [*images, nowhere.view(-1, 1, 1)]
        affines = np.stack([*to_pixel, np.zeros((2, 3))])
        sizes = np.array([[image.shape[2], image.shape[1]] for image in everything])
        tops = np.cumsum([0, *(sizes[:-1, 1] + 2)])
        first = np.stack((np.ones_like(tops), tops + 1), axis=1)
        whole = np.array([sizes[:, 0].max() + 2, sizes[:, 1].sum() + 2 * len(everything)])
        atlas = nowhere.new_zeros(1, len(nowhere), int(whole[1]), int(whole[0]))
        for image, top in zip(everything, tops, strict=True):
            # The rim keeps rounding at an image's border from reading its neighbour.
            padded = F.pad(image[None], (1, 1, 1, 1), mode="replicate")
            atlas[:, :, top : top + padded.shape[2], : padded.shape[3]] = padded
        scale = 2 / (whole - 1)  # grid_sample with align_corners: -1 and 1 are the outermost pixels' centres
        parts = (
            affines[:, :, :2] * scale[:, None],
            (affines[:, :, 2] + first) * scale - 1,
            first * scale - 1,
            (first + sizes - 1) * scale - 1,
        )
        return cls(atlas, *(torch.from_numpy(part).to(atlas.device, torch.float32) for part in parts))

    def to(self, device: torch.device | str) -> Atlas:
        """Return the atlas on a device: itself where it is there already."""
        if self.image.device == torch.device(device):
            return self
        return Atlas(*(getattr(self, part.name).to(device) for part in fields(self)))

    def sample(self, points: Tensor, row: Tensor, pose: Tensor) -> Tensor:
        """Return the images' values (N, ..., C) at scene positions, bilinear between pixel centres.

        Beyond its outermost pixel centres an image goes on with its border's value. Differentiable with
        respect to ``points`` (N, ..., 2) and ``pose`` (N, 4); in float32, which tells cells apart.
        """
        with torch.autocast(points.device.type, enabled=False):
            points, pose = points.float(), pose.float()
            # Pose and map together are one affine per entry: far cheaper than moving every point twice.
            linear = self.linear[row] @ turn_matrix(pose)
            shift = self.shift[row].unsqueeze(2) - linear @ pose[:, 2:].unsqueeze(2)
            planes = points.reshape(len(points), math.prod(points.shape[1:-1]), 2).transpose(1, 2)
            where = torch.baddbmm(shift, linear, planes)
            where = where.clamp(self.low[row].unsqueeze(2), self.high[row].unsqueeze(2))
            sampled = F.grid_sample(self.image, where.transpose(1, 2).contiguous()[None], align_corners=True)
        return sampled[0].permute(1, 2, 0).reshape(*points.shape[:-1], self.image.shape[1])


MAX_DISTANCE = 5.0  # metres at which distances are cut off: agents do not react to walls farther away
FASTEST = 4.0  # m/s: walls are looked up as far as they matter to agents of this speed


class MapBank:
    """Floor plans, one atlas of their signed distances, and their walls.

    A ``map_id`` says which floor plan a scene is on, -1 for none; being a hash of the content, it is the same
    in every bank. Banks never change, and those with the same content are equal, on whichever device. What is
    unpickled is the equal bank of this process where there is one: nothing is computed twice.

    Attributes:
        grids: The floor plans, in the given order without repetitions: row r of the bank is ``grids[r]``.
        unknown: Meaning of their unknown cells.
        max_distance: Signed distances are clipped to plus and minus this, metres.
    """

    def __init__(
        self,
        grids: Sequence[OccupancyGrid] = (),
        unknown: Unknown = "free",
        max_distance: float = MAX_DISTANCE,
    ) -> None:
        """Take the floor plans; an empty bank serves scenes without maps.

        Raises:
            UserError: Two different maps have the same name.
        """
        self._ids: dict[str, int] = {}
        by_id: dict[int, OccupancyGrid] = {}
        for grid in grids:
            identity = grid.map_id
            if self._ids.setdefault(grid.name, identity) != identity:
                raise UserError(f"two different maps are named {grid.name!r}: give one another name")
            by_id.setdefault(identity, grid)
        self.grids = tuple(by_id.values())
        self.unknown: Unknown = unknown
        self.max_distance = max_distance

        # -1 is an ordinary entry of the look-up table, so scenes without a map need no branch.
        order = sorted([(-1, -1), *((identity, row) for row, identity in enumerate(by_id))])
        self._sorted_ids, self._rows = torch.tensor(order).T.contiguous().unbind()
        # without a map it does not matter what unknown cells count as
        named = sorted((grid.name, grid.map_id) for grid in self.grids)
        self._content = (*named, unknown if grids else None, max_distance)
        self._hash = hash(self._content)
        self._copies: dict[torch.device, MapBank] = {}
        if type(self) is MapBank:
            _ALIVE.setdefault(self._content, self)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, MapBank) and self._content == other._content)

    def __hash__(self) -> int:
        return self._hash

    def __deepcopy__(self, memo: dict[int, Any]) -> MapBank:
        return self  # it never changes, and TensorDict copies what is no tensor at every step

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._content, self.grids, self._ids, self.unknown, self.max_distance)

    @cached_property
    def _atlas(self) -> Atlas:
        # computed at first use: the transforms take long; the next use may ask for gradients
        with torch.inference_mode(False):
            fields = [torch.from_numpy(grid.signed_distance(self.unknown)) for grid in self.grids]
            return Atlas.stack(
                [field.clamp(-self.max_distance, self.max_distance)[None] for field in fields],
                [grid.map_to_cell() for grid in self.grids],
                nowhere=torch.tensor([self.max_distance]),
            )

    @cached_property
    def walls(self) -> Walls:
        """The walls as they are: exact distances, rays and outlines; made once, and once more per device."""
        first = self.to("cpu")
        with torch.inference_mode(False):
            if first is not self:
                return first.walls.to(self.device)
            return Walls.of(self.grids, self.unknown, self.max_distance)

    @property
    def device(self) -> torch.device:
        """Where its tensors are."""
        return self._rows.device

    @property
    def names(self) -> tuple[str, ...]:
        """The names that ``id_of`` knows."""
        return tuple(self._ids)

    def id_of(self, name: str) -> int:
        """Return the ``map_id`` of a map in this bank.

        Raises:
            UserError: There is none of this name.
        """
        if name not in self._ids:
            raise unknown("map", name, self._ids)
        return self._ids[name]

    def to(self, device: torch.device | str) -> MapBank:
        """Return the bank on a device: itself where it is there already, else a copy, made once."""
        device = torch.device(device)
        if self.device == device:
            return self
        if device not in self._copies:
            moved = object.__new__(MapBank)
            moved.__dict__.update(self.__dict__)
            moved._sorted_ids, moved._rows = self._sorted_ids.to(device), self._rows.to(device)
            moved._atlas = self._atlas.to(device)
            moved.__dict__.pop("walls", None)  # made anew on the device at first use
            moved._copies = {self.device: self}
            self._copies[device] = moved
        return self._copies[device]

    def index(self, map_id: Tensor) -> Tensor:
        """Return the row in this bank of each ``map_id`` (N,) long; -1 stays -1.

        Raises:
            UserError: An id is of a map that is not in this bank; an accelerator raises an assertion.
        """
        place = torch.searchsorted(self._sorted_ids, map_id.contiguous()).clamp_max(len(self._sorted_ids) - 1)
        foreign = self._sorted_ids[place] != map_id
        if map_id.device.type != "cpu":
            assert_on_device(~foreign.any(), "a map_id is not of this bank: see MapBank.index")
        elif foreign.any():
            raise UserError(
                f"map_id {int(map_id[foreign][0])} is not of this bank, which holds "
                f"{', '.join(f'{name} ({identity})' for name, identity in self._ids.items()) or 'no map'}: "
                "make the batch with the bank that its map_id is of, scene_batch(maps=...)"
            )
        return self._rows[place]

    def grid(self, map_id: Tensor | int) -> OccupancyGrid | None:
        """Return the floor plan of one ``map_id``, None for -1; errors as of `index`."""
        row = int(self.index(torch.tensor([int(map_id)], device=self.device)))
        return self.grids[row] if row >= 0 else None

    def signed_distance(self, points: Tensor, map_id: Tensor, pose: Tensor) -> Tensor:
        """Return the distances (N, ...) from scene positions to the nearest wall, metres, negative inside it.

        Read bilinearly between cell centres and differentiable with respect to ``points``. Without a map it
        is plus ``max_distance``; outside the map it is the value at its border, with gradient zero.
        """
        return self._atlas.sample(points, self.index(map_id), pose)[..., 0]

    def closest_wall(self, points: Tensor, map_id: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distance to the nearest occupied square and the direction that leads away from it.

        Distances are exact, to the cells themselves: contacts and sliding along walls need this. On real
        maps at most one place in 20,000, none of them beside a wall, gets a few hundredths of a cell too
        much (see `pedzoo.maps.walls.nearest_edges`). The world outside a map is free, and its walls count
        from there. Where no wall is within ``max_distance`` or a scene has no map, the distance is
        ``max_distance`` and the direction zero.

        Args:
            points: Scene positions (N, ..., 2), metres; differentiable, the gradient is the direction.
            map_id: Floor plan of each entry (N,) long, -1 for none.
            pose: Scene poses (N, 4).

        Returns:
            Distance (N, ...) in metres, negative inside walls, and unit vectors (N, ..., 2) in the scene's
            frame along which it grows.
        """
        return self.walls_around(map_id, pose).closest(points)

    def walls_around(self, map_id: Tensor, pose: Tensor) -> LocalWalls:
        """Return the walls as N entries see them, which `closest_wall` asks."""
        return LocalWalls.around(self.walls, self.index(map_id), pose)

    def walls_of_scenes(self, row: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Return how walls lie in B scenes, `LocalWalls.frame` (B, 7) and `LocalWalls.place` (B, 3)."""
        walls = LocalWalls.around(self.walls, row, pose)
        return walls.frame.float().t().contiguous(), walls.place.t().contiguous()

    def walls_of_state(self, frame: Tensor, place: Tensor) -> LocalWalls | None:
        """Return the walls as the agents (B, A) of scenes see them, from what `walls_of_scenes` returned."""
        if not self.grids:
            return None
        return LocalWalls(self.walls, frame.t().unsqueeze(2), place.t().unsqueeze(2))

    def walls_on_map(self, row: Tensor) -> LocalWalls:
        """Return the walls as they lie on the maps ``row`` (N,) long of this bank, -1 for none."""
        identity = torch.eye(4, device=row.device)[1].expand(len(row), 4)  # made there, not copied
        return LocalWalls.around(self.walls, row, identity)

    def segments_near(
        self,
        points: Tensor,
        map_id: Tensor,
        pose: Tensor,
        reach: Tensor | float,
        most: int = 16,
        farthest: float = 2 * FASTEST,
    ) -> Segments:
        """Return the nearest segments of walls that N people are outside of, nearest first.

        Args:
            points: Scene positions (N, 2), metres.
            map_id: Floor plan of each (N,) long, -1 for none: nothing is near.
            pose: Scene poses (N, 4).
            reach: Metres (N,), or one number, within which a segment has to come.
            most: Segments of one person at most.
            farthest: The greatest reach that is ever asked for: tables are made, and kept, up to it.

        Raises:
            UserError: A ``map_id`` is of another bank.
        """
        bank = self.to(points.device)
        table = bank.walls.segments(farthest, most, dtype=points.dtype)
        reach = torch.as_tensor(reach, dtype=points.dtype, device=points.device).expand(len(points))
        return table.near(points, bank.index(map_id), pose, reach)


_ALIVE: WeakValueDictionary[tuple[Any, ...], MapBank] = WeakValueDictionary()
"""The banks of this process by their content, one of equal ones."""


def _restored(content: tuple[Any, ...], grids: Any, ids: dict[str, int], *settings: Any) -> MapBank:
    """Return the bank of this process with such content, made where there is none."""
    if (bank := _ALIVE.get(content)) is None:
        bank = MapBank(grids, *settings)
        bank._ids = ids  # a floor plan may have two names
    return bank
