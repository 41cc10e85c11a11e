"""The interface of suites: cases on which policies are evaluated, and the units of that work."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

from pedzoo.core.spec import Spec
from pedzoo.eval.comparison import row
from pedzoo.eval.packed_episodes import packed_episodes
from pedzoo.eval.rollout import ShareDone, walked
from pedzoo.maps.bank import MapBank
from pedzoo.metrics.ratios import Ratio
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import CLEARANCE, make_scenario, prepare_scenario
from pedzoo.sim.rollout import Rollout, joined
from pedzoo.sim.scenario import PreparedScenario

QUICK = 10
"""A quick run has one in so many episodes."""

_kept: dict[tuple[str, str, float, str], PreparedScenario] = {}


class OwnRecordings(NamedTuple):
    """Recordings of one's own, which the suite ``replay`` walks instead of folds.

    Attributes:
        files: In any form that `pedzoo.data.tracks` reads.
        dt: Seconds between consecutive frame numbers; None where the files say it.
        map: Their floor plan; None for no walls.
        homography: Text file of a 3x3 matrix from the files' positions to world metres.
    """

    files: tuple[str, ...]
    dt: float | None = None
    map: str | None = None
    homography: str | None = None


class EvaluationOptions(NamedTuple):
    """Options of an evaluation by which suites differ.

    Attributes:
        episodes: Per case and seed; None for the suites' own numbers. Not of recordings: see ``rollouts``.
        quick: A tenth of the episodes, and of the time of recordings.
        physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class`` for all suites; None for their own.
        maps: Floor plans on which ``goals`` is walked too: every episode of five more cases draws one.
        root: Folder with recordings; None for the variable ``PEDZOO_DATA``.
        rollouts: Of a policy with noise, on recordings; None for 3, or 1 if quick.
        device: Where scenes and policies are, such as ``cuda``.
        metrics: More columns of all tables: names of metrics, or ``path/to/file.py:f``.
        folds: Of recordings that ``replay`` walks, as ``zara1`` or ``file.py:Class:fold``; none for all that
            are found.
        people: Policies of the people beside robots, with settings, and ``replay``, with settings of the
            scenario, for recorded people who do not react.
        robot: The body of robots, ``diff_drive:radius=0.35``.
        own: Recordings of one's own, which ``replay`` walks instead of folds.
        keep_episodes: So many episodes of every row keep their positions, for ``pedzoo report``.
        clearance: Metres that planned ways keep from walls; None for the suites' own. Not of robots.
        planner: ``shortest`` or ``astar``, see `pedzoo.make_env`; None for the suites' own. Not of robots.
        deadline: Seconds that people have for every goal; by default four times as many as their way takes
            freely, at least 20. Not of robots and recordings.
    """

    episodes: int | None = None
    quick: bool = False
    physics: str | None = None
    maps: tuple[str, ...] = ()
    root: str | None = None
    rollouts: int | None = None
    device: str = "cpu"
    metrics: tuple[str, ...] = ()
    folds: tuple[str, ...] = ()
    people: tuple[str, ...] = ()
    robot: str | None = None
    own: OwnRecordings | None = None
    keep_episodes: int = 0
    clearance: float | None = None
    planner: str | None = None
    deadline: float | None = None

    def number(self, usual: int) -> int:
        """Return how many episodes a case has whose suite has ``usual`` ones."""
        return self.episodes or (max(1, usual // QUICK) if self.quick else usual)


class EvaluationCase(NamedTuple):
    """Scenes that policies are compared on; what the options have, too, is as there.

    Attributes:
        suite: Its name.
        name: What tables call it.
        scenario: With settings: a text, or a name and values where one of them is given by a user.
        episodes: Of every seed.
        case: What tells its rows from others.
        inputs: Digest of the files that it reads.
        effort: What an episode costs beside those of other cases: people times goals, about.
        table: Which table its rows stand in, with those of which a mean says something; empty: the suite's.
        shares: Names what takes time to prepare and serves several cases, such as the ways on a floor plan.
        people: Policy of people beside a robot; empty where there is none, or people are played back.
        robot: The robot's body; empty where there is none.
        warm_start: As of `pedzoo.make_env`; usually the suite's.
    """

    suite: str
    name: str
    scenario: str | Spec
    physics: str
    episodes: int
    case: dict[str, str]
    inputs: str = ""
    effort: float = 2.0
    table: str = ""
    shares: str = ""
    people: str = ""
    robot: str = ""
    clearance: float = CLEARANCE
    planner: str = "shortest"
    deadline: float | None = None
    warm_start: str = "orca"


class WorkUnit(NamedTuple):
    """One policy on one case: the smallest part that is repeated, stored and sent to workers.

    ``policy`` is its name as it was given. ``walks`` is the same, but for models with other weights for this
    case. ``deterministic`` is without noise; the rest is as of `EvaluationOptions`.
    """

    policy: str
    walks: str
    case: EvaluationCase
    seeds: tuple[int, ...]
    deterministic: bool
    device: str = "cpu"
    metrics: tuple[str, ...] = ()
    keep_episodes: int = 0

    @property
    def group(self) -> tuple[str, str]:
        """What the unit shares with others: one process should do them all."""
        return self.case.suite, self.case.shares or self.case.name

    @property
    def label(self) -> str:
        """The unit in words, for progress messages."""
        case = self.case
        return f"{case.suite}{f' {case.name}' if case.name != case.suite else ''}: {self.policy}"


class Suite(ABC):
    """Says on which cases policies are evaluated.

    Attributes:
        name: As it was asked for.
        accepted_options: Fields of `EvaluationOptions` that it takes beside those of all suites.
        warm_start: What people do in the steps before the policy takes over.
        counted: What ``n`` of its rows are.
        headline: Metrics of the first table.
        columns: Metrics of the suite's own table.
        legend: What metrics are that `pedzoo.eval.results.legend` does not know, or knows otherwise.
    """

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes", "maps", "rollouts", "folds")
    warm_start: ClassVar[str] = "orca"
    counted: ClassVar[str] = "episodes"
    headline: ClassVar[tuple[str, ...]] = ("success", "agent_contacts_per_min")
    columns: ClassVar[tuple[str, ...]] = (
        *("success", "episode_success", "deadlock", "failed"),
        *("agent_contacts_per_min", "wall_contacts_per_min", "time_ratio", "path_ratio", "least_distance_m"),
        *("intervention_share", "intervention_m"),
    )
    legend: ClassVar[Mapping[str, str]] = {}

    def __init__(self, name: str) -> None:
        """Take the name that it was asked for by."""
        self.name = name

    @abstractmethod
    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return the cases; those that share a floor plan follow each other.

        Raises:
            UserError: Something asked for cannot be.
        """

    def case(
        self,
        options: EvaluationOptions,
        name: str,
        scenario: str | Spec,
        episodes: int,
        case: dict[str, str],
        physics: str = "compiled",
        **more: Any,
    ) -> EvaluationCase:
        """Return a case of this suite with the physics and number of episodes of ``options``, else these."""
        physics, episodes = options.physics or physics, options.number(episodes)
        more = {"warm_start": self.warm_start} | more
        return EvaluationCase(self.name, name, scenario, physics, episodes, case, **more)

    def check(self, policy: str) -> None:
        """Check the name of a policy before anything walks; errors as of `evaluate`."""
        load_policy(policy)

    def notes(self, options: EvaluationOptions, policies: Sequence[str]) -> list[str]:
        """Return notes on the cases, and on ``policies`` in them."""
        return []

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return the metrics that rows of this suite have beside those of every rollout."""
        return {}

    def units(
        self, case: EvaluationCase, policies: Sequence[str], seeds: tuple[int, ...], deterministic: bool
    ) -> list[WorkUnit]:
        """Return the work on a case: ``policies`` with settings on scenes of ``seeds``."""
        return [WorkUnit(policy, policy, case, seeds, deterministic) for policy in policies]

    def rows(self, unit: WorkUnit, tell: ShareDone | None = None) -> list[dict[str, Any]]:
        """Walk one unit and return its rows, as `pedzoo.eval.comparison.row` makes them.

        Episodes of all seeds count as one sample; ``per_agent`` says which seed each was of.
        """
        case = unit.case
        scenario = prepared(case.scenario, case.inputs, case.clearance, case.planner)
        parts = list(walk_unit(unit, scenario, unit.seeds, case.episodes, tell))
        rollout = joined(parts)
        result = row(unit.policy, rollout, self.more(rollout), unit.metrics)
        with_seeds(result, unit.seeds, case.episodes)
        return [result | kept_episodes(unit, parts[0], scenario.bank)]


def with_seeds(row: dict[str, Any], seeds: Sequence[int], episodes: int) -> None:
    """Say of which seed's episodes each entry of ``per_agent`` is; every seed has so many ``episodes``."""
    for one in row["per_agent"]:
        seed, one["episode"] = divmod(one["episode"], episodes)
        one["seed"] = seeds[seed]


def prepared(
    name: str | Spec, inputs: str = "", clearance: float = CLEARANCE, planner: str = "shortest"
) -> PreparedScenario:
    """Return the prepared scenario of a name with settings; errors as of `pedzoo.make_env`.

    One that was made before is returned again, unless ``inputs``, the digest of the files that it reads, has
    changed. A new one takes the ways of another one on the same floor plans.
    """
    key = repr(name), inputs, clearance, planner
    if (result := _kept.pop(key, None)) is None:
        made = make_scenario(name)
        alike = (kept for (*_, room, kind), kept in _kept.items() if (room, kind) == (clearance, planner))
        adapted = next(filter(None, map(made.adapted, alike)), None)
        result = adapted or prepare_scenario(made, clearance, planner)
    _kept[key] = result  # the latest is the last
    if len(_kept) > 6:  # more than the cases that share a floor plan
        del _kept[next(iter(_kept))]
    return result


def walk_unit(
    unit: WorkUnit, scenario: PreparedScenario, seeds: Sequence[int], episodes: int, tell: ShareDone | None
) -> Iterator[Rollout]:
    """Yield the ``episodes`` of every seed in parts: large crowds do not fit into memory at once."""
    case, still = unit.case, unit.deterministic
    where = {"device": unit.device, "deadline": case.deadline}
    where |= {"clearance": case.clearance, "planner": case.planner, "warm_start": case.warm_start}
    for number, seed in enumerate(seeds):

        def progress(name: str, done: int, total: int, number: int = number) -> None:
            if tell:
                tell((number + done / total) / len(seeds))

        yield from walked(unit.walks, scenario, case.physics, episodes, seed, still, progress, **where)


def kept_episodes(unit: WorkUnit, rollout: Rollout, bank: MapBank) -> dict[str, Any]:
    """Return the positions of a row's first episodes, of its first seed; nothing where none are kept."""
    if not unit.keep_episodes:
        return {}
    episodes, plans = packed_episodes(rollout, bank, unit.keep_episodes, unit.seeds[0])
    return {"episodes": episodes, "plans": plans}
