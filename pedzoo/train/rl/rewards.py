"""Rewards of decisions, from the observations before and after: they need no gradient."""

from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.registry import function_in_file
from pedzoo.metrics.contacts import nearest


class Reward:
    """The environment's own reward, and more where weights say so; all weights 0 leave it as it is.

    The environment's is the way that got shorter, in metres, less
    `pedzoo.sim.state.CONTACT_COST` for a decision in which something was touched; every weight is in
    that unit, metres of progress. A reward of one's own is a function in ``terms``, or a subclass that
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
        given = {name: value for name, value in locals().items() if name not in ("self", "terms")}
        for name, value in given.items():
            if value < 0 or (name == "near_distance" and value == 0):
                raise UserError(f"reward.{name} {value}: expected a number above 0, or 0 for none")
        self.person_cost, self.walls, self.arrival = person_cost, walls, arrival
        self.near, self.near_distance = near, near_distance
        self.effort, self.overspeed = effort, overspeed
        self.terms = [(name, function_in_file(name), weight) for name, weight in (terms or {}).items()]

    def __call__(self, before: TensorDict, after: TensorDict) -> Tensor:
        """Return each person's reward (N, A) from N observations before and after their actions.

        That of people who are not controlled is ignored. ``after`` has the environment's own reward.
        """
        seen, then = agents_of(before), agents_of(after)
        info = cast("TensorDict", then["info"])
        reward = then["reward"][..., 0]
        reward = reward - self.person_cost * info["agent_contact"].any(-1)
        reward = reward - self.walls * info["wall_contact"].any(-1)
        if self.near:
            trace = info["trace"]
            there = seen["mask"].unsqueeze(-1).expand(trace.shape[:-1])
            short = (1 - nearest(trace, there) / self.near_distance).clamp_min(0.0)
            reward = reward - self.near * short.mean(-1)
        if self.effort:
            reward = reward - self.effort * (then["velocity"] - seen["velocity"]).square().sum(-1)
        if self.overspeed:
            speed = torch.linalg.vector_norm(then["velocity"], dim=-1)
            reward = reward - self.overspeed * (speed - seen["pref_speed"][..., 0]).clamp_min(0.0)
        if self.arrival:
            left = seen["controlled"] & ~then["controlled"] & ~after["failed"]
            reward = reward + self.arrival * left
        for name, term, weight in self.terms:
            own = term(before, after)
            if not isinstance(own, Tensor) or own.shape != reward.shape:
                given = tuple(own.shape) if isinstance(own, Tensor) else type(own).__name__
                raise UserError(
                    f"reward {name}: expected the reward of all agents {tuple(reward.shape)}, not {given}"
                )
            reward = reward + weight * own
        return reward
