"""PPO of people in the loop, on rewards that need no gradient: actor, critic, rewards and the training."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pedzoo.core.batch import agents_of, maps_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, rotate, unrotate
from pedzoo.core.registry import function_in_file
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.contacts import nearest
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.people import ego_frame
from pedzoo.models.blocks.people.approach import RelativePooling
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.policies.walker import Noise, Walker
from pedzoo.sim.make import make_env, make_scenario, prepare_scenario
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.train.module import ForecastModule
from pedzoo.train.ppo.trainer import PPO, Gatherer, Objective, Updates, actor, check_ranges

_RING, _RADIUS, _FAR = 8, 0.5, 1.0
"""Directions in which walls are looked for, and at how many metres; farther ones than 1 m are all alike."""


@dataclass(frozen=True)
class Collection:
    """Where and how decisions are gathered.

    Attributes:
        envs: Scenes of an iteration.
        steps: Decisions of 0.4 s in each of them.
        physics: ``compiled`` (fastest), ``torch``, ``bullet`` (pybullet) or ``file.py:Class``; null for what
            the variable ``PEDZOO_PHYSICS`` says, or ``compiled``.
        noise: Of the generator, as of `Walker`.
        std: Standard deviation of velocities at the beginning, m/s.
    """

    envs: int = 32
    steps: int = 32
    physics: str | None = None
    noise: Noise | None = None
    std: float = 0.15


@dataclass(frozen=True)
class Optimisation(Updates):
    """How much is learnt from the decisions of an iteration, and from recorded scenes beside them.

    Attributes:
        lr_critic: Learning rate of the critic's Adam, constant.
        recorded: Weight of the generator's own loss on recorded scenes, per scene; 0 leaves it out.
    """

    lr_critic: float = 1e-3
    recorded: float = 0.0


class Reward:
    """The environment's own reward, and more where weights say so, which are in metres of progress.

    The environment's is the way that got shorter, less `pedzoo.sim.state.CONTACT_COST` for a decision in
    which something was touched. A reward of one's own is a function in ``terms``, or a subclass that
    overrides ``__call__``, named by its ``class_path`` in the config.
    """

    def __init__(
        self,
        person_cost: float = 0.0,
        walls: float = 0.0,
        near: float = 0.0,
        near_distance: float = 0.6,
        effort: float = 0.0,
        overspeed: float = 0.0,
        arrival: float = 0.0,
        terms: dict[str, float] | None = None,
    ) -> None:
        """Weigh the further rewards, beside the environment's.

        Args:
            person_cost: Cost of a decision in which another person is touched, beyond the environment's.
            walls: Likewise of one in which a wall is.
            near: Cost of a decision throughout which the nearest other is at distance 0; it falls linearly
                to nothing at ``near_distance``.
            near_distance: Metres between centres.
            effort: Cost of a change of velocity by 1 m/s, growing with its square.
            overspeed: Cost of walking 1 m/s faster than one likes, growing linearly.
            arrival: Gain of having reached all goals.
            terms: Terms of one's own and their weights, as ``{"path/to/file.py:slow": 2.0}``: functions of
                ``before`` and ``after``, as `__call__` takes them, that return each person's reward (N, A).

        Raises:
            UserError: A negative number, or no such function.
        """
        for name, value in {**locals()}.items():
            if isinstance(value, int | float) and (value < 0 or (name == "near_distance" and value == 0)):
                raise UserError(f"reward.{name} {value}: expected a number above 0, or 0 for none")
        self.person_cost, self.walls, self.near, self.near_distance = person_cost, walls, near, near_distance
        self.effort, self.overspeed, self.arrival = effort, overspeed, arrival
        self.terms = [(name, function_in_file(name), weight) for name, weight in (terms or {}).items()]

    def __call__(self, before: TensorDict, after: TensorDict) -> Tensor:
        """Return each person's reward (N, A) from N observations before and after their actions.

        That of people who are not controlled is ignored. ``after`` has the environment's own reward.
        """
        seen, then = agents_of(before), agents_of(after)
        info = cast("TensorDict", then["info"])
        cost = self.person_cost * info["agent_contact"].any(-1) + self.walls * info["wall_contact"].any(-1)
        if self.near:
            there = seen["mask"].unsqueeze(-1).expand(info["trace"].shape[:-1])
            short = (1 - nearest(info["trace"], there) / self.near_distance).clamp_min(0.0)
            cost = cost + self.near * short.mean(-1)
        cost = cost + self.effort * (then["velocity"] - seen["velocity"]).square().sum(-1)
        speed = torch.linalg.vector_norm(then["velocity"], dim=-1)
        cost = cost + self.overspeed * (speed - seen["pref_speed"][..., 0]).clamp_min(0.0)
        left = seen["controlled"] & ~then["controlled"] & ~after["failed"]
        reward = then["reward"][..., 0] - cost + self.arrival * left
        for name, term, weight in self.terms:
            own = term(before, after)
            given = tuple(own.shape) if isinstance(own, Tensor) else type(own).__name__
            if given != (expected := tuple(reward.shape)):
                raise UserError(f"reward {name}: expected the reward of all agents {expected}, not {given}")
            reward = reward + weight * own
        return reward


class Mean(TensorDictModuleBase):
    """Writes mean and standard deviation (B, A, 2), m/s, of each person's velocity.

    The generator's noise is no part of the density: it is drawn by the scene's key, and equal in collecting
    and in updates. The deviation is one number: turning the scene turns the distribution. People that the
    policy does not move have a fixed distribution, and so a constant likelihood.
    """

    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", "loc"), ("agents", "scale")]

    def __init__(self, walker: Walker, log_std: nn.Parameter) -> None:
        """Take the walker, and the logarithm of the standard deviation, a scalar."""
        super().__init__()
        self.walker, self.log_std = walker, log_std

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``loc`` and ``scale``."""
        # a walker writes an action: not over the taken one
        seen = tensordict.select(*self.in_keys).clone(False)
        with set_exploration_type(ExplorationType.RANDOM):
            velocity = self.walker(seen)["agents", "action"]
        moved = seen["agents", "controlled"].unsqueeze(-1)
        tensordict["agents", "loc"] = torch.where(moved, velocity, 0.0)
        tensordict["agents", "scale"] = torch.where(moved, self.log_std.exp(), 1.0).expand_as(velocity)
        return tensordict


class Critic(TensorDictModuleBase):
    """One decentralised network for all people: each person's value from their surroundings.

    In each person's own frame it sees their velocity, goal and desired velocity, others (`RelativePooling`),
    the distance to walls, and the length of the remaining path. Untrained it gives the reward of a person
    alone who walks that path at the preferred speed: the first updates show which people were held up.
    """

    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose"]
    out_keys: ClassVar[list[Any]] = [("agents", "value")]

    def __init__(self, gamma: float, hidden_dim: int = 64, pool_dim: int = 32) -> None:
        """Create the parameters; ``gamma`` is the discount of a decision of 0.4 s."""
        super().__init__()
        self.gamma = gamma
        self.others = RelativePooling(hidden_dim, pool_dim)
        seen = 3 * 2 + 3 + 1 + _RING  # vectors; speed and way; walls
        first, last = nn.Linear(seen + pool_dim, hidden_dim), nn.Linear(hidden_dim, 1)
        self.net = nn.Sequential(first, nn.Tanh(), nn.Linear(hidden_dim, hidden_dim), nn.Tanh(), last)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        angle = torch.arange(_RING) * (2 * math.pi / _RING)
        self._ring = torch.cat((torch.zeros(1, 2), _RADIUS * direction_of(angle)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's value (N, A, 1), metres of progress; 0 where no person is."""
        batch = cast("TensorDict", tensordict)
        agents = agents_of(batch)
        crowd = Crowd.of(agents["mask"])
        history, speed = crowd.pack(agents["history"]), crowd.pack(agents["pref_speed"])
        position, moved = history[:, -1], history.diff(dim=1)
        goal = crowd.pack(agents["goal"]) - position
        way = crowd.pack(agents["info", "remaining_path"]).unsqueeze(-1)
        frame = ego_frame.heading(moved, goal)
        vectors = torch.stack(
            (crowd.pack(agents["velocity"]), crowd.pack(agents["desired_velocity"]), goal / 4.0), 1
        )
        around = position.unsqueeze(1) + rotate(self._ring.to(frame), frame.unsqueeze(1))
        map_id, pose = batch["map_id"][crowd.scene, 0], batch["scene_pose"][crowd.scene]
        walls = maps_of(batch).signed_distance(around, map_id, pose).clamp(-_FAR, _FAR) / _FAR
        alone = self.alone(way, speed)
        features = (
            unrotate(vectors, frame.unsqueeze(1)).flatten(1),
            *(speed, way / 10.0, alone, walls),
            self.others(position, moved[:, -1], frame, crowd),
        )
        tensordict["agents", "value"] = crowd.unpack(alone + self.net(torch.cat(features, -1)))
        return tensordict

    def alone(self, way: Tensor, speed: Tensor) -> Tensor:
        """Return the discounted reward, metres, of walking ``way`` (P, 1), metres, at ``speed`` (P, 1)."""
        step = STEP_SECONDS * speed.clamp_min(0.1)
        if self.gamma == 1:
            return way
        return step * (1 - self.gamma ** (way / step)) / (1 - self.gamma)


def lived_through(seen: TensorDict, reward: Reward, critic: TensorDictModuleBase) -> TensorDict:
    """Return decisions (B, T) with each person's rewards, values and ends, as `Objective` wants them.

    An episode ends for a person who leaves, and for a slot that another person takes over. Where the time is
    up for a whole scene the rest is estimated instead. ``seen`` (B, T) is of `Gatherer.gather`.
    """
    shape, maps = seen.batch_size, maps_of(seen)
    before = cast("TensorDict", seen.exclude("next", "maps").flatten(0, 1))
    after = cast("TensorDict", cast("TensorDict", seen["next"]).exclude("maps").flatten(0, 1))
    now, then = agents_of(before), agents_of(after)
    for state, people in ((before, now), (after, then)):
        state.set_non_tensor("maps", maps)  # one entry, where TorchRL made one for every decision
        with torch.no_grad():
            value = critic(state)["agents", "value"]
        people["value"] = torch.where(people["controlled"].unsqueeze(-1), value, 0.0)
    now["scored"] = now["controlled"] & ~after["failed"]
    then["reward"] = torch.where(now["scored"], reward(before, after), 0.0).unsqueeze(-1)
    gone = ~then["controlled"] | (then["id"] != now["id"])
    for name in ("done", "terminated"):
        then[name] = (after[name] | gone).unsqueeze(-1)
    kept = then.select("reward", "done", "terminated", "value")
    before["next"] = TensorDict({"agents": kept}, before.batch_size)
    return before.unflatten(0, shape)


class PPOModule(PPO, ForecastModule):
    """Proximal policy optimisation of people who all walk by the same generator.

    Each is one sample of the batch: decentralised actor and critic with shared parameters (independent PPO).
    The generator gives the mean of the velocity, a learned number the standard deviation; only the mean walks
    after training. Only people that the policy moves count. An iteration gathers decisions in one of the
    scenarios, in turn. Recorded scenes of the data can keep the forecasts, see `Optimisation`.
    """

    in_scenes = True

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
            UserError: No scenario, an unknown one, or a number out of range.
        """
        super().__init__(generator, **options)
        if not scenarios:
            raise UserError("--model.scenarios: expected at least one, such as door")
        check_ranges("--model.collection.", envs=collection.envs, steps=collection.steps, std=collection.std)
        decisions = collection.envs * collection.steps
        self.set_up(optimisation, self.clip or math.inf, decisions, "--model.optimisation.")
        self.scenarios = [make_scenario(name) for name in scenarios]
        self.reward, self.collection, self.optimisation = reward, collection, optimisation
        self.critic = Critic(optimisation.gamma)
        self.log_std = nn.Parameter(torch.tensor(collection.std).log())
        self._prepared: list[PreparedScenario] = []

    def setup(self, stage: str) -> None:
        """Plan the scenes, too: errors are raised before anything is written."""
        super().setup(stage)
        if stage == "fit":
            self._prepared = [prepare_scenario(scenario) for scenario in self.scenarios]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; the actor's learning rate is set at every iteration."""
        critic = {"params": list(self.critic.parameters()), "lr": self.optimisation.lr_critic}
        return torch.optim.Adam([{"params": [*self.generator.parameters(), self.log_std]}, critic], self.lr)

    def steps_per_iteration(self) -> float:
        """Return how many optimizer steps one iteration makes."""
        return self.how.passes * self.how.minibatches

    def on_fit_start(self) -> None:
        """Make environments, collectors and TorchRL's loss; processes share the scenes of a seed."""
        acting = actor(Mean(Walker(self.generator, self.collection.noise), self.log_std), "agents", "action")
        self._objective = Objective(acting, self.critic, self.how, self.device)
        scenes, physics = self.collection.envs, self.collection.physics
        rank, processes = self.trainer.global_rank, self.trainer.world_size
        shares: dict[str, Any] = {"first_episode": rank * scenes, "stride": processes * scenes}
        for scenario in self._prepared:
            env = make_env(scenario, scenes, physics, **shares)
            env.policy_name = "the model in training"
            self.gatherers.append(Gatherer(env, acting, self.collection.steps, self.device))

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Gather decisions and learn from them."""
        number, optimizer, random = int(self.iteration), cast("Any", self.optimizers()), self.random()
        # the network that decides in an update has to be the one that walked: without dropout
        dropping = [
            part for part in self.generator.modules() if isinstance(part, nn.Dropout) and part.training
        ]
        for part in dropping:
            part.eval()
        seen = self.gatherers[number % len(self.gatherers)].gather(self.step_seed)
        lived = lived_through(seen.to(self.device), self.reward, self.critic)
        known = self._objective.rated(lived)
        self.set_lr(optimizer, self.lr)
        optimizer.param_groups[1]["lr"] = self.optimisation.lr_critic
        self._recorded = batch.split(-(-len(batch) // self.how.minibatches)), random
        log = self.learn(self._objective.loss, known, random)
        for part in dropping:
            part.train()
        self.iteration += 1
        people = agents_of(known)
        target, value = (people[key][people["scored"]] for key in ("value_target", "value"))
        missed, spread = (target - value).square().mean(), (target - target.mean()).square().mean()
        reward = cast("Tensor", lived["next", "agents", "reward"])
        log["reward"] = reward[lived["agents", "scored"]].mean()
        log["explained"] = 1 - missed / spread.clamp_min(1e-6)
        log |= {"std": self.log_std.detach().exp(), "skipped": self.skipped.float()}
        self.show("reward", log["reward"])
        self.log_means(log, len(batch), sync_dist=True)

    def terms(self, part: TensorDict, result: TensorDict, number: int) -> TensorDict:
        """Add the generator's own loss on a part of the recorded scenes, if it has a weight."""
        if weight := self.optimisation.recorded:
            parts, random = self._recorded
            scenes = cast("TensorDict", parts[number % len(parts)])
            result["loss_recorded"] = weight * self.generator.loss(scenes, random) / len(scenes)
        return result
