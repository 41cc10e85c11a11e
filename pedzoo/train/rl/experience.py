"""A policy's experience: decisions in an environment, gathered by TorchRL, and their advantages."""

import warnings
from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.value import GAE

from pedzoo.core.batch import agents_of, maps_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.sim.make import make_env
from pedzoo.sim.scenario import PreparedScenario

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # TorchRL 0.14 subclasses what it deprecates
    from torchrl.collectors import Collector

_SEEDS = 2**52
"""First seed of scenes in training: evaluations use smaller ones."""


class Gatherer:
    """A scenario, B scenes at once, in which a policy gathers experience.

    Every gathering begins with new episodes, named by its seed; a scene that ends is followed by the next
    episode. So experience depends on policy and seed alone, and a resumed training meets the scenes of an
    uninterrupted one. The price: an episode longer than ``steps`` is not seen to its end; its value is
    estimated.

    Attributes:
        env: The environment.
    """

    def __init__(
        self,
        scenario: PreparedScenario,
        policy: TensorDictModuleBase,
        scenes: int,
        steps: int,
        physics: str = "compiled",
        device: torch.device | None = None,
        rank: int = 0,
        processes: int = 1,
    ) -> None:
        """Make the environment and TorchRL's collector.

        Args:
            scenario: The people's starts and goals, and the floor plan.
            policy: Writes ``action`` and ``log_prob``; its weights may change in between.
            scenes: B.
            steps: T, decisions of every scene in one gathering.
            physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class``.
            device: Where the policy is; scenes and experience are on the CPU.
            rank: Number of this process.
            processes: That share the scenes of a seed.
        """
        self.env = make_env(
            scenario,
            scenes,
            physics,
            decision_dt=STEP_SECONDS,
            first_episode=rank * scenes,
            stride=processes * scenes,
        )
        self.env.policy_name = "the model in training"
        self._collector = Collector(
            self.env,
            policy,
            frames_per_batch=scenes * steps,
            policy_device=device,
            storing_device="cpu",
            reset_at_each_iter=True,
            trust_policy=True,
            track_traj_ids=False,
            auto_register_policy_transforms=False,  # nothing recurs from one decision to the next
        )
        self._gathered = iter(self._collector)

    def gather(self, seed: int) -> TensorDict:
        """Return T decisions in B scenes (B, T, ...), with the result of each under ``next``."""
        self.env.set_seed(_SEEDS + seed, static_seed=True)
        return cast("TensorDict", next(self._gathered))

    def close(self) -> None:
        """Let go of the collector and the physics."""
        self._collector.shutdown(close_env=False)
        self.env.physics.close()


def with_advantages(
    seen: TensorDict,
    reward: Callable[[TensorDict, TensorDict], Tensor],
    critic: Callable[[TensorDictBase], TensorDictBase],
    estimate: GAE,
) -> TensorDict:
    """Return decisions (N,) as a loss wants them, with rewards and advantages.

    An episode ends for a person who leaves, and for a slot that another person takes over: rewards of others
    are not theirs. Where the time is up for a whole scene the rest is estimated instead. Advantages of the
    decisions that count have mean 0 and standard deviation 1; all others are 0. ``seen`` (B, T) is of
    `Gatherer.gather`; TorchRL's estimator has no network of its own.
    """
    shape = seen.batch_size
    maps = maps_of(seen)
    before = cast("TensorDict", seen.exclude("next", "maps").flatten(0, 1))
    after = cast("TensorDict", cast("TensorDict", seen["next"]).exclude("maps").flatten(0, 1))
    for state in (before, after):
        state.set_non_tensor("maps", maps)  # one entry, where TorchRL made one for every decision
    now, then = agents_of(before), agents_of(after)
    scored = now["controlled"] & ~after["failed"]
    gone = ~then["controlled"] | (then["id"] != now["id"])
    for state, people in ((before, now), (after, then)):
        with torch.no_grad():
            value = critic(state)["agents", "value"]
        people["value"] = torch.where(people["controlled"].unsqueeze(-1), value, 0.0)
    then["reward"] = torch.where(scored, reward(before, after), 0.0).unsqueeze(-1)
    for name in ("done", "terminated"):
        then[name] = (after[name] | gone).unsqueeze(-1)
    now["scored"] = scored
    before["next"] = TensorDict(
        {"agents": then.select("reward", "done", "terminated", "value")}, before.batch_size
    )
    rated: Any = estimate(before.unflatten(0, shape)).flatten(0, 1)
    people = rated["agents"]
    advantage = people["advantage"][..., 0]
    known = advantage[scored]
    spread = known.std() if len(known) > 1 else known.new_ones(())
    advantage = (advantage - known.mean()) / spread.clamp_min(1e-6) if len(known) else advantage
    for name, value in (("advantage", advantage), ("value_target", people["value_target"][..., 0])):
        people[name] = torch.where(scored, value, 0.0).unsqueeze(-1)
    return rated
