"""Learned robots by name: weights of the zoo whose architecture is a policy of robots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.models.zoo.header import config_in, opened
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.models.zoo.store import find, weights_of
from pedzoo.policies.robot_policy import RobotPolicy

PREFIX = "mean.policy."
"""Of a policy's parameters in a checkpoint of its training."""


def load_robot_weights(name: str) -> RobotPolicy | None:
    """Return a trained robot in eval mode.

    Args:
        name: A zoo name, ``robot_ppo.circle``, a folder or address with its card, a ``.safetensors`` file or
            a checkpoint of ``pedzoo fit --config robot/ppo``.

    Returns:
        None for what is no file of weights, or is of a model of people.

    Raises:
        UserError: The weights cannot be read, or do not fit their architecture.
    """
    if name.endswith(".ckpt"):
        checkpoint = read_checkpoint(name)
        config, state = checkpoint["pedzoo"], checkpoint["state_dict"]
        state = {key.removeprefix(PREFIX): state[key] for key in state if key.startswith(PREFIX)}
        return _filled(config, state, name)
    file = Path(name) if name.endswith(".safetensors") else None
    if file is None:
        entry = find(name)
        if entry is None or entry.card.architecture not in ROBOT_POLICIES.names():
            return None
        file = weights_of(entry)
    with opened(file, "pt") as weights:
        return _filled(
            config_in(weights, file), {key: weights.get_tensor(key) for key in weights.keys()}, name
        )


def _filled(config: dict[str, Any], state: dict[str, Tensor], name: str) -> RobotPolicy | None:
    if config["architecture"] not in ROBOT_POLICIES.names():
        return None
    try:
        policy = ROBOT_POLICIES.get(config["architecture"])(**config["init"])
        policy.load_state_dict(state)
    except (TypeError, RuntimeError) as error:
        line = str(error).strip().splitlines()[0]
        raise UserError(f"{name!r} holds weights of another architecture than it says: {line}") from error
    return policy.eval()
