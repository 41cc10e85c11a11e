"""The experience of robots: their decisions, with rewards and advantages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.value import GAE

from pedzoo.policies.robots._base import bodies_of
from pedzoo.policies.robots.attention import as_action, frame_of
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.train.robots.crowdnav import CrowdNavEnv

_KEPT: list[Any] = [("robots", "observation"), ("robots", "body")]


class Gatherer:
    """B scenes in which a policy gathers decisions; scenes of a seed go on from one gathering to the next.

    A checkpoint keeps no scenes: with a seed of its own in every epoch, a resumed training meets those of an
    uninterrupted one.

    TorchRL's collectors store the whole scene batch of every decision. This stores the robots' observations.
    """

    def __init__(self, env: RobotEnv | CrowdNavEnv) -> None:
        """Take an environment."""
        self.env = env
        self._seed: int | None = None
        self._now: TensorDictBase = TensorDict()

    @torch.no_grad()
    def gather(
        self,
        acting: TensorDictModuleBase,
        steps: int,
        seed: int,
        teacher: Teacher | None = None,
        device: torch.device | str = "cpu",
    ) -> TensorDict:
        """Return decisions (B, T, R) with what followed under ``next``.

        Args:
            acting: Writes ``robots/decision`` and ``log_prob``.
            steps: T.
            seed: Of the scenes; with another one than before, all begin anew.
            teacher: Says what it would have decided (B, R, 2): ``robots/taught``.
            device: Where ``acting`` is; scenes and decisions are on the CPU.
        """
        if seed != self._seed:
            self.env.set_seed(seed, static_seed=True)
            self._seed, self._now = seed, self.env.reset()
        now, lived = self._now, []
        for _ in range(steps):
            before = acting(now.select(*_KEPT).clone().to(device)).to("cpu")
            if teacher:
                before["robots", "taught"] = teacher(now)
            act(now, before["robots", "decision"])
            whole, now = self.env.step_and_maybe_reset(now)
            then = whole["next"].select(
                *_KEPT, *[("robots", key) for key in ("info", "reward", "done", "terminated")]
            )
            before["next"] = then.clone()
            lived.append(before)
        self._now = now
        return cast("TensorDict", torch.stack(lived, 1))


Teacher = Callable[[TensorDictBase], Tensor]
"""Returns decisions (B, R, 2) for scenes, see `pedzoo.policies.robots.attention.Attention.mean`."""


def act(scenes: TensorDictBase, decision: Tensor) -> None:
    """Write the actions of decisions (B, R, 2)."""
    bodies = bodies_of(scenes)
    scenes["robots", "action"] = as_action(decision, frame_of(scenes, bodies), bodies)


@torch.no_grad()
def with_advantages(lived: TensorDict, critic: TensorDictModuleBase, estimate: GAE) -> TensorDict:
    """Return decisions (N, R) with advantages, of mean 0 and deviation 1 over those that count, and values.

    Args:
        lived: (B, T), as of `Gatherer.gather`.
        critic: Writes ``robots/value``.
        estimate: TorchRL's estimator.
    """
    then = cast("TensorDict", lived["next"])
    critic(lived)
    critic(then)
    robots, info = cast("TensorDict", lived["robots"]), cast("TensorDict", then["robots", "info"])
    robots["scored"] = info["active"]
    if "failed" in info.keys():
        robots["scored"] = robots["scored"] & ~info["failed"]
    estimate(lived)
    scored, advantage = robots["scored"].unsqueeze(-1), robots["advantage"]
    known = advantage[scored]
    spread = known.std(correction=0).clamp_min(1e-6)
    robots["advantage"] = torch.where(scored, (advantage - known.mean()) / spread, 0.0)
    return cast("TensorDict", lived.select("robots").flatten(0, 1))


def outcome_shares(then: TensorDictBase) -> dict[str, Tensor]:
    """Return the shares of success, contacts and so on among the episodes that ended in decisions (...)."""
    robots = cast("TensorDictBase", then["robots"])
    info, over = cast("TensorDictBase", robots["info"]), robots["done"][..., 0] & robots["info", "active"]
    flags = {"success": info["success"], "collision": touched(info), "timeout": info["timeout"]}
    count = over.sum().clamp_min(1)
    return {name: (over & flag).sum() / count for name, flag in flags.items()}


def touched(info: TensorDictBase) -> Tensor:
    """Return which robots (...) bool touched anything."""
    names = ("person_contact", "robot_contact", "wall_contact")
    return torch.stack([info[name] for name in names if name in info.keys()]).any(0)


@torch.no_grad()
def walked_once(
    env: RobotEnv | CrowdNavEnv, decide: Teacher, device: torch.device | str = "cpu"
) -> dict[str, Tensor]:
    """Return how one episode in each scene went: shares, seconds of those that succeeded, and the return.

    Args:
        env: With one robot in each scene.
        decide: Returns decisions (B, R, 2) for what robots sense.
        device: Where it decides; scenes are on the CPU.
    """
    env.set_seed(0, static_seed=True)
    now = env.reset()
    shape = now["robots", "info", "active"].shape
    flags = {name: torch.zeros(shape, dtype=torch.bool) for name in ("success", "collision", "timeout")}
    over, reward, seconds = torch.zeros(shape, dtype=torch.bool), torch.zeros(shape), torch.zeros(shape)
    while not bool(over.all()):
        act(now, decide(now.select(*_KEPT).to(device)).cpu())
        now = env.step(now)["next"]
        robots = now["robots"]
        info = robots["info"]
        seconds += env.decision_dt * ~over
        reward += torch.where(over, 0.0, robots["reward"][..., 0])
        happened = {"success": info["success"], "collision": touched(info), "timeout": info["timeout"]}
        flags = {name: flags[name] | (happened[name] & ~over) for name in flags}
        over = over | robots["done"][..., 0]
    share = {name: flag.float().mean() for name, flag in flags.items()}
    time = (seconds * flags["success"]).sum() / flags["success"].sum().clamp_min(1)
    return share | {"seconds": time, "return": reward.mean()}
