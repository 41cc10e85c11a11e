"""Where the time goes when SGAN+goal+map walks: network, planner, bodies, resets, the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import torch
from tensordict import TensorDictBase

from pedzoo.core.types import STEP_SECONDS
from pedzoo.policies.load import load_policy
from pedzoo.sim import kernel
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from tools.bench.figures import Measured, Row
from tools.bench.scenes import LARGEST, Size, scenario, sizes
from tools.bench.section import Section
from tools.bench.turns import Clock

MODEL = "sgan_goal_map.zara1"
NETWORK, PLANNER = "network", "planner (guide, look)"
WALKING, RESETS, REST = "bodies (advance: paths, contacts)", "resets", "observation and bookkeeping"
PARTS = (NETWORK, PLANNER, WALKING, RESETS, REST)
SUMS = {
    "planner + bodies + bookkeeping": (PLANNER, WALKING, REST),
    "everything but the network": PARTS[1:],
}
BAR = 30.0
"""Percent of a step that each of the sums should stay below."""

EPISODE = 20.0
"""Simulated seconds of a turn, about an episode: every turn has its share of resets."""


class Profile(Section):
    """The calls themselves are timed. Whatever a reset calls is part of the reset; nothing counts twice."""

    takes = 6, 20

    def rows(self) -> Iterator[Row]:
        """Measure at the largest size, or those asked for."""
        for size in sizes(self.settings, [Size(16, 5) if self.settings.quick else LARGEST]):
            yield from self._size(size)

    def _size(self, size: Size) -> Iterator[Row]:
        env = make_env(scenario(size.people, self.settings.maps), size.scenes)
        policy = load_policy(MODEL)
        split = Split(self.settings.clock)
        least = 2 if self.settings.quick else round(EPISODE / STEP_SECONDS)
        with parts_timed(split, env):
            shares, seconds = self._turns(split, env, policy, least)
        where = {"size": str(size), "map": env.bank.grids[0].name}
        for part in PARTS:
            metrics = {
                "percent": Measured.of([100 * share[part] for share in shares]),
                "step_ms": Measured.of(
                    [1e3 * share[part] * step for share, step in zip(shares, seconds, strict=True)]
                ),
            }
            yield Row("profile", part, where, metrics)
        for name, parts in SUMS.items():
            percent = Measured.of([100 * sum(share[part] for part in parts) for share in shares])
            row = Row("profile", name, where, {"percent": percent})
            bars = [row.below("percent", BAR)] if size == LARGEST else []
            yield replace(row, bars=bars)

    @torch.no_grad()
    def _turns(
        self, split: Split, env: PedestrianEnv, policy: Any, least: int
    ) -> tuple[list[dict[str, float]], list[float]]:
        """Return the share of each part, and the seconds of a step, in every turn."""
        now: TensorDictBase = env.reset()
        shares, seconds = [], []
        for turn in range(-1, self.settings.turns):  # the first is not counted: all scenes begin at once
            split.start()
            steps = 0
            while steps < least or (turn >= 0 and split.total < self.settings.seconds):
                with split.part(NETWORK):
                    now = policy(now)
                _, now = env.step_and_maybe_reset(now)
                steps += 1
            if turn >= 0:
                shares.append(split.shares())
                seconds.append(split.total / steps)
        return shares, seconds


class Split:
    """Gives every moment to one part: to the innermost that is running, or to the rest."""

    def __init__(self, now: Clock) -> None:
        """Take the clock."""
        self._now = now
        self.start()

    def start(self) -> None:
        """Forget what was measured."""
        self._taken: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        self._running = [REST]
        self._since = self._now()

    @property
    def total(self) -> float:
        """Seconds since the start."""
        self._mark()
        return sum(self._taken.values())

    def shares(self) -> dict[str, float]:
        """Return the shares of all parts, which sum to one."""
        total = self.total
        return {part: taken / total for part, taken in self._taken.items()}

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Give the time of the block to a part, unless it is in a reset."""
        self._mark()
        self._running.append(RESETS if self._running[-1] == RESETS else name)
        try:
            yield
        finally:
            self._mark()
            self._running.pop()

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function whose time goes to a part."""

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            with self.part(name):
                return call(*args, **kwargs)

        return wrapped

    def _mark(self) -> None:
        now = self._now()
        self._taken[self._running[-1]] += now - self._since
        self._since = now


@contextmanager
def parts_timed(split: Split, env: PedestrianEnv) -> Iterator[None]:
    """Time the parts of an environment's steps within the block."""
    planner = env.prepared.planner
    calls = (
        (PLANNER, planner, "guidance"),
        (PLANNER, planner, "next_waypoints"),
        (WALKING, env.physics, "advance"),
        (WALKING, kernel, "step_compiled"),  # the same as one compiled loop
        (RESETS, env, "_reset"),
    )
    with ExitStack() as stack:
        for part, owner, name in calls:
            stack.enter_context(patch.object(owner, name, split.timed(part, getattr(owner, name))))
        yield
