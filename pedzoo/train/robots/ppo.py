"""Proximal policy optimisation of a robot among people, scenes and updates in batches."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, cast

import lightning as L
import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor
from torch.utils.data import DataLoader

from pedzoo.core.errors import UserError, at_least_zero
from pedzoo.core.spec import parse
from pedzoo.policies.load import load_policy
from pedzoo.policies.robots.attention import Attention
from pedzoo.sim.robots.env import RobotEnv, make_robot_env
from pedzoo.train.rl.objective import advantages, clipped
from pedzoo.train.robots.actor_critic import Mean, Value, actor
from pedzoo.train.robots.crowdnav import SETTINGS, CrowdNavEnv
from pedzoo.train.robots.experience import Gatherer, outcome_shares, walked_once, with_advantages
from pedzoo.train.robots.teacher import CONSTANT_VELOCITY, teacher_of

_SEEDS = 2**52
"""Seeds of scenes in training begin here: nothing is evaluated on these."""

_PEOPLE = "orca"
"""Who walks where nothing else is said, and always in CrowdNav's scenarios."""

_LOGGED = {
    "loss_objective": "objective",
    "loss_critic": "critic",
    "kl_approx": "kl",
    "clip_fraction": "clipped",
}


class RobotPPO(L.LightningModule):
    """Trains one robot in each scene, among people who are walked inside (Schulman et al. 2017).

    Scenes are on the CPU, where a few hundred of them are fastest; what learns may be on another device.
    An update gathers ``steps`` decisions in ``envs`` scenes of every scenario, and makes ``passes`` over them
    in ``minibatches`` by TorchRL's loss. A validation runs the mean of the policy through ``episodes``
    episodes of every scenario, the same ones every time.
    """

    iteration: Tensor

    def __init__(
        self,
        policy: Attention,
        scenarios: list[str],
        people: str = _PEOPLE,
        robot: str = "disc",
        decision_dt: float = 0.2,
        reward: Mapping[str, float] | None = None,
        envs: int = 64,
        steps: int = 64,
        updates: int = 10,
        episodes: int = 100,
        physics: str = "compiled",
        imitate: int = 0,
        teacher: str = CONSTANT_VELOCITY,
        std: float = 0.4,
        lr: float = 1e-3,
        final_lr: float = 0.05,
        passes: int = 4,
        minibatches: int = 16,
        gamma: float = 0.98,
        gae_lambda: float = 0.95,
        clip_ratio: float = 0.2,
        entropy: float = 0.001,
        critic: float = 0.5,
        clip: float = 0.5,
    ) -> None:
        """Take the robot, its place and the settings of its training.

        Args:
            policy: The network.
            scenarios: With settings, as of `pedzoo.make_robot_env`, or ``crowdnav:people=5`` or
                ``crowdnav_pp``, whose people and decisions are CrowdNav's; see
                `pedzoo.train.robots.crowdnav.CrowdNavEnv`.
            people: A policy or a mixed crowd, in scenarios that are not CrowdNav's.
            robot: A body with settings.
            decision_dt: Seconds between two decisions.
            reward: Weights by name; see `pedzoo.sim.robots.reward.DEFAULT_WEIGHTS`.
            envs: B, scenes of every scenario.
            steps: T, decisions in each of them for one update.
            updates: In an epoch.
            episodes: Of every scenario in a validation.
            physics: As in `pedzoo.make_robot_env`.
            imitate: So many updates at the beginning follow a teacher, not rewards.
            teacher: Its name; see `pedzoo.train.robots.teacher.teacher_of`.
            std: Standard deviation of decisions at the beginning, a share of the robot's limits.
            lr: Learning rate of Adam at the beginning.
            final_lr: Share of it left at the end; it falls linearly.
            passes: Over the decisions of an update.
            minibatches: Steps of the optimizer in one pass.
            gamma: Discount of a decision.
            gae_lambda: Of the generalised advantage.
            clip_ratio: By how much the likelihood of a decision may change to a gain.
            entropy: Weight of the distribution's entropy.
            critic: Weight of the critic's loss.
            clip: Largest norms of the gradients of actor and critic.

        Raises:
            UserError: No scenario, a number out of range, or people who are unknown or have no use.
        """
        super().__init__()
        counts = {"envs": envs, "steps": steps, "updates": updates, "episodes": episodes}
        for name, count in (counts | {"passes": passes, "minibatches": minibatches}).items():
            if count < 1:
                raise UserError(f"--model.{name} {count}: expected at least 1")
        at_least_zero("--model.", imitate=imitate, lr=lr, final_lr=final_lr)
        if clip <= 0:
            raise UserError(f"--model.clip {clip}: expected above 0")
        if minibatches > envs * steps:
            raise UserError(f"--model.minibatches {minibatches}: there are {envs * steps} decisions in all")
        if not scenarios:
            raise UserError("--model.scenarios: expected at least one, such as door:people=4")
        if std <= 0 or not 0 < clip_ratio < 1 or not (0 <= gamma <= 1 and 0 <= gae_lambda <= 1):
            raise UserError(
                f"--model.std {std} clip_ratio {clip_ratio} gamma {gamma} gae_lambda {gae_lambda}: expected "
                "above 0, in (0, 1), and two numbers from 0 to 1"
            )
        _check_people(people, scenarios)
        self.automatic_optimization = False
        self.scenarios, self.people, self.robot = scenarios, people, robot
        self.decision_dt, self.reward, self.physics = decision_dt, reward, physics
        self.envs, self.steps, self.updates, self.episodes = envs, steps, updates, episodes
        self.lr, self.final_lr, self.clip = lr, final_lr, clip
        self.passes, self.minibatches, self.imitate = passes, minibatches, imitate
        self.teacher = teacher_of(teacher)
        self.gamma, self.gae_lambda = gamma, gae_lambda
        self.weights = clip_ratio, entropy, critic
        self.mean, self.value = Mean(policy, std), Value(policy)
        self.seed = torch.initial_seed() % 2**31
        self.register_buffer("iteration", torch.zeros((), dtype=torch.long))
        self._parts: Any = None

    @property
    def policy(self) -> Attention:
        """The robot's policy."""
        return self.mean.policy

    def environment(self, scenario: str, scenes: int, training: bool = False) -> RobotEnv | CrowdNavEnv:
        """Return ``scenes`` scenes of one of the scenarios; those of a training are never validated on."""
        spec = parse(scenario)
        if setting := SETTINGS.get(spec.name):
            counts: dict[str, Any] = {key: int(value) for key, value in spec.settings.items()}
            # CrowdNav's validation cases are those of the seeds from 0 on
            counts |= {} if training else {"crowds": scenes, "first": 0}
            return CrowdNavEnv(scenes, setting, robot=self.robot, reward=self.reward, **counts)
        return make_robot_env(
            scenario,
            self.robot,
            self.people,
            scenes,
            self.policy.sensors,
            self.reward,
            self.physics,
            decision_dt=self.decision_dt,
        )

    def train_dataloader(self) -> Any:
        """Return as many numbers as an epoch has updates."""
        return DataLoader(range(self.updates), batch_size=1)  # pyright: ignore[reportArgumentType]

    def val_dataloader(self) -> Any:
        """Return one number: a validation is one batch."""
        return DataLoader(range(1), batch_size=1)  # pyright: ignore[reportArgumentType]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; its learning rate is set in every update."""
        return torch.optim.Adam([{"params": part.parameters()} for part in (self.mean, self.value)], self.lr)

    def on_fit_start(self) -> None:
        """Make environments and TorchRL's loss."""
        acting, clip_ratio, entropy, critic = actor(self.mean), *self.weights
        loss = clipped(acting, self.value, clip_ratio, entropy, critic, self.device, "robots", "decision")
        estimate = advantages(self.gamma, self.gae_lambda, self.device, "robots")
        gatherers = [Gatherer(self.environment(name, self.envs, True)) for name in self.scenarios]
        self._parts = acting, loss, estimate, gatherers

    def training_step(self, batch: Tensor, batch_idx: int) -> None:
        """Gather decisions and learn from them."""
        began = time.perf_counter()
        torch.manual_seed(self.seed * 1_000_003 + int(self.iteration))
        acting, loss, estimate, gatherers = self._parts
        imitates = int(self.iteration) < self.imitate
        teacher = self.teacher if imitates else None
        seed = _SEEDS + self.seed * 1_000_003 + self.current_epoch
        gathered = [one.gather(acting, self.steps, seed, teacher, self.device) for one in gatherers]
        lived: Any = torch.cat(gathered).to(self.device)
        log = outcome_shares(lived["next"])
        log["reward"] = lived["next", "robots", "reward"].mean()
        known = with_advantages(lived, self.value, estimate)
        log |= self._learn(loss, known, imitates)
        self.iteration += 1
        log |= {"std": self.mean.log_std.detach().exp().mean()}
        log["samples_per_s"] = torch.tensor(len(known) / (time.perf_counter() - began))
        self.log("success", log["success"], prog_bar=True, logger=False, batch_size=1)
        values = {f"train/{key}": value for key, value in log.items()}
        self.log_dict(values, on_step=False, on_epoch=True, batch_size=1)

    def _learn(self, loss: Any, known: TensorDict, imitates: bool) -> dict[str, Tensor]:
        """Make the passes, and return what is logged of them."""
        optimizer = cast("Any", self.optimizers())
        share = min(int(self.iteration) / max(cast("int", self.trainer.max_epochs) * self.updates, 1), 1.0)
        logged = []
        for group in optimizer.param_groups:
            group["lr"] = self.lr * (1 - (1 - self.final_lr) * share)
        for _ in range(self.passes):
            for chosen in torch.randperm(len(known)).to(self.device).tensor_split(self.minibatches):
                part = cast("TensorDict", known[chosen])
                result = loss(part)
                if imitates:
                    missed = (self.policy.mean(part) - part["robots", "taught"]).square().sum(-1)
                    result["loss_objective"] = missed[part["robots", "scored"]].mean()
                    del result["loss_entropy"]
                optimizer.zero_grad()
                terms = [result[key] for key in result.keys() if key.startswith("loss_")]
                self.manual_backward(torch.stack(terms).sum())
                for group in optimizer.param_groups:
                    torch.nn.utils.clip_grad_norm_(group["params"], self.clip)
                optimizer.step()
                logged.append(result.select(*_LOGGED, strict=False).detach())
        means = cast("TensorDict", torch.stack(logged)).mean(0)
        return {_LOGGED[str(key)]: value for key, value in means.items()}

    def validation_step(self, batch: Tensor, batch_idx: int) -> None:
        """Run episodes with the mean of the policy."""
        if self.trainer.sanity_checking:
            return
        environments = (self.environment(name, self.episodes) for name in self.scenarios)
        results = [walked_once(env, self.policy.mean, self.device) for env in environments]
        for key in results[0]:
            self.log(f"val/{key}", torch.stack([one[key] for one in results]).mean(), batch_size=1)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Write down what this is, so that `pedzoo.policies.load.load_robot_policy` can build it."""
        checkpoint["pedzoo"] = {
            "architecture": "attention",
            "init": self.policy.config,
            "protocol": self.protocol,
        }

    @property
    def protocol(self) -> dict[str, Any]:
        """People, places, body and senses of the training."""
        known = {"scenarios": self.scenarios, "crowd": self.people, "robot": self.robot}
        return known | {"decision_dt": self.decision_dt, "sensors": self.policy.sensors}


def _check_people(people: str, scenarios: list[str]) -> None:
    """Refuse people whom no scenario uses, or who are unknown."""
    if all(parse(scenario).name in SETTINGS for scenario in scenarios):
        if people != _PEOPLE:
            raise UserError(
                f"--model.people {people:.200}: no use for people with crowdnav scenarios, which have their "
                f"own: leave it out, or set --model.scenarios '[\"door:people=4\"]'"
            )
    else:
        load_policy(people)
