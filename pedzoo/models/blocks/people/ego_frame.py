"""Each person's own frame: directions relative to where a person is walking."""

import torch
from torch import Tensor
from torch.nn import functional

from pedzoo.core import geometry

_NOTHING = 1e-4
"""Metres: only shorter vectors are bent to the world's x, so that turned scenes are walked alike."""


def heading(moved: Tensor, goal: Tensor | None) -> Tensor:
    """Return each person's direction (P, 2), a unit vector that changes smoothly with its arguments.

    The last of the displacements ``moved`` (P, T, 2) decides if there is one. For people who hardly move, all
    of the observed path decides; for standing people the relative goal (P, 2), and without one the world's x.
    """
    towards = moved[:, -1] + 0.1 * moved.sum(1)
    if goal is not None:
        towards = towards + 0.05 * functional.normalize(goal, dim=-1)
    return _direction(towards)


def way(moved: Tensor, goal: Tensor) -> Tensor:
    """Return each person's direction (P, 2) as a unit vector that turns slowly, also of people who stop.

    It is that of the goal, and a little of the last displacement. In `heading` the displacement decides:
    people who hardly move may turn by any angle in a step, which makes simulations chaotic.
    """
    return _direction(functional.normalize(goal, dim=-1) + moved[:, -1])


def _direction(towards: Tensor) -> Tensor:
    """Return unit vectors along ``towards`` (P, 2), metres; the world's x where it is nothing."""
    nothing = (1 - towards.square().sum(-1, keepdim=True) / _NOTHING**2).clamp_min(0)
    along_x = torch.tensor([_NOTHING, 0.0], device=towards.device, dtype=towards.dtype)
    return functional.normalize(towards + nothing * along_x, dim=-1)


def into(frame: Tensor | None, vectors: Tensor) -> Tensor:
    """Turn world vectors (P, 2) or (P, T, 2) into the ``frame`` (P, 2) of each person; None is the world."""
    if frame is None:
        return vectors
    return geometry.unrotate(vectors, frame if vectors.dim() == 2 else frame.unsqueeze(1))


def out_of(frame: Tensor | None, vectors: Tensor) -> Tensor:
    """Turn vectors (K, P, T, 2) in each person's ``frame`` (P, 2) back into the world."""
    return vectors if frame is None else geometry.rotate(vectors, frame.unsqueeze(1))
