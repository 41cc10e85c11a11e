"""Companies of a recording, from what is seen of people before a policy takes them over."""

from __future__ import annotations

import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from pedzoo.core.types import OBS_LEN

NEAR, TOGETHER, DRIFT = 1.5, 8, 0.5
"""Companions stay within so many metres for so many steps, in which their relative place changes by less."""

FEWEST = 4
"""Frames that companions are seen together at least: one may come into view after the other."""


def companies(xy: Tensor, begin: Tensor, first: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
    """Return the company of each person (P,) long, -1 for alone, and the frame that shows it (P,) long.

    Two people are companions if they are within 1.5 m of each other in all frames in which both are seen
    and neither has been seen for longer than 8 frames: at least 4 frames. In 7 steps their relative place
    changes by less than 0.5 m, in fewer steps by as much less. Companions of companions are of one company.
    Nothing after the frame in which the policy takes over the first of the two is looked at.

    Args:
        xy: Rows of the tracks (N, 2), person after person, one for each frame, metres.
        begin: First row of each person (P,) long.
        first: Frame of that row (P,) long.
        last: Frame of the last one (P,) long.
    """
    order = first.argsort(stable=True)
    came, number = first[order], torch.arange(len(first))
    count = torch.searchsorted(came, came + OBS_LEN - FEWEST, right=True) - number - 1
    one = number.repeat_interleave(count)
    other = one + 1 + torch.arange(len(one)) - (count.cumsum(0) - count)[one]
    pair = torch.stack((order[one], order[other]))
    start = first[pair].amax(0)
    end = torch.minimum(last[pair], first[pair] + OBS_LEN - 1).amin(0)
    pair, start, end = (value[..., end - start + 1 >= FEWEST] for value in (pair, start, end))
    frames = (start.unsqueeze(1) + torch.arange(OBS_LEN)).minimum(end.unsqueeze(1))
    places = xy[(begin - first)[pair].unsqueeze(2) + frames]
    apart = places[0] - places[1]
    near = (apart.norm(dim=2) <= NEAR).all(1)
    most = DRIFT / (TOGETHER - 1) * (end - start)
    together = near & ((apart[:, -1] - apart[:, 0]).norm(dim=1) < most)
    pair, end = pair[:, together], end[together]
    links = coo_matrix((torch.ones(pair.shape[1]), pair.numpy()), (len(first), len(first)))
    label = torch.from_numpy(connected_components(links, directed=False)[1]).long()
    seen = torch.full_like(first, torch.iinfo(first.dtype).max)
    seen.scatter_reduce_(0, pair.flatten(), end.repeat(2), "amin")
    return torch.where(torch.bincount(label)[label] > 1, label, -1), seen
