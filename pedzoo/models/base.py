"""The interface of forecasters: a scene batch becomes displacements."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Literal, Self

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.spec import build_ungrouped, flattened
from pedzoo.core.types import PRED_LEN, GoalProtocol

Random = torch.Generator | None  # where random numbers come from; None for torch's own

Noise = Literal["episode", "step", "scene", "mixed"]
"""How often noise is drawn for people who walk; see `pedzoo.policies.walker.Walker`."""


@dataclass(frozen=True)
class Walking:
    """How a model walks, unless its policy has other settings.

    Attributes:
        safety: Keep clear of others and walls, see `pedzoo.policies.safety_layer`.
        keep_speed: Alone, walk at the preferred speed, see `pedzoo.models.architectures.sgan.at_own_speed`.
    """

    safety: bool = False
    keep_speed: bool = False


class Forecaster(nn.Module):
    """A model of the zoo."""

    name: str = ""  # as it was loaded: ``sgan_goal.zara1``, a file, an architecture
    card: Any = None  # its `pedzoo.models.zoo.card.ModelCard`, of weights that have one
    config: dict[str, Any]  # the settings that it was built with, as plain values without groups
    needs: frozenset[str] = frozenset()  # inputs besides histories: ``goal``, ``map``
    goal_protocol: GoalProtocol | None = None  # that it was trained on; None where it does not matter
    stochastic: ClassVar[bool] = True  # whether its samples differ
    noise_dim: int = 0  # width of the noise of one person that `next_steps` takes; 0 where it takes none
    # how often each number of it is drawn when it walks, seconds, see `pedzoo.models.blocks.timed_noise`
    noise_periods: tuple[float, ...] = ()  # empty where `walking_noise` says it for all
    mode_at_zero: ClassVar[bool] = False  # the most likely future is that of noise zero
    walking: Walking = Walking()  # how it walks, by default
    walking_noise: Noise = "episode"  # how often its noise is drawn when it walks, by default
    remembers: ClassVar[bool] = False  # its policy keeps how people began, see `pedzoo.policies.memory`
    keeps_distance: bool = False  # its people keep so much room that the safety layer adds none to bodies

    def __repr__(self) -> str:
        weights = sum(value.numel() for value in self.parameters())
        goal = f", goal {self.goal_protocol}" if self.goal_protocol else ""
        return f"{type(self).__name__}({self.name!r}{goal}, {weights:,} weights)"

    def built_with(self, *groups: Any) -> None:
        """Keep the groups of settings that the model was built with."""
        self.config = flattened(*groups)
        self.walking = next((group for group in groups if isinstance(group, Walking)), self.walking)

    @classmethod
    def of(cls, **settings: Any) -> Self:
        """Return a model of settings that are named without their groups, as files of weights have them."""
        return build_ungrouped(cls, settings)

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return ``samples`` random futures (B, K, A, T, 2): displacements, metres; zero for padding."""
        raise NotImplementedError

    def candidates(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return futures (B, K, A, T, 2) for a best of K: random ones, or a set that stands for all."""
        return self.sample(batch, samples, steps, generator)

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the one most likely future (B, 1, A, T, 2)."""
        return self.sample(batch, 1, steps)

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first ``steps`` of one future of ``horizon`` steps (B, A, steps, 2): what is walked.

        Without noise (B, A, noise_dim) it is the most likely future. A stochastic model that takes no noise
        draws its own. The short-term goal lies ``horizon`` steps ahead.
        """
        future = self.sample(batch, 1, horizon) if noise is not None else self.mode(batch, horizon)
        return future[:, 0, :, :steps]

    def step_and_wish(self, batch: TensorDict, noise: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the step and the step before constraints (B, A, 2), metres.

        The two differ where people hold back behind others: see `keeps_distance`.
        """
        step = self.next_steps(batch, noise, 1, PRED_LEN)[:, :, 0]
        return step, step

    def prepare(self, batches: Iterable[TensorDict], seed: int = 0) -> None:
        """Take from training batches, once before the first step, what is not trained: here nothing."""

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return the training loss, summed over scenes. A forecaster without one cannot be trained."""
        raise UserError(f"{type(self).__name__} has nothing to train")

    def log_likelihood(self, batch: TensorDict, generator: Random = None) -> Tensor | None:
        """Return how likely each person's true future was (B, A), nats; None for a model without a density.

        Log densities, or a lower bound of them, of the displacements that `known_displacements` tells, all
        steps of a person together; 0 where nothing is known.
        """
        return None


def true_displacements(batch: TensorDict) -> Tensor:
    """Return how people really moved on (B, A, T, 2), metres per step."""
    agents = agents_of(batch)
    return torch.cat((agents["history"][:, :, -1:], agents["future"]), 2).diff(dim=2)


def known_displacements(batch: TensorDict) -> Tensor:
    """Return which true displacements (B, A, T) are known: those with a known place at both ends."""
    valid = agents_of(batch)["future_valid"]
    return valid & functional.pad(valid[..., :-1], (1, 0), value=True)


def normal(like: Tensor, generator: Random) -> Tensor:
    """Return standard normal numbers of the shape of ``like``, drawn where ``generator`` lives."""
    device = like.device if generator is None else generator.device
    return torch.randn(like.shape, generator=generator, device=device, dtype=like.dtype).to(like.device)


def for_all_samples(path: Tensor, batch: TensorDict, samples: int) -> Tensor:
    """Return one path per person (B, A, T, 2) as every sample (B, K, A, T, 2), zero for padding."""
    there = agents_of(batch)["mask"][..., None, None]
    # not a product: what padding holds may be NaN
    return torch.where(there, path, 0.0).unsqueeze(1).expand(-1, samples, *path.shape[1:])


def arguments(scope: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of an ``__init__`` from its ``locals()``, to be kept as ``config``."""
    return {key: value for key, value in scope.items() if key not in ("self", "__class__")}


@cache
def has_parameters(model: type[Forecaster]) -> bool:
    """Return whether an architecture has something to train, as it is built without settings."""
    return any(True for _ in model().parameters())
