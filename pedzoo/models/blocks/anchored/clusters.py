"""Typical futures: centroids of training futures by k-means, how often each is nearest, and how far off."""

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.cluster.vq import kmeans2
from torch import Tensor

MOST = 20_000
"""Futures that k-means looks at, at most: more change the centroids by less than the seed does."""

FEW = 4
"""Futures per centroid below which a class of speeds takes those of all classes."""


class Clusters(NamedTuple):
    """Futures (..., T, 2), positions from here, in the units and frames that they were given in.

    Attributes:
        centroids: M centroids and, as the last one, the mean of all (M + 1, T, 2), from right to left.
        logits: Log shares of the futures that each of the M is nearest to (M,).
        scale: Standard deviations of displacements around a centroid's (M, T, 2).
    """

    centroids: Tensor
    logits: Tensor
    scale: Tensor


def clustered(futures: Tensor, modes: int, seed: int) -> Clusters:
    """Return clusters of futures (N, T, 2) by k-means of ``modes`` centroids; N is at least 1."""
    steps = futures.shape[1]
    random = np.random.default_rng(seed)
    points = futures.flatten(1).double().cpu().numpy()
    if len(points) > MOST:
        points = points[random.choice(len(points), MOST, replace=False)]
    elif len(points) < modes:
        points = np.resize(points, (modes, points.shape[1]))
    # of equal points, as of people who stand, no two can be centroids
    points = points + random.normal(0, 1e-5, points.shape)
    centroids, nearest = kmeans2(points, modes, iter=100, minit="++", rng=random, missing="warn")
    order = np.argsort(np.arctan2(centroids[:, -1], centroids[:, -2] + 1e-9), kind="stable")
    place = np.argsort(order)
    centroids, nearest = centroids[order], place[nearest]
    count = torch.from_numpy(np.bincount(nearest, minlength=modes)).float()
    displacements = torch.from_numpy(np.diff(points.reshape(-1, steps, 2), axis=1, prepend=0)).float()
    typical = torch.from_numpy(np.diff(centroids.reshape(-1, steps, 2), axis=1, prepend=0)).float()
    label = torch.from_numpy(nearest)
    squared = (displacements - typical[label]).square()
    # one more future, as far off as all are: a cluster of one is not certain
    total = squared.mean(0).expand(modes, -1, -1).clone().index_add_(0, label, squared)
    scale = (total / (count + 1).view(-1, 1, 1)).sqrt()
    centres = torch.from_numpy(centroids).float().view(modes, steps, 2)
    mean = torch.from_numpy(points.mean(0)).float().view(1, steps, 2)
    return Clusters(torch.cat((centres, mean)), ((count + 1) / (count + 1).sum()).log(), scale)


def fan(modes: int, steps: int) -> Tensor:
    """Return futures (modes + 1, T, 2) for models that have seen no data: even walks in many directions."""
    angle = torch.linspace(-1, 1, modes) * math.pi / 3
    speed = 0.5 + 0.75 * torch.arange(modes).remainder(4) / 3
    step = torch.cat((speed.unsqueeze(1) * torch.stack((angle.cos(), angle.sin()), 1), torch.eye(2)[:1]))
    return step.unsqueeze(1) * torch.arange(1, steps + 1).view(-1, 1)
