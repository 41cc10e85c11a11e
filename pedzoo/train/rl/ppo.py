"""Reinforcement learning in the loop: PPO on the environment's rewards, which need no gradient."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from pedzoo.core.errors import UserError, at_least_zero
from pedzoo.models.base import Forecaster
from pedzoo.policies.walker import Noise, Walker
from pedzoo.sim.make import make_scenario, prepare_scenario
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.train.modules.module import ForecastModule
from pedzoo.train.rl.actor import Spread, actor
from pedzoo.train.rl.critic import Critic
from pedzoo.train.rl.experience import Gatherer, with_advantages
from pedzoo.train.rl.objective import advantages, clipped
from pedzoo.train.rl.rewards import Reward

_LOGGED: dict[Any, str] = {
    **{"loss_objective": "objective", "loss_critic": "critic", "loss_recorded": "recorded"},
    **{"kl_approx": "kl", "clip_fraction": "clipped"},
}
"""Logged values of TorchRL's loss and their names: people who do not count are 0 in the last two."""


class _Parts(NamedTuple):
    """Objects that a fit makes anew: no part of a checkpoint."""

    loss: ClipPPOLoss
    estimate: GAE
    gatherers: list[Gatherer]


@dataclass(frozen=True)
class Collection:
    """Where and how decisions are gathered.

    Attributes:
        envs: Scenes of an iteration.
        steps: Decisions of 0.4 s in each of them.
        physics: ``compiled`` (fastest), ``torch``, ``bullet`` (pybullet) or ``file.py:Class``.
        noise: Of the generator, as of `Walker`.
        std: Standard deviation of velocities at the beginning, m/s.
    """

    envs: int = 32
    steps: int = 32
    physics: str = "compiled"
    noise: Noise | None = None
    std: float = 0.15

    def __post_init__(self) -> None:
        """Check the numbers. Raises UserError: one is out of range."""
        for name in ("envs", "steps"):
            if getattr(self, name) < 1:
                raise UserError(f"--model.collection.{name} {getattr(self, name)}: expected at least 1")
        if self.std <= 0:
            raise UserError(f"--model.collection.std {self.std}: expected above 0")


@dataclass(frozen=True)
class Optimisation:
    """How much is learnt from the decisions of an iteration.

    Attributes:
        lr_critic: Learning rate of the critic's Adam, constant.
        passes: Over the decisions of an iteration.
        minibatches: Updates of one pass.
        gamma: Discount of a decision.
        gae_lambda: Of the generalised advantage: 0 trusts the critic, 1 the rewards.
        clip_ratio: By how much the likelihood of a decision may change to a gain.
        entropy: Weight of the distribution's entropy, which keeps it broad.
        critic: Weight of the critic's loss.
        recorded: Weight of the generator's own loss on recorded scenes, per scene; 0 leaves it out.
    """

    lr_critic: float = 1e-3
    passes: int = 4
    minibatches: int = 4
    gamma: float = 0.97
    gae_lambda: float = 0.95
    clip_ratio: float = 0.2
    entropy: float = 0.0
    critic: float = 1.0
    recorded: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers. Raises UserError: one is out of range."""
        for name, fits, expected in (
            ("passes", self.passes >= 1, "at least 1"),
            ("minibatches", self.minibatches >= 1, "at least 1"),
            ("clip_ratio", 0 < self.clip_ratio < 1, "in (0, 1)"),
            ("gamma", 0 <= self.gamma <= 1, "0 to 1"),
            ("gae_lambda", 0 <= self.gae_lambda <= 1, "0 to 1"),
        ):
            if not fits:
                value = getattr(self, name)
                raise UserError(f"--model.optimisation.{name} {value}: expected {expected}")
        at_least_zero("--model.optimisation.", lr_critic=self.lr_critic)


class PPOModule(ForecastModule):
    """Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) by TorchRL's loss and collector.

    All people walk by the same generator, and each is one sample of the batch: decentralised actor and
    critic with shared parameters (independent PPO). The generator gives the mean of the velocity, a learned
    number the standard deviation; only the mean walks after training. Advantages are generalised (Schulman
    et al. 2016, arXiv:1506.02438). Losses, entropy, advantages and their normalisation are those of people
    that the policy moves, without padding, people who have left and played-back people.

    An iteration gathers decisions in one of the scenarios, in turn, and learns from them as set in
    `Optimisation`. Recorded scenes of the data can keep the forecasts: ``recorded`` weighs the generator's
    own loss on their batch in every update.
    """

    in_scenes = True
    skipped: Tensor

    def __init__(
        self,
        generator: Forecaster,
        scenarios: list[str],
        reward: Reward,
        collection: Collection = Collection(),
        optimisation: Optimisation = Optimisation(),
        **options: Any,
    ) -> None:
        """Take a generator, where it walks and how it is optimised.

        Args:
            generator: The model, best with weights (``pedzoo fit --weights NAME``).
            scenarios: With settings, as ``door:people=4``.
            reward: Reward of a decision.
            collection: How decisions are gathered there.
            optimisation: Settings of the updates.
            options: Of the generator's optimisation and of validation; see `ForecastModule`.

        Raises:
            UserError: No scenario, an unknown one, or more minibatches than decisions.
        """
        super().__init__(generator, **options)
        if not scenarios:
            raise UserError("--model.scenarios: expected at least one, such as door")
        decisions = collection.envs * collection.steps
        if optimisation.minibatches > decisions:
            raise UserError(
                f"--model.optimisation.minibatches {optimisation.minibatches}: there are {decisions} "
                "decisions in all"
            )
        self.automatic_optimization = False
        self.scenarios = [make_scenario(name) for name in scenarios]
        self.reward, self.collection, self.optimisation = reward, collection, optimisation
        self.critic, self.spread = Critic(optimisation.gamma), Spread(collection.std)
        self._walker = (
            Walker(generator, collection.noise),
        )  # in a tuple: its parameters are registered already
        self.register_buffer("skipped", torch.zeros((), dtype=torch.long))
        self._prepared: list[PreparedScenario] = []
        self._parts: _Parts | None = None

    def setup(self, stage: str) -> None:
        """Plan the scenes, too: errors are raised before anything is written."""
        super().setup(stage)
        if stage == "fit":
            self._prepared = [prepare_scenario(scenario) for scenario in self.scenarios]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; the actor's learning rate is set at every iteration."""
        acting = [*self.generator.parameters(), *self.spread.parameters()]
        critic = {"params": list(self.critic.parameters()), "lr": self.optimisation.lr_critic}
        return torch.optim.Adam([{"params": acting}, critic], self.lr)

    def steps_per_iteration(self) -> float:
        """Return how many optimizer steps one iteration makes."""
        return self.optimisation.passes * self.optimisation.minibatches

    def on_fit_start(self) -> None:
        """Make environments, collectors and TorchRL's loss, on the device of the training."""
        how, where = self.optimisation, self.collection
        acting = actor(self._walker[0], self.spread)
        loss = clipped(acting, self.critic, how.clip_ratio, how.entropy, how.critic, self.device)
        estimate = advantages(how.gamma, how.gae_lambda, self.device)
        shares = self.trainer.global_rank, self.trainer.world_size
        gatherers = [
            Gatherer(scenario, acting, where.envs, where.steps, where.physics, self.device, *shares)
            for scenario in self._prepared
        ]
        self._parts = _Parts(loss, estimate, gatherers)

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Gather decisions and learn from them."""
        with _still(self.generator):
            log = self._learn(batch)
        self.iteration += 1
        log |= {"std": self.spread().detach(), "skipped": self.skipped.float()}
        self.show("reward", log["reward"])
        values = {f"train/{key}": value for key, value in log.items()}
        self.log_dict(values, on_step=False, on_epoch=True, batch_size=len(batch), sync_dist=True)

    def _learn(self, batch: TensorDict) -> dict[str, Tensor]:
        """Make an iteration beside a batch of recorded scenes, and return its logged values."""
        assert self._parts is not None
        loss, estimate, gatherers = self._parts
        optimizer, random = cast("Any", self.optimizers()), self.random()
        gatherer = gatherers[int(self.iteration) % len(gatherers)]
        seen = gatherer.gather(self._seed_of_iteration())
        lived = with_advantages(seen.to(self.device), self.reward, self.critic, estimate)
        self.set_lr(optimizer, self.lr)
        optimizer.param_groups[1]["lr"] = self.optimisation.lr_critic
        parts = _parts_of(batch, self.optimisation.minibatches)
        logged = []
        for number, chosen in enumerate(self._minibatches(len(lived), random)):
            result = cast("TensorDict", loss(lived[chosen]))
            if self.optimisation.recorded:
                part = parts[number % len(parts)]
                result["loss_recorded"] = (
                    self.optimisation.recorded * self.generator.loss(part, random) / len(part)
                )
            terms = [result[key] for key in result.keys() if str(key).startswith("loss_")]
            self._update(optimizer, torch.stack(terms).sum())
            logged.append(result.select(*_LOGGED, strict=False).detach())
        means = cast("TensorDict", torch.stack(logged)).mean(0)
        return {_LOGGED[key]: value for key, value in means.items()} | _decision_means(lived)

    def _minibatches(self, count: int, random: torch.Generator) -> Iterator[Tensor]:
        """Yield which decisions (M,) long are in every update."""
        for _ in range(self.optimisation.passes):
            order = torch.randperm(count, generator=random).to(self.device)
            yield from order.tensor_split(self.optimisation.minibatches)

    def _update(self, optimizer: Any, loss: Tensor) -> None:
        """Make a step, unless its gradient is not finite; the norms of actor and critic are cut apart."""
        optimizer.zero_grad()
        self.manual_backward(loss)
        most = self.clip or float("inf")
        norms = [torch.nn.utils.clip_grad_norm_(group["params"], most) for group in optimizer.param_groups]
        if bool(torch.stack(norms).isfinite().all()):
            optimizer.step()
        else:
            self.skipped += 1

    def teardown(self, stage: str) -> None:
        """Close the environments; after an error, garbage collection closes those of pybullet."""
        for gatherer in self._parts.gatherers if self._parts else ():
            gatherer.close()
        self._parts = None


@contextmanager
def _still(model: nn.Module) -> Iterator[None]:
    """Switch dropout off: the network that decides in an update has to be the one that walked."""
    parts = [part for part in model.modules() if isinstance(part, nn.Dropout) and part.training]
    for part in parts:
        part.eval()
    yield
    for part in parts:
        part.train()


def _parts_of(batch: TensorDict, count: int) -> list[TensorDict]:
    """Return the scenes of a batch in at most ``count`` parts, none of them empty."""
    return [cast("TensorDict", part) for part in batch.split(-(-len(batch) // count))]


def _decision_means(lived: TensorDict) -> dict[str, Tensor]:
    """Return means over the decisions that count."""
    people = cast("TensorDict", lived["agents"])
    scored, reward = people["scored"], cast("Tensor", lived["next", "agents", "reward"])
    target, value = (people[key][scored] for key in ("value_target", "value"))
    missed, spread = (target - value).square().mean(), (target - target.mean()).square().mean()
    return {"reward": reward[scored].mean(), "explained": 1 - missed / spread.clamp_min(1e-6)}
