"""TorchRL's loss and advantages for people as agents of one policy: the keys, and which decisions count."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from pedzoo.train.rl.critic import Critic

KEYS: dict[str, tuple[str, str]] = {
    key: ("agents", key) for key in ("reward", "done", "terminated", "value", "value_target", "advantage")
}
"""Where TorchRL's estimator and losses find values per person: episodes end for each person apart."""

SCORED = ("agents", "scored")
"""Which decisions (B, A) bool count: of people that the policy moved, in scenes in which it did not fail."""


def clipped(
    acting: ProbabilisticActor,
    critic: Critic,
    clip_ratio: float,
    entropy: float,
    value: float,
    device: torch.device,
) -> ClipPPOLoss:
    """Return PPO's clipped loss; every term is a mean over the decisions that count.

    Args:
        acting: Writes the distribution of actions; its parameters are not copied.
        critic: Writes values; likewise.
        clip_ratio: By how much the likelihood of a decision may change to a gain.
        entropy: Weight of the entropy.
        value: Weight of the critic's loss.
        device: Of the parameters.
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
    names: dict[str, Any] = {"action": ("agents", "action"), "sample_log_prob": ("agents", "log_prob")}
    loss.set_keys(**KEYS, **names)
    loss.loss_mask_key = SCORED
    return loss


def advantages(gamma: float, gae_lambda: float, device: torch.device) -> GAE:
    """Return the generalised advantage estimation; it reads values, and asks no network for them."""
    estimate = GAE(gamma=gamma, lmbda=gae_lambda, value_network=None, device=device)
    estimate.set_keys(**cast("dict[str, Any]", KEYS))
    return estimate
