"""Actor and critic of a robot that learns."""

from __future__ import annotations

import math
from typing import Any, ClassVar, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.modules import IndependentNormal, ProbabilisticActor

from pedzoo.policies.robots._base import bodies_of
from pedzoo.policies.robots.attention import Attention, Encoder, head

SEEN: list[Any] = [("robots", "observation"), ("robots", "body")]
"""What actor and critic read."""


class Mean(TensorDictModuleBase):
    """Writes mean and standard deviation (B, R, 2) of decisions, see `Attention.mean`."""

    in_keys: ClassVar[list[Any]] = SEEN
    out_keys: ClassVar[list[Any]] = [("robots", "loc"), ("robots", "scale")]

    def __init__(self, policy: Attention, std: float) -> None:
        """Take the policy, and the standard deviation at the beginning, a share of the limits."""
        super().__init__()
        self.policy, self.log_std = policy, nn.Parameter(torch.full((2,), math.log(std)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write them."""
        mean = self.policy.mean(tensordict)
        tensordict["robots", "loc"] = mean
        tensordict["robots", "scale"] = self.log_std.clamp(-4, 0.5).exp().expand_as(mean)
        return tensordict


class Value(TensorDictModuleBase):
    """The critic: the return that a robot can still expect."""

    in_keys: ClassVar[list[Any]] = SEEN
    out_keys: ClassVar[list[Any]] = [("robots", "value")]

    def __init__(self, policy: Attention) -> None:
        """Make a network as large as the policy's."""
        super().__init__()
        self.encoder = Encoder(**policy.config)
        self.net = head(self.encoder.features, 2 * policy.config["width"], 1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the value (B, R, 1) of every robot."""
        seen = cast("TensorDictBase", tensordict["robots", "observation"])
        tensordict["robots", "value"] = self.net(self.encoder(seen, bodies_of(tensordict)))
        return tensordict


def actor(mean: Mean) -> ProbabilisticActor:
    """Return TorchRL's actor: writes ``robots/decision`` (B, R, 2) and its ``log_prob`` (B, R)."""
    parameters: Any = {"loc": ("robots", "loc"), "scale": ("robots", "scale")}
    return ProbabilisticActor(
        cast("TensorDictModule", mean),
        in_keys=parameters,
        out_keys=[("robots", "decision")],
        distribution_class=IndependentNormal,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
        log_prob_key=("robots", "log_prob"),
    )
