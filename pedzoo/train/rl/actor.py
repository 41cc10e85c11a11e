"""A walker with a probability density: velocities around that of the forecaster, for policy gradients."""

import math
from typing import Any, ClassVar, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor

from pedzoo.policies.walker import Walker


class Spread(nn.Module):
    """The standard deviation of each person's velocity about the mean, one learned number, m/s.

    The same in all directions, so that turning the scene turns the distribution.
    """

    def __init__(self, start: float) -> None:
        """Begin at ``start`` m/s."""
        super().__init__()
        self.log = nn.Parameter(torch.tensor(math.log(start)))

    def forward(self) -> torch.Tensor:
        """Return it, a scalar."""
        return self.log.exp()


class Mean(TensorDictModuleBase):
    """Writes mean and standard deviation (B, A, 2), m/s, of each person's velocity.

    The generator's noise is no part of the density: it is drawn by the scene's key, like an observation, and
    equal in collecting and in updates. People that the policy does not move have a fixed distribution, and
    so a constant likelihood.
    """

    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", "loc"), ("agents", "scale")]

    def __init__(self, walker: Walker, spread: Spread) -> None:
        """Take the two parts."""
        super().__init__()
        self.walker, self.spread = walker, spread

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write them."""
        seen = tensordict.select(*self.in_keys).clone(
            False
        )  # a walker writes an action: not over the taken one
        with set_exploration_type(ExplorationType.RANDOM):
            velocity = self.walker(seen)["agents", "action"]
        moved = seen["agents", "controlled"].unsqueeze(-1)
        tensordict["agents", "loc"] = torch.where(moved, velocity, 0.0)
        tensordict["agents", "scale"] = torch.where(moved, self.spread(), 1.0).expand_as(velocity)
        return tensordict


def actor(walker: Walker, spread: Spread) -> ProbabilisticActor:
    """Return TorchRL's actor: writes ``action`` (B, A, 2), m/s, and its ``log_prob`` (B, A)."""
    parameters: Any = {"loc": ("agents", "loc"), "scale": ("agents", "scale")}
    return ProbabilisticActor(
        cast("TensorDictModule", Mean(walker, spread)),
        in_keys=parameters,
        out_keys=[("agents", "action")],
        distribution_class=IndependentNormal,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
        log_prob_key=("agents", "log_prob"),
    )
