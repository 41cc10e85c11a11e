"""The interface of policies: what all have, and the class of those that are no models."""

from typing import Any, ClassVar, Self, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.nn.probabilistic import InteractionType as ExplorationType
from tensordict.nn.probabilistic import interaction_type as exploration_type
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core import randomness
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, rotate

_DETERMINISTIC = (ExplorationType.DETERMINISTIC, ExplorationType.MODE, ExplorationType.MEAN)


def deterministic() -> bool:
    """Return whether policies are asked for their answers without noise, by TorchRL's exploration type."""
    return exploration_type() in _DETERMINISTIC


class NamedPolicy(TensorDictModuleBase):
    """A module that decides the velocities of a scene batch.

    Attributes:
        name: As it was loaded, ``orca:radius=0.3``.
        decision_dt: Seconds between its decisions.
    """

    name: str = ""
    decision_dt: float
    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def fresh(self) -> Self:
        """Return the policy as it is before its first scene: itself, for policies that remember nothing."""
        return self

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"{type(self).__name__}({name}decides every {self.decision_dt:g} s)"


class Policy(NamedPolicy):
    """Reads a scene batch and writes each person's velocity (B, A, 2) in m/s to ``agents/action``."""

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
    keys = randomness.join(key.unsqueeze(-1), torch.arange(2, device=key.device))
    x, y = randomness.normal(keys).unbind(-1)
    pose, way = scenes["scene_pose"], normalize(cast("Tensor", agents_of(scenes)["desired_velocity"]), dim=-1)
    frame = torch.where(scenes["map_id"].unsqueeze(-1) < 0, way, direction_of(pose[:, :1]))
    return rotate(torch.stack((x, y * pose[:, 1:2]), -1), frame)
