"""PPO of a robot among people: actor, critic, teachers, the training, and how its episodes end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader
from torchrl.modules import ProbabilisticActor

from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, unrotate
from pedzoo.core.spec import parse
from pedzoo.policies.load import load_policy, load_robot_policy
from pedzoo.policies.robots._base import ObservedPeople, Robot, bodies_of
from pedzoo.policies.robots.attention import (
    TURN_GAIN,
    Attention,
    Encoder,
    as_action,
    as_decision,
    frame_of,
    head,
)
from pedzoo.policies.robots.baselines import Sampling
from pedzoo.sim.robots.env import RobotEnv, make_robot_env
from pedzoo.train.ppo.crowdnav import SETTINGS, CrowdNavEnv
from pedzoo.train.ppo.trainer import PPO, Gatherer, Objective, Updates, actor, check_ranges

_PEOPLE = "orca"
"""Who walks where nothing else is said, and always in CrowdNav's scenarios."""

CONSTANT_VELOCITY = "constant_velocity"
"""The name of the teacher that knows no more than the robot senses."""

_PLANNER = Sampling(speeds=3, horizon=12, discount=0.97, margin_cost=4.0)
"""What it does."""

Teacher = Callable[[TensorDictBase], Tensor]
"""Returns decisions (B, R, 2) for scenes, see `pedzoo.policies.robots.attention.Attention.mean`."""

_SEEN: list[Any] = [("robots", "observation"), ("robots", "body")]
"""What actor and critic read."""

_WRITTEN = ("loc", "scale", "decision", "log_prob", "taught", "action")
"""What `Decider` writes."""


def teacher_of(name: str) -> Teacher:
    """Return the teacher `CONSTANT_VELOCITY`, or a policy by `load_robot_policy`; errors as there."""
    if name == CONSTANT_VELOCITY:
        return taught
    policy = load_robot_policy(name)

    def decision(scenes: TensorDictBase) -> Tensor:
        bodies = bodies_of(scenes)
        return as_decision(policy.action(scenes), frame_of(scenes, bodies), bodies)

    return decision


@torch.no_grad()
def taught(scenes: TensorDictBase) -> Tensor:
    """Return the decisions (B, R, 2) of the best of some constant velocities, by what the robot senses.

    Where the lidar's beams end there is a wall. Robots on wheels turn towards the velocity.
    """
    bodies, observation = bodies_of(scenes), cast("TensorDictBase", scenes["robots", "observation"])
    seen = {str(key): cast("Tensor", value).flatten(0, 1) for key, value in observation.items()}
    top, way, walls = bodies.top_speed.flatten(), seen["waypoint"], None
    axis, left = functional.normalize(way, dim=-1), way.norm(dim=-1, keepdim=True).clamp_min(0.3)
    here = torch.zeros_like(way)
    robot = Robot(here, here, axis * left, seen["radius"][:, 0], top)
    place, velocity, radius = seen["people"].split([2, 2, 1], dim=-1)
    people = ObservedPeople(place, velocity, radius[..., 0], seen["people_mask"])
    if (lidar := seen.get("lidar")) is not None:
        turn = torch.arange(lidar.shape[1], device=lidar.device) * (2 * math.pi / lidar.shape[1])
        walls = partial(_nearest, lidar.unsqueeze(-1) * direction_of(turn))
    best = _PLANNER(robot, people, walls) / top.unsqueeze(-1)
    off, speed = torch.atan2(best[:, 1], best[:, 0]), best.norm(dim=-1)
    rate = (TURN_GAIN * off / bodies.top_turn.flatten()).clamp(-1, 1)
    wheels = torch.stack((speed * off.cos().clamp_min(0), rate), dim=-1)
    free = (bodies.drive == HOLONOMIC).flatten().unsqueeze(-1)
    return torch.where(free, unrotate(best, axis), wheels).view(*bodies.drive.shape, 2)


def _nearest(ends: Tensor, points: Tensor) -> Tensor:
    """Return how far points (B, M, 2) are from the nearest ends of beams (B, N, 2), metres (B, M)."""
    return torch.cdist(points, ends).amin(-1)


@dataclass(frozen=True)
class RobotUpdates(Updates):
    """What robots learn best with."""

    minibatches: int = 16
    gamma: float = 0.98
    entropy: float = 0.001
    critic: float = 0.5


class Mean(TensorDictModuleBase):
    """Writes mean and standard deviation (B, R, 2) of decisions, see `Attention.mean`."""

    in_keys: ClassVar[list[Any]] = _SEEN
    out_keys: ClassVar[list[Any]] = [("robots", "loc"), ("robots", "scale")]

    def __init__(self, policy: Attention, std: float) -> None:
        """Take the policy, and the standard deviation at the beginning, a share of the limits."""
        super().__init__()
        self.policy, self.log_std = policy, nn.Parameter(torch.full((2,), math.log(std)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``loc`` and ``scale``."""
        mean = self.policy.mean(tensordict)
        tensordict["robots", "loc"] = mean
        tensordict["robots", "scale"] = self.log_std.clamp(-4, 0.5).exp().expand_as(mean)
        return tensordict


class Value(TensorDictModuleBase):
    """The critic: the return that a robot can still expect, by a network as large as the policy's."""

    in_keys: ClassVar[list[Any]] = _SEEN
    out_keys: ClassVar[list[Any]] = [("robots", "value")]

    def __init__(self, policy: Attention) -> None:
        """Create the parameters."""
        super().__init__()
        self.encoder = Encoder(**policy.config)
        self.net = head(self.encoder.features, 2 * policy.config["width"], 1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the value (B, R, 1) of every robot."""
        seen = cast("TensorDictBase", tensordict["robots", "observation"])
        tensordict["robots", "value"] = self.net(self.encoder(seen, bodies_of(tensordict)))
        return tensordict


class Decider(TensorDictModuleBase):
    """Writes decisions (B, R, 2), actions, and the decisions of a teacher, if there is one: ``taught``."""

    in_keys: ClassVar[list[Any]] = _SEEN
    out_keys: ClassVar[list[Any]] = [("robots", key) for key in _WRITTEN]

    def __init__(self, acting: ProbabilisticActor) -> None:
        """Take the actor."""
        super().__init__()
        self.acting, self.teacher = acting, cast("Teacher | None", None)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write them; a teacher sees the scenes on the CPU."""
        decided: Any = self.acting(tensordict.select(*self.in_keys).clone())["robots"]
        decision = decided["decision"]
        taught = self.teacher(tensordict.to("cpu")).to(decision.device) if self.teacher else decision
        decided["taught"] = taught
        cast("Any", tensordict["robots"]).update(decided.exclude("observation", "body"))
        act(tensordict, decision)
        return tensordict


def act(scenes: TensorDictBase, decision: Tensor) -> None:
    """Write the actions of decisions (B, R, 2)."""
    bodies = bodies_of(scenes)
    scenes["robots", "action"] = as_action(decision, frame_of(scenes, bodies), bodies)


class RobotPPO(PPO):
    """Trains one robot in each scene, among people who are walked inside.

    Scenes are on the CPU, where a few hundred of them are fastest; what learns may be on another device.
    A validation runs the mean of the policy through the same episodes of every scenario every time.
    """

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
        physics: str | None = None,
        imitate: int = 0,
        teacher: str = CONSTANT_VELOCITY,
        std: float = 0.4,
        lr: float = 1e-3,
        final_lr: float = 0.05,
        clip: float = 0.5,
        **how: Any,
    ) -> None:
        """Take the robot, its place and the settings of its training.

        Args:
            policy: The network.
            scenarios: With settings, as of `pedzoo.make_robot_env`, or ``crowdnav:people=5`` or
                ``crowdnav_pp``, whose people and decisions are CrowdNav's; see
                `pedzoo.train.ppo.crowdnav.CrowdNavEnv`.
            people: A policy or a mixed crowd, in scenarios that are not CrowdNav's.
            robot: A body with settings.
            decision_dt: Seconds between two decisions.
            reward: Weights by name; see `pedzoo.sim.robots.rewards.DEFAULT_WEIGHTS`.
            envs: B, scenes of every scenario.
            steps: T, decisions in each of them for one update.
            updates: In an epoch.
            episodes: Of every scenario in a validation.
            physics: As in `pedzoo.make_robot_env`.
            imitate: So many updates at the beginning follow a teacher, not rewards.
            teacher: Its name; see `teacher_of`.
            std: Standard deviation of decisions at the beginning, a share of the robot's limits.
            lr: Learning rate of Adam at the beginning.
            final_lr: Share of it left at the end; it falls linearly.
            clip: Largest norms of the gradients of actor and critic.
            how: Settings of an update: those of `RobotUpdates`.

        Raises:
            UserError: No scenario, a number out of range, or people who are unknown or have no use.
        """
        super().__init__()
        numbers = {"envs": envs, "steps": steps, "updates": updates, "episodes": episodes, "std": std}
        check_ranges("--model.", **numbers, imitate=imitate, lr=lr, final_lr=final_lr, clip=clip)
        self.set_up(RobotUpdates(**how), clip, envs * steps, "--model.")
        if not scenarios:
            raise UserError("--model.scenarios: expected at least one, such as door:people=4")
        if any(parse(scenario).name not in SETTINGS for scenario in scenarios):
            load_policy(people)
        elif people != _PEOPLE:
            raise UserError(
                f"--model.people {people:.200}: no use for people with crowdnav scenarios, which have their "
                f"own: leave it out, or set --model.scenarios '[\"door:people=4\"]'"
            )
        self.scenarios, self.people, self.robot = scenarios, people, robot
        self.decision_dt, self.reward, self.physics = decision_dt, reward, physics
        self.envs, self.steps, self.updates, self.episodes = envs, steps, updates, episodes
        self.lr, self.final_lr, self.imitate = lr, final_lr, imitate
        self.teacher = teacher_of(teacher)
        self.mean, self.value = Mean(policy, std), Value(policy)
        self.seed = torch.initial_seed() % 2**31
        self.register_buffer("iteration", torch.zeros((), dtype=torch.long))

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
        acting = actor(self.mean, "robots", "decision")
        self._decider = (Decider(acting),)  # in a tuple: its parameters are registered already
        self._objective = Objective(acting, self.value, self.how, self.device, "decision", "robots")
        self.gatherers = [
            Gatherer(self.environment(name, self.envs, True), self._decider[0], self.steps, self.device)
            for name in self.scenarios
        ]

    def training_step(self, batch: Tensor, batch_idx: int) -> None:
        """Gather decisions and learn from them; in every epoch all scenes are new."""
        began = time.perf_counter()
        torch.manual_seed(self.seed * 1_000_003 + int(self.iteration))
        self._decider[0].teacher = self.teacher if int(self.iteration) < self.imitate else None
        seed = self.seed * 1_000_003 + self.current_epoch
        gathered = [gatherer.gather(seed) for gatherer in self.gatherers]
        parts: Any = [lived.select("robots", ("next", "robots")) for lived in gathered]
        lived = cast("TensorDict", torch.cat(parts)).to(self.device)
        with torch.no_grad():
            self.value(lived)
            self.value(lived["next"])
        then = cast("TensorDict", lived["next", "robots"])
        scored = then["info", "active"]
        lived["robots", "scored"] = scored & ~then.get(("info", "failed"), torch.zeros_like(scored))
        over = then["done"][..., 0] & scored
        log = {name: (over & flag).sum() / over.sum().clamp_min(1) for name, flag in _flags(then).items()}
        log["reward"] = then["reward"].mean()
        known = self._objective.rated(lived)
        share = min(int(self.iteration) / max(cast("int", self.trainer.max_epochs) * self.updates, 1), 1.0)
        for group in cast("Any", self.optimizers()).param_groups:
            group["lr"] = self.lr * (1 - (1 - self.final_lr) * share)
        log |= self.learn(self._objective.loss, known)
        self.iteration += 1
        log |= {"std": self.mean.log_std.detach().exp().mean()}
        log["samples_per_s"] = torch.tensor(len(known) / (time.perf_counter() - began))
        self.log("success", log["success"], prog_bar=True, logger=False, batch_size=1)
        values = {f"train/{key}": value for key, value in log.items()}
        self.log_dict(values, on_step=False, on_epoch=True, batch_size=1)

    def terms(self, part: TensorDict, result: TensorDict, number: int) -> TensorDict:
        """Follow the teacher at the beginning, not the rewards."""
        if int(self.iteration) < self.imitate:
            missed = (self.policy.mean(part) - part["robots", "taught"]).square().sum(-1)
            result["loss_objective"] = missed[part["robots", "scored"]].mean()
            del result["loss_entropy"]
        return result

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
        known = {"scenarios": self.scenarios, "crowd": self.people, "robot": self.robot}
        known |= {"decision_dt": self.decision_dt, "sensors": self.policy.sensors}
        checkpoint["pedzoo"] = {"architecture": "attention", "init": self.policy.config, "protocol": known}


def _flags(robots: TensorDictBase) -> dict[str, Tensor]:
    """Return for which robots (...) bool a decision was a success, a collision with anything, or the end."""
    info = cast("TensorDictBase", robots["info"])
    touched = torch.stack([info[name] for name in info.keys() if str(name).endswith("_contact")]).any(0)
    return {"success": info["success"], "collision": touched, "timeout": info["timeout"]}


@torch.no_grad()
def walked_once(
    env: RobotEnv | CrowdNavEnv, decide: Teacher, device: torch.device | str = "cpu"
) -> dict[str, Tensor]:
    """Return how one episode in each scene went: shares, seconds of those that succeeded, and the return.

    Args:
        env: With one robot in each scene, on the CPU.
        decide: Returns decisions (B, R, 2) for what robots sense.
        device: Where it decides.
    """
    env.set_seed(0, static_seed=True)
    now = env.reset()
    over = torch.zeros_like(now["robots", "info", "active"])
    flags: dict[str, Tensor] = dict.fromkeys(("success", "collision", "timeout"), over)
    reward = seconds = torch.zeros(over.shape)
    while not bool(over.all()):
        act(now, decide(now.select(*_SEEN).to(device)).cpu())
        now = env.step(now)["next"]
        robots = cast("TensorDictBase", now["robots"])
        seconds = seconds + env.decision_dt * ~over
        reward = reward + torch.where(over, 0.0, robots["reward"][..., 0])
        flags = {name: flags[name] | (flag & ~over) for name, flag in _flags(robots).items()}
        over = over | robots["done"][..., 0]
    share = {name: flag.float().mean() for name, flag in flags.items()}
    time = (seconds * flags["success"]).sum() / flags["success"].sum().clamp_min(1)
    return share | {"seconds": time, "return": reward.mean()}
