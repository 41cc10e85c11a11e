"""Images of several floor plans stacked into one, so that people on all of them are looked up in one call."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pedzoo.core.geometry import turn_matrix


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

        def tensor(values: NDArray[np.float64]) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=nowhere.device)

        return cls(
            image=atlas,
            linear=tensor(affines[:, :, :2] * scale[:, None]),
            shift=tensor((affines[:, :, 2] + first) * scale - 1),
            low=tensor(first * scale - 1),
            high=tensor((first + sizes - 1) * scale - 1),
        )

    def to(self, device: torch.device | str) -> Atlas:
        """Return the atlas on a device: itself where it is there already."""
        if self.image.device == torch.device(device):
            return self
        parts = (self.image, self.linear, self.shift, self.low, self.high)
        return Atlas(*(part.to(device) for part in parts))

    def sample(self, points: Tensor, row: Tensor, pose: Tensor) -> Tensor:
        """Return the images' values (N, ..., C) at scene positions, bilinear between pixel centres.

        Beyond its outermost pixel centres an image goes on with its border's value. Differentiable with
        respect to ``points`` (N, ..., 2) and ``pose`` (N, 4); always computed in float32, because half
        precision cannot tell neighbouring cells apart.
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
