"""Self-play: people who all walk by one network learn from rewards, anchored to what recorded people do.

The second stage of a walker. Scenes have no safety layer, so that people have to keep clear by themselves.
What they do is rewarded, and so is being likely under the reference, the network before this stage (SPACeR,
arXiv 2510.18060); updates go on to maximise the likelihood of recorded states, too.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, ClassVar, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Distribution
from torch.nn import functional

from pedzoo.core.batch import agents_of, maps_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate, unrotate
from pedzoo.core.registry import function_in_file
from pedzoo.maps.planning.planner import Planner
from pedzoo.models.architectures.mdn_walker import Features, MdnWalker, Reader
from pedzoo.models.blocks.held_mixture import Change
from pedzoo.policies.memory import FirstSeenMemory
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.state import CONTACT_COST
from pedzoo.train.closed_loop.segments import Course
from pedzoo.train.ppo.trainer import PPO, Gatherer, Objective, Updates, actor, check_ranges
from pedzoo.train.walker import Targets, WalkerModule

_SAME = 1e-4
"""m/s: a velocity that differs by less is held. No Gaussian draws one."""

_SEEN = ("own", "near", "absent", "ahead", "before")
"""What a decision is made from, beside the network."""

_DECIDED = (*_SEEN, "action", "log_prob", "scored", "advantage", "value", "value_target")
"""What an update needs of a decision."""

_CHANGE = ("hold", "logits", "mean", "spread", "tilt")
"""The fields of a `Change` as a batch has them."""


class NextVelocity(Distribution):
    """The distribution of people's next velocities (..., 2), m/s, by that of the change of velocity."""

    arg_constraints: ClassVar[dict[str, Any]] = {}

    def __init__(
        self,
        hold: Tensor,
        logits: Tensor,
        mean: Tensor,
        spread: Tensor,
        tilt: Tensor,
        ahead: Tensor,
        before: Tensor,
    ) -> None:
        """Take a `Change`, unit vectors of the ways, and velocities before in their frame (..., 2), m/s."""
        self.change, self.ahead, self.before = Change(hold, logits, mean, spread, tilt), ahead, before
        super().__init__(hold.shape, torch.Size((2,)), validate_args=False)

    @torch.no_grad()
    def sample(self, sample_shape: Any = ()) -> Tensor:
        """Return one draw (..., 2); ``sample_shape`` has to be empty."""
        noise = torch.randn(*self.before.shape[:-1], 4, device=self.before.device)
        return rotate(self.before + self.change.at(noise), self.ahead)

    def entropy(self) -> Tensor:
        """Return an unbiased estimate (...) of the entropy, nats, by one draw."""
        return -self.log_prob(self.sample())

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log likelihood (...) of velocities (..., 2)."""
        change = unrotate(value, self.ahead) - self.before
        return self.change.log_prob(change, change.norm(dim=-1) < _SAME)


class Seeing(TensorDictModuleBase):
    """Writes what people see: the features of a scene batch, their ways and velocities."""

    in_keys: ClassVar[list[Any]] = ["agents", "maps", "map_id", "scene_pose", "scene_key", "time"]
    out_keys: ClassVar[list[Any]] = [("agents", name) for name in (*_SEEN, "first_history")]

    def __init__(self, walker: MdnWalker, remembers: bool = True) -> None:
        """Take the walker; ``remembers`` how people began, else batches have ``agents/first_history``."""
        super().__init__()
        self._walker = (walker,)  # in a tuple: its parameters are none of this module
        self._memory = FirstSeenMemory() if remembers else None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write them."""
        walker, scenes = self._walker[0], tensordict
        if self._memory is not None:
            scenes = self._memory.add(scenes.select(*self.in_keys))
            tensordict["agents", "first_history"] = scenes["agents", "first_history"]
        now = walker.view(cast("TensorDict", scenes))
        for name, value in zip(_SEEN, (*walker.features(now), now.ahead, now.velocity), strict=True):
            tensordict["agents", name] = value
        return tensordict


class Deciding(TensorDictModuleBase):
    """Writes the distribution of each person's next velocity."""

    in_keys: ClassVar[list[Any]] = [("agents", name) for name in _SEEN]
    out_keys: ClassVar[list[Any]] = [("agents", name) for name in _CHANGE]

    def __init__(self, walker: MdnWalker) -> None:
        """Take the walker."""
        super().__init__()
        self.walker = walker

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write its parameters."""
        change = self.walker.change(seen_in(tensordict)).tempered(self.walker.architecture.temperature)
        for key, value in zip(self.out_keys, change, strict=True):
            tensordict[key] = value
        return tensordict


class Critic(TensorDictModuleBase):
    """A number for each person's state, by a network that sees the same: its value, or a verdict."""

    in_keys: ClassVar[list[Any]] = [("agents", name) for name in _SEEN[:3]]
    out_keys: ClassVar[list[Any]] = [("agents", "value")]

    def __init__(self, walker: MdnWalker) -> None:
        """Create the parameters; features are scaled as the walker's."""
        super().__init__()
        self.reader, self.head = Reader(walker.architecture), nn.Linear(walker.architecture.width, 1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def of(self, seen: Features) -> Tensor:
        """Return it (...)."""
        return self.head(self.reader(seen))[..., 0]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write it (..., A, 1)."""
        tensordict["agents", "value"] = self.of(seen_in(tensordict)).unsqueeze(-1)
        return tensordict


def picked(tensordict: TensorDictBase, mine: Tensor) -> Features:
    """Return the features of some agents (M, ...), ``mine`` (N, A) bool."""
    return Features(*(value[mine] for value in seen_in(tensordict)))


def spread(values: Tensor, mine: Tensor) -> Tensor:
    """Return the values (M,) of some agents as (N, A); of others 0."""
    return torch.zeros(mine.shape, dtype=values.dtype, device=values.device).masked_scatter(mine, values)


def seen_in(tensordict: TensorDictBase) -> Features:
    """Return the features that `Seeing` wrote."""
    return Features(*(cast("Tensor", tensordict["agents", name]) for name in Features._fields))


@dataclass(frozen=True)
class Rewards:
    """Of a decision of a person.

    Attributes:
        progress: For each metre by which the way to the goal gets shorter.
        touch: Cost of touching another agent.
        wall: Cost of touching a wall.
        overspeed: Cost of being 1 m/s faster than one likes, growing linearly.
        time: Cost of a decision.
        real: In recorded crowds: for each nat of the judge's log odds that the next state is recorded.
        likely: For each nat of the decision's log likelihood under the reference, less its own: the cost of
            leaving what recorded people do.
        terms: Rewards of one's own and their weights, as ``{"path/to/file.py:slow": 2.0}``: functions of
            ``before`` and ``after``, as `__call__` takes them, that return each person's reward (N, A).
    """

    progress: float = 0.5
    touch: float = 1.0
    wall: float = 1.0
    overspeed: float = 0.5
    time: float = 0.02
    real: float = 0.1
    likely: float = 0.02
    terms: dict[str, float] = field(default_factory=dict)

    def __call__(self, before: TensorDict, after: TensorDict) -> Tensor:
        """Return each person's reward (N, A) but for judge and reference, of observations of N scenes.

        That of people who are not controlled means nothing.

        Raises:
            UserError: There is no such function, or it returns something else.
        """
        then = agents_of(after)
        info = cast("TensorDict", then["info"])
        touched, hit = (cast("Tensor", info[f"{what}_contact"]).any(-1) for what in ("agent", "wall"))
        progress = then["reward"][..., 0] + CONTACT_COST * (touched | hit)
        speed = cast("Tensor", then["velocity"]).norm(dim=-1)
        fast = (speed - then["pref_speed"][..., 0]).clamp_min(0)
        cost = self.touch * touched + self.wall * hit + self.overspeed * fast
        reward: Tensor = self.progress * progress - cost - self.time
        for name, weight in self.terms.items():
            own = function_in_file(name)(before, after)
            given = tuple(own.shape) if isinstance(own, Tensor) else type(own).__name__
            if given != (expected := tuple(reward.shape)):
                raise UserError(f"reward {name}: expected the reward of all agents {expected}, not {given}")
            reward = reward + weight * own
        return reward


@dataclass(frozen=True)
class Optimisation(Updates):
    """How much is learnt from the decisions of an iteration, and from recorded states beside them.

    Attributes:
        lr_critic: Learning rate of the critic's and the judge's Adam, constant.
        recorded: Weight of minus the log likelihood of recorded states.
        judged: Updates of the judge in an iteration with a recorded crowd.
    """

    passes: int = 2
    minibatches: int = 12
    lr_critic: float = 1e-3
    recorded: float = 0.5
    judged: int = 12


class SelfPlayModule(PPO, WalkerModule):
    """Independent PPO with one actor and one critic for all people; see the page of this file.

    In recorded crowds a judge learns to tell what people come into from what was recorded of the same crowd,
    and what it takes for recorded is rewarded (generative adversarial imitation, Ho and Ermon, NIPS 2016).
    """

    def __init__(
        self,
        generator: MdnWalker,
        courses: list[Course] | None = None,
        crowds: float = 1.0,
        rewards: Rewards = Rewards(),
        optimisation: Optimisation = Optimisation(),
        steps: int = 24,
        people: int = 300,
        **options: Any,
    ) -> None:
        """Take a walker, best with weights of the stage before.

        Args:
            generator: The model.
            courses: Scenarios in which people walk; one of them, by its share, in an iteration.
            crowds: Share of iterations in recorded crowds, beside those of the courses.
            rewards: Of a decision.
            optimisation: Settings of the updates.
            steps: Decisions of 0.4 s of an iteration.
            people: Who walk at once in a recorded crowd, about.
            options: Of `WalkerModule`.

        Raises:
            UserError: No course, or a number out of range.
        """
        super().__init__(generator, **options)
        self.courses = courses or []
        if not self.courses and not crowds > 0:
            raise UserError("--model.courses: expected at least one, such as {scenario: door}, or crowds")
        check_ranges("--model.", steps=steps)
        self.set_up(optimisation, self.clip or math.inf, steps * people, "--model.optimisation.")
        self.rewards, self.optimisation, self.steps, self.people = rewards, optimisation, steps, people
        for course in self.courses:
            make_scenario(course.scenario)  # a mistake is reported before the training begins
        for name in rewards.terms:
            function_in_file(name)
        self.critic, self.judge = Critic(generator), Critic(generator)
        self._shares = torch.tensor([*(course.share for course in self.courses), crowds])
        self._of: dict[tuple[int, int], Gatherer] = {}

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; the actor's learning rate is set at every iteration."""
        rest = [
            {"params": list(one.parameters()), "lr": self.optimisation.lr_critic}
            for one in (self.critic, self.judge)
        ]
        return torch.optim.Adam([{"params": list(self.generator.parameters())}, *rest], self.lr)

    def on_fit_start(self) -> None:
        """Take the reference, and make the actor and TorchRL's loss."""
        self.reference = (deepcopy(self.walker).eval().requires_grad_(False),)
        names = *_CHANGE, "ahead", "before"
        self._actor = actor(Deciding(self.walker), "agents", "action", names, NextVelocity)
        self._objective = Objective(self._actor, self.critic, self.how, self.device)

    def teardown(self, stage: str) -> None:
        """Close the environments."""
        super().teardown(stage)
        self._of = {}

    def scale(self, own: Tensor) -> None:
        """Keep the scales of features, as the weights before have them; critic and judge have the same."""
        for other in (self.critic, self.judge):
            for name in ("centre", "spread"):
                other.reader.get_buffer(name).copy_(self.walker.reader.get_buffer(name))

    def on_train_epoch_start(self) -> None:
        """Draw other states, where it is time. What decides in an update is what walked: no dropout."""
        super().on_train_epoch_start()
        for network in (self.walker, self.critic, self.judge):
            network.eval()

    def _gatherer(self, course: int, crowd: int, random: torch.Generator) -> Gatherer:
        """Return where decisions are gathered: in a course, or in a recorded crowd behind the last one."""
        if (course, crowd) in self._of:
            return self._of[course, crowd]
        planner, scenes = Planner.name, 1
        if crowd < 0:
            setting = self.courses[course]
            scene, scenes, planner = setting.scenario, setting.scenes, setting.planner
        else:
            recording = self._recordings[crowd]
            scenes = max(1, round(self.people * len(recording.frames) / recording.states))
            order = torch.randperm(len(recording.frames), generator=random)
            scene = recording.excerpts(recording.frames[order], 2 * self.steps)
        env = make_env(scene, scenes, "compiled", planner=planner)
        env.policy_name = "the model in training"
        policy = TensorDictSequential(*cast("Any", (Seeing(self.walker), self._actor)))
        self._of[course, crowd] = result = Gatherer(env, policy, self.steps, self.device)
        self.gatherers.append(result)
        return result

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Gather decisions and learn from them."""
        optimizer, random = cast("Any", self.optimizers()), self.random()
        course = int(torch.multinomial(self._shares, 1, generator=random))
        crowd = -1
        if course == len(self.courses):
            crowd = int(torch.multinomial(self.shares, 1, generator=random))
        # scenes go on from one iteration to the next within an epoch
        seen = self._gatherer(course, crowd, random).gather(self.seed * 1009 + self.current_epoch)
        lived, odds = self.lived_through(seen.to(self.device), crowd, random, optimizer)
        known = self._packed(self._objective.rated(lived))
        self.set_lr(optimizer, self.lr)
        for group in optimizer.param_groups[1:]:
            group["lr"] = self.optimisation.lr_critic
        self._random = random
        log = self.learn(self._objective.loss, known, random)
        self.iteration += 1
        scored, after = lived["agents", "scored"], cast("TensorDict", lived["next", "agents"])
        for name in ("reward", "likely", "touches"):
            log[name] = cast("Tensor", after[name]).view_as(scored)[scored].float().mean()
        if crowd >= 0:
            log["told_apart"] = odds
        self.show("reward", log["reward"])
        self.log_means(log)

    def lived_through(
        self, seen: TensorDict, crowd: int, random: torch.Generator, optimizer: Any
    ) -> tuple[TensorDict, Tensor]:
        """Return decisions (B, T) with rewards, values and ends of each person, as `Objective` wants them.

        And which share of states the judge tells right from recorded ones.
        """
        shape, maps = seen.batch_size, maps_of(seen)
        before = cast("TensorDict", seen.exclude("next", "maps").flatten(0, 1))
        after = cast("TensorDict", cast("TensorDict", seen["next"]).exclude("maps").flatten(0, 1))
        now, then = agents_of(before), agents_of(after)
        after.set_non_tensor("maps", maps)
        then["first_history"] = now["first_history"]
        now["scored"] = now["controlled"] & ~after["failed"]
        following = Seeing(self.walker, remembers=False)(after)
        stays = now["scored"] & then["controlled"] & (then["id"] == now["id"])
        right = torch.zeros(())
        if crowd >= 0:
            right = self._judge_learns(picked(following, stays), crowd, random, optimizer)
        mine, goes_on = now["controlled"], then["controlled"]
        with torch.no_grad():
            now["value"] = spread(self.critic.of(picked(before, mine)), mine).unsqueeze(-1)
            then["value"] = spread(self.critic.of(picked(following, goes_on)), goes_on).unsqueeze(-1)
            change = self.reference[0].change(picked(before, mine))
            change = change.tempered(self.walker.architecture.temperature)
            of_reference = NextVelocity(*change, now["ahead"][mine], now["before"][mine])
            theirs = spread(of_reference.log_prob(now["action"][mine]), mine)
            real = torch.zeros_like(theirs)
            if crowd >= 0:
                real = spread(-self.judge.of(picked(following, stays)).clamp(-4, 4), stays)
        info, rewards = cast("TensorDict", then["info"]), self.rewards
        touches = (info["agent_contact"] | info["wall_contact"]).any(-1)
        likely = (theirs - now["log_prob"]).clamp(-20, 20)
        reward = rewards(before, after) + rewards.likely * likely + rewards.real * real
        then["reward"] = torch.where(now["scored"], reward, 0.0).unsqueeze(-1)
        then["likely"], then["touches"] = likely, touches
        gone = ~then["controlled"] | (then["id"] != now["id"])
        for name in ("done", "terminated"):
            then[name] = (after[name] | gone).unsqueeze(-1)
        kept = then.select("reward", "done", "terminated", "value", "likely", "touches")
        before["next"] = TensorDict({"agents": kept}, before.batch_size)
        return before.unflatten(0, shape), right

    @staticmethod
    def _packed(known: TensorDict) -> TensorDict:
        """Return the decisions that count (M,), each of one agent, of decisions (N,) of A agents."""
        agents = agents_of(known).select(*_DECIDED)
        chosen = cast("TensorDict", agents[agents["scored"]])
        return TensorDict({"agents": chosen.unsqueeze(1)}, chosen.batch_size)

    def _judge_learns(self, made: Features, crowd: int, random: torch.Generator, optimizer: Any) -> Tensor:
        """Teach the judge simulated from recorded states of a crowd; return the share that it tells right."""
        pool = cast("Targets", self._pool)
        recorded = (pool.recording == crowd).nonzero()[:, 0]
        right = []
        self.judge.reader.train()
        for _ in range(self.optimisation.judged):
            some = recorded[torch.randint(len(recorded), (256,), generator=random)]
            other = torch.randint(len(made.own), (256,), generator=random)
            both = Features(*(torch.cat((a[other], b[some])) for a, b in zip(made, pool.seen, strict=True)))
            label = torch.cat((torch.ones(256), torch.zeros(256)))
            odds = self.judge.of(both)
            loss = functional.binary_cross_entropy_with_logits(odds, label)
            optimizer.zero_grad()
            self.manual_backward(loss)
            optimizer.step()
            right.append(((odds > 0) == (label > 0)).float().mean())
        self.judge.reader.eval()
        return torch.stack(right).mean().detach()

    def terms(self, part: TensorDict, result: TensorDict, number: int) -> TensorDict:
        """Add minus the log likelihood of recorded states, if it has a weight."""
        if weight := self.optimisation.recorded:
            result["loss_recorded"] = weight * self.surprise(self._random)
        return result
