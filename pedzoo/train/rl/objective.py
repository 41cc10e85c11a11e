"""TorchRL's loss and advantages for agents of one policy: the keys, and which decisions count."""

from typing import Any, cast

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

_KEYS = "reward", "done", "terminated", "value", "value_target", "advantage"
"""Names of values of a group for TorchRL's estimator and losses: an episode ends for each agent apart."""


def clipped(
    acting: ProbabilisticActor,
    critic: TensorDictModuleBase,
    clip_ratio: float,
    entropy: float,
    value: float,
    device: torch.device,
    group: str = "agents",
    action: str = "action",
) -> ClipPPOLoss:
    """Return PPO's clipped loss; every term is a mean over the decisions that are ``scored`` (B, A) bool.

    ``acting`` writes the distribution of actions, ``critic`` values; parameters are not copied. ``value``
    weighs the critic's loss; ``clip_ratio`` and ``entropy`` are as in `pedzoo.train.rl.ppo.Optimisation`.
    Agents of ``group`` decide ``action``.
    """
    loss = ClipPPOLoss(
        acting,
        cast("TensorDictModule", critic),
        clip_epsilon=clip_ratio,
        entropy_coeff=entropy,
        critic_coeff=value,
        log_explained_variance=False,
        functional=False,
        device=device,
    )
    names: dict[str, Any] = {"action": (group, action), "sample_log_prob": (group, "log_prob")}
    loss.set_keys(**_keys(group), **names)
    loss.loss_mask_key = (group, "scored")
    return loss


def advantages(gamma: float, gae_lambda: float, device: torch.device, group: str = "agents") -> GAE:
    """Return the generalised advantage estimation; it reads values, and asks no network for them."""
    estimate = GAE(gamma=gamma, lmbda=gae_lambda, value_network=None, device=device)
    estimate.set_keys(**_keys(group))
    return estimate


def _keys(group: str) -> dict[str, Any]:
    return {key: (group, key) for key in _KEYS}
