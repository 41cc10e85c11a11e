"""People on the very spot of another: no model sees a direction in which one of them could go aside."""

import math
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional

from pedzoo.core import randomness
from pedzoo.core.batch import agents_of, ids_of
from pedzoo.policies.safety_layer.layer import scene_keys

PUSH = 0.05
"""Metres that such people are led apart in a step, each in a direction of their own."""


@torch.no_grad()
def led_apart(batch: TensorDictBase) -> Tensor:
    """Return what is added to next steps (B, A, 2), metres: 0 for people with a spot of their own.

    Args:
        batch: The scenes; directions are drawn by their keys and the agents' numbers.
    """
    agents = agents_of(batch)
    here, mask = cast("Tensor", agents["history"])[:, :, -1], cast("Tensor", agents["mask"])
    # one whole number for each spot, 0 and -0 being the same; absent agents have numbers that no spot has
    bits = (here.float() + 0.0).flatten().view(torch.int64).view(mask.shape)
    absent = torch.iinfo(torch.int64).min + torch.arange(mask.shape[1], device=mask.device)
    spot, order = torch.where(mask, bits, absent).sort(dim=1)
    pairs = spot[:, 1:] == spot[:, :-1]
    if pairs.device.type == "cpu" and not bool(pairs.any()):
        return torch.zeros_like(here)
    shared = functional.pad(pairs, (1, 0)) | functional.pad(pairs, (0, 1))
    shared = torch.zeros_like(mask).scatter(1, order, shared) & cast("Tensor", agents["controlled"])
    angle = 2 * math.pi * randomness.uniform(randomness.join(scene_keys(batch), "same spot", ids_of(batch)))
    away = PUSH * torch.stack((angle.cos(), angle.sin()), -1).to(here)
    return torch.where(shared.unsqueeze(-1), away, 0.0)
