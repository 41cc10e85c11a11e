"""The closed-loop table: policies walk through the same scenes, one row each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.machine import usual_physics
from pedzoo.eval.packed_episodes import packed_episodes
from pedzoo.eval.rollout import Progress, prepare, walk
from pedzoo.metrics.arrival import arrived_in_time, finish_seconds
from pedzoo.metrics.closed_loop import closed_loop, named, own_metrics, time_ratio_median
from pedzoo.metrics.contacts import contact_events, least_distance
from pedzoo.metrics.ratios import Ratio, summarised
from pedzoo.policies.policy import Policy
from pedzoo.policies.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import CLEARANCE, make_scenario
from pedzoo.sim.rollout import Rollout, joined
from pedzoo.sim.scenario import PreparedScenario, Scenario


class PolicyRollout(NamedTuple):
    """What one policy did, by its name as it was given, and the environment where it walked."""

    name: str
    rollout: Rollout
    env: PedestrianEnv


class Comparison:
    """Policies on the same scenes of one seed.

    Attributes:
        walked: Those that have walked, in the given order. After an interruption the last of them may have
            fewer episodes than the others.
        refusal: Of `report`: what is wrong with the first metric of one's own that failed, or None.
    """

    def __init__(
        self,
        policies: Sequence[str],
        scenario: str,
        physics: str | None = None,
        episodes: int = 20,
        seed: int = 0,
        deterministic: bool = False,
        metrics: Sequence[str] = (),
        keep_episodes: int = 0,
        **settings: Any,
    ) -> None:
        """Build all policies and their environments, so that a misspelt one is found before any has walked.

        Arguments and errors beside these are those of `pedzoo.eval.rollout.rollout`.

        Args:
            policies: Names with settings.
            scenario: Its name with settings.
            physics: By default bullet, or compiled where there is no pybullet.
            episodes: Scenes per policy.
            seed: Of the scenes, the same for all policies.
            deterministic: Models walk with noise zero.
            metrics: Metrics of your own, as ``path/to/file.py:f``, beside the shipped ones.
            keep_episodes: So many episodes keep their positions in the report, for ``pedzoo report``.
            settings: Of `pedzoo.make_env`: ``warm_start``, ``clearance``, ``planner``, ``device``,
                ``deadline``; None for its own. A ``decision_dt`` that is not the policies' own is refused.
        """
        named(metrics)
        if keep_episodes < 0:
            raise UserError(f"keep_episodes {keep_episodes}: expected 0 or more")
        self.refusal: UserError | None = None
        self.walked: list[PolicyRollout] = []
        self._metrics, self._kept, self._seed = metrics, keep_episodes, seed
        usual = {"warm_start": "orca", "clearance": CLEARANCE, "planner": "shortest", "device": "cpu"}
        settings = usual | {key: value for key, value in settings.items() if value is not None}
        self._prepared: dict[str, tuple[Policy | Walker, PedestrianEnv]] = {}
        made: Scenario | PreparedScenario = make_scenario(scenario)
        physics, recorded = physics or usual_physics(), {}
        for name in dict.fromkeys(policies):
            policy, env = prepare(name, made, physics, episodes, seed, **settings)
            self._prepared[name], made = (policy, env), env.prepared  # planned once
            if env.prepared.script is not None or env.prepared.scenario.begun:
                recorded = {"warm_start": "recorded"}
        self._walking = episodes, deterministic
        where = {"scenario": scenario, "physics": physics, "episodes": episodes}
        self._protocol = where | {"noise": "none" if deterministic else "sampled"} | settings | recorded

    def __enter__(self) -> Comparison:
        return self

    def __exit__(self, *error: object) -> None:
        for _, env in self._prepared.values():
            env.physics.close()

    def run(self, progress: Progress | None = None) -> None:
        """Let all policies walk. Finished episodes survive an interruption."""
        for name, (policy, env) in self._prepared.items():
            parts: list[Rollout] = []
            try:
                for part in walk(policy, env, *self._walking, progress):
                    parts.append(part)
            finally:
                if parts:
                    self.walked.append(PolicyRollout(name, joined(parts), env))

    def report(self) -> dict[str, Any]:
        """Return protocol, seeds and rows of all that has walked.

        A metric of one's own that fails is left out, so that no walk is lost, and `refusal` is raised later.
        """
        rows, plans = [], {}
        for one in self.walked:
            own: dict[str, Ratio] = {}
            for metric in self._metrics:
                try:
                    own |= own_metrics(one.rollout, [metric])
                except UserError as error:
                    self.refusal = self.refusal or error
            rows.append(row(one.name, one.rollout, own))
            if self._kept:
                rows[-1]["episodes"], its = packed_episodes(one.rollout, one.env.bank, self._kept, self._seed)
                plans |= its
        report = {"protocol": self._protocol, "seeds": [self._seed], "rows": rows}
        return report | ({"plans": plans} if self._kept else {})


def row(
    name: str, rollout: Rollout, more: Mapping[str, Ratio] | None = None, metrics: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the metrics of a policy with their 95 % intervals, and what each person did.

    ``n`` are episodes, intervals are over episodes. Metrics are those of `pedzoo.metrics.closed_loop`,
    ``time_ratio_median``, ``more`` of the same episodes, and ``metrics`` as ``path/to/file.py:f``. In a
    replay slots are not people: see `pedzoo.eval.realism`.
    """
    values, intervals = summarised({**closed_loop(rollout, metrics), **(more or {})})
    if not rollout.replayed:
        middle, ends = time_ratio_median(rollout)
        values, intervals = values | middle, intervals | ends
    return {
        "name": name,
        "case": {},
        "decision_dt_s": rollout.decision_dt,
        "n": len(rollout.failed),
        "metrics": values,
        "ci95": intervals,
        "per_agent": [] if rollout.replayed else _per_agent(rollout),
    }


def _per_agent(walked: Rollout) -> list[dict[str, Any]]:
    """Return what each person did, people of one episode after the other."""
    arrived, seconds = arrived_in_time(walked), finish_seconds(walked.reached, walked.goals)
    both = walked.agent_contact, walked.wall_contact
    agents, walls = (contact_events(contact & walked.scored) for contact in both)
    least, known = least_distance(walked), walked.mask.nonzero().tolist()
    return [
        {
            "episode": at[0],
            "agent": at[1],
            "pref_speed_m_per_s": round(walked.pref_speed[at].item(), 4),
            "success": arrived[at].item(),
            "goals": walked.reached[(*at, -1)].item(),
            "time_s": round(seconds[at].item(), 1) if seconds[at].isfinite() else None,
            "agent_contacts": agents[at].item(),
            "wall_contacts": walls[at].item(),
            "least_distance_m": round(least[at].item(), 4) if least[at].isfinite() else None,
        }
        for at in map(tuple, known)
    ]
