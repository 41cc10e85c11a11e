"""The interface of policies."""

from typing import Any, ClassVar, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core import randomness
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, rotate
from pedzoo.policies.base import NamedPolicy
from pedzoo.policies.learned.walker import Walker


class Policy(NamedPolicy):
    """Reads a scene batch and writes each person's velocity (B, A, 2) in m/s to ``agents/action``.

    Attributes:
        decision_dt: Seconds between its decisions.
    """

    decision_dt: float
    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def __init__(self, decision_dt: float) -> None:
        """Say how often it decides."""
        super().__init__()
        if not decision_dt > 0:
            raise UserError(f"dt {decision_dt}: expected seconds between decisions, above 0")
        self.decision_dt = decision_dt

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Return what ``forward`` returns: the batch, in which the velocities are.

        Raises:
            UserError: ``forward`` returns something else, or has written none.
        """
        result = super().__call__(*args, **kwargs)
        who = f"policy {self.name or type(self).__name__!r}: its forward(tensordict)"
        if not isinstance(result, TensorDictBase):
            raise UserError(f"{who} returned {type(result).__name__}: write `return tensordict` at its end")
        if "action" not in agents_of(result).keys():
            raise UserError(f'{who} wrote no velocities: set tensordict["agents", "action"] (B, A, 2)')
        return result


def drawn_vectors(scenes: TensorDictBase, key: Tensor) -> Tensor:
    """Return standard normal vectors (B, A, 2), drawn by ``key`` (B, A) long.

    They lie in the floor plan's frame, and without one in that of each agent's way: a turned scene is walked
    alike.
    """
    x, y = randomness.normal(randomness.join(key.unsqueeze(-1), torch.arange(2, device=key.device))).unbind(
        -1
    )
    pose, way = scenes["scene_pose"], normalize(cast("Tensor", agents_of(scenes)["desired_velocity"]), dim=-1)
    frame = torch.where(scenes["map_id"].unsqueeze(-1) < 0, way, direction_of(pose[:, :1]))
    return rotate(torch.stack((x, y * pose[:, 1:2]), -1), frame)


def walkers(policy: Policy | Walker) -> list[Walker]:
    """Return the learned policies that are in a policy: itself, or those of its teams."""
    return [part for part in policy.modules() if isinstance(part, Walker)]


def has_noise(policy: Policy | Walker) -> bool:
    """Return whether the learned policies in a policy draw noise."""
    return any(walker.model.noise_dim > 0 for walker in walkers(policy))
