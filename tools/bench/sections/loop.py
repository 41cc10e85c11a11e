"""The loop: agent-steps per second of the environment with each policy, beside VMAS and RVO2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from pedzoo.core.types import STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.walls.segments import WallSegments
from pedzoo.policies.load import load_policy
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.scenario_parts.scenario import PreparedScenario
from tools.bench.figures import Measured, Row, Verdict
from tools.bench.peer import Scenes, running
from tools.bench.scenes import LARGEST, QUICK, SIZES, Size, for_peers, scenario, sizes
from tools.bench.section import Section
from tools.bench.turns import Side, in_turns, ratio, repeated, seconds_of

MODEL = "sgan_goal_map.zara1"
NETWORK = f"{MODEL} alone"
KEPT_CLEAR = "sgan_goal_map.indoor"
"""Trained in the loop, with a safety layer."""

UNHELD = f"{KEPT_CLEAR}:safety=false"
BARE = "go_to_goal"
SHORT = f"go_to_goal:dt={TRACE_SECONDS}"
ORCA = f"orca:dt={STEP_SECONDS}"
POLICIES_TIMED = (
    BARE,
    SHORT,
    f"{ORCA},walls=false",
    ORCA,
    "orca",
    "social_force",
    MODEL,
    KEPT_CLEAR,
    UNHELD,
)
"""Who walks; the first makes the environment bare. Some decide every 0.1 s, as VMAS does."""

WARM, TURN = 20.0, 10.0
"""Simulated seconds before the first turn and in each at least, so that all have their share of resets."""

BARS = {
    BARE: ("times_vmas_lidar", 3.0),
    SHORT: ("times_vmas_lidar", 3.0),
    ORCA: ("times_pyrvo_from_python", 1.0),
}
"""Whom a policy's loop has to be so many times as fast as, at the largest size."""

FAST_ENOUGH = 100_000
"""Agent-steps per second at which it does not matter how much faster the network alone would be."""


class Loop(Section):
    """An agent-step is one decision of one person; ``step_s`` is how much time is simulated in it.

    Ours has trace points every 0.1 s with their sub-steps, walls, contacts, goals, the planner's guidance,
    the observation, resets and new goals. Bars compare one agent-step with one of a peer, whatever is in it.
    """

    takes = 13, 515

    def rows(self) -> Iterator[Row]:
        """Measure every size."""
        known: dict[int, tuple[PreparedScenario, Measured]] = {}
        for size in sizes(self.settings, QUICK if self.settings.quick else SIZES):
            if size.people not in known:
                begun = self.settings.clock()
                made = scenario(size.people, self.settings.maps)
                known[size.people] = made, Measured.of([self.settings.clock() - begun])
            yield from self._size(size, *known[size.people])

    def _size(self, size: Size, scene: PreparedScenario, prepared: Measured) -> Iterator[Row]:
        """Time all sides at one size."""
        where = {"size": str(size), "map": scene.bank.grids[0].name}
        walks = [Walk(scene, size, policy, self.settings.quick) for policy in POLICIES_TIMED]
        resets = [1e3 * seconds_of(walks[0].env.reset, self.settings.clock) for _ in range(5)]
        walks[0].now = walks[0].env.reset()
        yield Row("loop", "reset", where, {"reset_ms": Measured.of(resets), "planner_s": prepared})

        now = self.settings.clock
        sides = {walk.title: repeated(walk.step, size.total, now, walk.least) for walk in walks}
        by_name = {walk.policy_name: walk for walk in walks}
        sides[NETWORK] = repeated(by_name[MODEL].ask, size.total, now)
        about = by_name[ORCA].scenes()
        with running(self.settings) as peers:
            rivals = [case for peer in peers for case in peer.cases([about])]
            for peer in peers:
                self.versions |= peer.versions
            every: dict[str, Side] = sides | {case.title: case.side for case in rivals}
            speeds = in_turns(every, self.settings.turns, self.settings.seconds)

        for walk in walks:
            result = speeds[walk.title]
            metrics = _metrics(result, walk.env.decision_dt)
            metrics |= {case.metric: ratio(result, speeds[case.title]) for case in rivals}
            if walk.policy_name == MODEL:
                metrics["times_network"] = ratio(result, speeds[NETWORK])
            if walk.policy_name == KEPT_CLEAR:
                metrics["times_without_safety"] = ratio(result, speeds[by_name[UNHELD].title])
            row = Row("loop", walk.title, where, metrics)
            yield replace(row, bars=self._bars(row, walk.policy_name, size))
        alone = _metrics(speeds[NETWORK], STEP_SECONDS)
        yield Row("loop", NETWORK, where, alone, note="asked about the same scenes again and again")
        for case in rivals:
            yield Row(
                "loop", case.title, where, _metrics(speeds[case.title], case.step_seconds), (), case.note
            )

    def _bars(self, row: Row, policy: str, size: Size) -> list[Verdict]:
        """Return what is asked of a row, judged or not."""
        if size != LARGEST:
            return []
        if policy in BARS:
            return [row.beside(*BARS[policy])]
        if policy == MODEL:
            fast, half = row.at_least("agent_steps_per_s", FAST_ENOUGH), row.at_least("times_network", 0.5)
            return [Verdict(f"{fast.bar} or {half.bar}", fast.ok or half.ok)]
        return []


def _metrics(speeds: list[float], step: float) -> dict[str, Measured]:
    """Return agent-steps per second and the simulated seconds of one of them."""
    return {"agent_steps_per_s": Measured.of(speeds), "step_s": Measured.of([step])}


class ActiveRollout:
    """An environment and the policy that moves its agents, in the middle of episodes."""

    def __init__(self, env: PedestrianEnv, policy: TensorDictModuleBase, quick: bool = False) -> None:
        """Run for about an episode, so that not all scenes are reset in the same step."""
        self.env, self.policy = env, policy
        self.now: TensorDictBase = env.reset()
        self.least = 1 if quick else round(TURN / env.decision_dt)
        for _ in range(2 if quick else round(WARM / env.decision_dt)):
            self.step()

    @torch.no_grad()
    def step(self) -> None:
        """Let every agent decide once and move."""
        _, self.now = self.env.step_and_maybe_reset(self.policy(self.now))


class Walk(ActiveRollout):
    """People who walk by a policy."""

    def __init__(self, scene: PreparedScenario | str, size: Size, policy: str, quick: bool = False) -> None:
        """Make the environment, and walk for about an episode."""
        self.policy_name, self.title = policy, f"env + {policy}"
        walker = load_policy(policy)
        super().__init__(make_env(scene, size.scenes, decision_dt=walker.decision_dt), walker, quick)

    @torch.no_grad()
    def ask(self) -> None:
        """Let every person decide once and nothing else."""
        self.policy(self.now)

    def scenes(self) -> Scenes:
        """Return what the environment is in the middle of, for ORCA of others."""
        state, bank = self.env.state, self.env.bank
        return for_peers(
            "loop",
            Size(*state.mask.shape),
            OrcaSettings(dt=self.env.decision_dt),
            WallSegments(bank),
            state.position,
            state.velocity,
            self.now["agents", "desired_velocity"],
            state.pref_speed * TOP_SPEED_RATIO,
        )
