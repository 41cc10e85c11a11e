"""What all trainings by PPO share: decisions by TorchRL's collector, advantages, and passes over them."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, cast

import lightning as L
import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from pedzoo.core.errors import UserError

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # TorchRL 0.14 subclasses what it deprecates
    from torchrl.collectors import Collector

FIRST_SEED = 2**52
"""Seeds of scenes in training begin here: evaluations use smaller ones."""

_LOGGED: dict[Any, str] = {
    **{"loss_objective": "objective", "loss_critic": "critic", "loss_recorded": "recorded"},
    **{"kl_approx": "kl", "clip_fraction": "clipped"},
}
"""Logged values of TorchRL's loss and their names: agents who do not count are 0 in the last two."""

_RANGES: dict[str, tuple[Callable[[float], bool], str]] = {
    **dict.fromkeys(("envs", "steps", "updates", "episodes"), (lambda n: n >= 1, "at least 1")),
    **dict.fromkeys(("passes", "minibatches"), (lambda n: n >= 1, "at least 1")),
    **dict.fromkeys(("lr", "lr_critic", "final_lr", "imitate"), (lambda n: 0 <= n < inf, "at least 0")),
    **dict.fromkeys(("std", "clip"), (lambda n: n > 0, "above 0")),
    **dict.fromkeys(("gamma", "gae_lambda"), (lambda n: 0 <= n <= 1, "0 to 1")),
    "clip_ratio": (lambda n: 0 < n < 1, "in (0, 1)"),
}
"""What settings may be, and how that is said; all others may be anything."""


def check_ranges(place: str, **numbers: float) -> None:
    """Raise UserError for numbers out of range; ``place`` stands before their names, such as ``--model.``."""
    for name, number in numbers.items():
        if name in _RANGES and not _RANGES[name][0](number):
            raise UserError(f"{place}{name} {number}: expected {_RANGES[name][1]}")


@dataclass(frozen=True)
class Updates:
    """How much is learnt from the decisions of an iteration.

    Attributes:
        passes: Over these decisions.
        minibatches: Steps of the optimizer in one pass.
        gamma: Discount of a decision.
        gae_lambda: Of the generalised advantage: 0 trusts the critic, 1 the rewards.
        clip_ratio: By how much the likelihood of a decision may change to a gain.
        entropy: Weight of the distribution's entropy, which keeps it broad.
        critic: Weight of the critic's loss.
    """

    passes: int = 4
    minibatches: int = 4
    gamma: float = 0.97
    gae_lambda: float = 0.95
    clip_ratio: float = 0.2
    entropy: float = 0.0
    critic: float = 1.0


class Gatherer:
    """B scenes in which a policy gathers decisions; where that ends, the rest of an episode is estimated.

    They depend on their seed and the policy alone: a resumed training meets those of an uninterrupted one.
    """

    def __init__(
        self, env: EnvBase, policy: TensorDictModuleBase, steps: int, device: torch.device | None = None
    ) -> None:
        """Make TorchRL's collector of T decisions, ``steps``, of scenes on the CPU.

        The ``policy`` on a ``device`` writes actions and ``log_prob``; its weights may change in between.
        """
        self.env: Any = env
        self._seed = -1
        self._collector = Collector(
            env,
            policy,
            frames_per_batch=env.batch_size[0] * steps,
            policy_device=device,
            storing_device="cpu",
            trust_policy=True,
            track_traj_ids=False,
            auto_register_policy_transforms=False,  # nothing recurs from one decision to the next
        )
        self._gathered = iter(self._collector)

    def gather(self, seed: int) -> TensorDict:
        """Return T decisions in B scenes (B, T, ...), with the result of each under ``next``.

        Scenes go on where the last gathering ended, and begin anew where it had another seed.
        """
        self._collector.reset_at_each_iter = seed != self._seed
        if seed != self._seed:
            self.env.set_seed(FIRST_SEED + seed, static_seed=True)
            self._seed = seed
        return cast("TensorDict", next(self._gathered))

    def close(self) -> None:
        """Let go of the collector and the physics."""
        self._collector.shutdown(close_env=False)
        if hasattr(self.env, "physics"):
            self.env.physics.close()


def actor(
    mean: TensorDictModuleBase,
    group: str,
    action: str,
    names: Sequence[str] = ("loc", "scale"),
    distribution: Any = IndependentNormal,
) -> ProbabilisticActor:
    """Return TorchRL's actor: writes ``action`` (B, A, 2) of a group.

    ``names`` are the arguments of the ``distribution``, which ``mean`` writes.
    """
    parameters: Any = {name: (group, name) for name in names}
    return ProbabilisticActor(
        cast("TensorDictModule", mean),
        in_keys=parameters,
        out_keys=[(group, action)],
        distribution_class=distribution,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
        log_prob_key=(group, "log_prob"),
    )


class Objective:
    """TorchRL's clipped loss of PPO, and generalised advantages, of the agents of a group.

    (Schulman et al. 2017, arXiv:1707.06347, and 2016, arXiv:1506.02438.) An episode ends for each agent
    apart. All terms are means over the decisions that are ``scored`` (B, A) bool.
    """

    def __init__(
        self,
        acting: ProbabilisticActor,
        critic: TensorDictModuleBase,
        how: Updates,
        device: torch.device,
        action: str = "action",
        group: str = "agents",
    ) -> None:
        """Take an actor of `actor`, and a critic that writes ``value`` (B, A, 1); no parameter is copied."""
        self.group = group
        names = "reward", "done", "terminated", "value", "value_target", "advantage"
        keys: dict[str, Any] = {key: (group, key) for key in names}
        self.loss = ClipPPOLoss(
            acting,
            cast("TensorDictModule", critic),
            clip_epsilon=how.clip_ratio,
            entropy_coeff=how.entropy,
            critic_coeff=how.critic,
            log_explained_variance=False,
            functional=False,
            device=device,
        )
        self.loss.set_keys(action=(group, action), sample_log_prob=(group, "log_prob"), **keys)
        self.loss.loss_mask_key = (group, "scored")
        self._estimate = GAE(gamma=how.gamma, lmbda=how.gae_lambda, value_network=None, device=device)
        self._estimate.set_keys(**keys)

    @torch.no_grad()
    def rated(self, lived: TensorDict) -> TensorDict:
        """Return decisions (B, T) in one row (N,), without what followed them, with advantages.

        Those of the decisions that count have mean 0 and standard deviation 1, all others are 0.
        """
        self._estimate(lived)
        agents = cast("TensorDict", lived[self.group])
        scored, advantage = agents["scored"].unsqueeze(-1), agents["advantage"]
        known = advantage[scored]
        spread = known.std(correction=0).clamp_min(1e-6)
        agents["advantage"] = torch.where(scored, (advantage - known.mean()) / spread, 0.0)
        return cast("TensorDict", lived.exclude("next").flatten(0, 1))


class PPO(L.LightningModule):
    """Trains an actor and a critic, the two groups of the optimizer's parameters.

    Attributes:
        how: Settings of the updates.
        most: Largest norm of the gradient of each of the two.
        skipped: How many updates were left out because a gradient was not finite.
        gatherers: Where decisions are gathered.
    """

    iteration: Tensor
    skipped: Tensor

    def set_up(self, how: Updates, most: float, decisions: int, place: str) -> None:
        """Take the settings of updates from so many ``decisions``, checked as by `check_ranges`."""
        check_ranges(place, **vars(how))
        if how.minibatches > decisions:
            raise UserError(f"{place}minibatches {how.minibatches}: there are {decisions} decisions in all")
        self.automatic_optimization = False
        self.how, self.most = how, most
        self.register_buffer("skipped", torch.zeros((), dtype=torch.long))
        self.gatherers: list[Gatherer] = []

    def teardown(self, stage: str) -> None:
        """Close the environments; after an error, garbage collection closes those of pybullet."""
        for gatherer in self.gatherers:
            gatherer.close()
        self.gatherers = []

    def learn(
        self, loss: ClipPPOLoss, known: TensorDict, random: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Make all passes over decisions (N,) of `Objective.rated`, and return the means of what is logged.

        Their order is drawn by ``random``, or torch's own generator.
        """
        optimizer, logged = cast("Any", self.optimizers()), []
        for _ in range(self.how.passes):
            order = torch.randperm(len(known), generator=random).to(self.device)
            for chosen in order.tensor_split(self.how.minibatches):
                part = cast("TensorDict", known[chosen])
                result = self.terms(part, cast("TensorDict", loss(part)), len(logged))
                terms = [result[key] for key in result.keys() if str(key).startswith("loss_")]
                optimizer.zero_grad()
                self.manual_backward(torch.stack(terms).sum())
                groups = optimizer.param_groups
                norms = [torch.nn.utils.clip_grad_norm_(group["params"], self.most) for group in groups]
                if bool(torch.stack(norms).isfinite().all()):
                    optimizer.step()
                else:
                    self.skipped += 1
                logged.append(result.select(*_LOGGED, strict=False).detach())
        means = cast("TensorDict", torch.stack(logged)).mean(0)
        return {_LOGGED[key]: value for key, value in means.items()}

    def terms(self, part: TensorDict, result: TensorDict, number: int) -> TensorDict:
        """Return the result of TorchRL's loss in an update, with more or other terms ``loss_...``."""
        return result
