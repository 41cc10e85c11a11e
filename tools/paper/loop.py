"""What controllers trained in the loop have to show, beside baselines and open-loop weights."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from pedzoo.core.paths import weight_files
from pedzoo.core.spec import parse
from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.eval.results import ResultTable, cell
from pedzoo.eval.suites.scenes import DRAWN
from pedzoo.metrics.realism.crowds import TAIL
from pedzoo.models.zoo.card import read_config
from pedzoo.models.zoo.store import find
from tools.paper.base import Walked
from tools.paper.suites import DRAWS, OFFICES

Rows = Mapping[str, Mapping[str, Any]]
"""Rows of one table by policy."""

_SENSES: dict[str, Callable[[float, float], bool]] = {
    "at least": operator.ge,
    "above": operator.gt,
    "at most": operator.le,
    "below": operator.lt,
}


class Target(NamedTuple):
    """A bound of one metric: a number, or a multiple of what ``others`` have in the same table."""

    key: str
    sense: str  # which side of the bound is enough, one of `_SENSES`
    bound: float = 1.0
    others: tuple[str, ...] = ()
    of: str = "mean"  # of the others, or the ``least`` of them

    @property
    def text(self) -> str:
        """The target in words."""
        if not self.others:
            return f"{self.key} {self.sense} {self.bound:g}"
        what = f"the {self.of} of " if len(self.others) > 1 else ""
        times = f"{self.bound:g} x " if self.bound != 1 else ""
        return f"{self.key} {self.sense} {times}{what}{', '.join(self.others)}"

    def limit(self, rows: Rows) -> float | None:
        """Return the bound as a number, None where it is not known."""
        if not self.others:
            return self.bound
        values = [rows[name]["metrics"].get(self.key) if name in rows else None for name in self.others]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return self.bound * (min(known) if self.of == "least" else sum(known) / len(known))

    def met(self, name: str, rows: Rows) -> bool | None:
        """Return whether a policy meets it; None where its bound or its number is not known."""
        limit, value = self.limit(rows), rows[name]["metrics"].get(self.key)
        return None if limit is None or value is None else _SENSES[self.sense](value, limit)


def verdict(targets: Sequence[Target], name: str, rows: Rows) -> str:
    """Return ``met``, or the metrics whose targets the row ``name`` does not meet, with their bounds."""
    missing, unknown = [], []
    for target in targets:
        limit, value = target.limit(rows), rows[name]["metrics"].get(target.key)
        if limit is None:
            unknown.append(target.key)
        elif not target.met(name, rows):
            result = "-" if value is None else f"{value:.3f}"
            missing.append(f"{target.key} {result}, not {target.sense} {limit:.3f}")
    if missing:
        return "\n".join(missing)
    return f"nothing to compare {', '.join(unknown)} with" if unknown else "met"


ORCA = "orca:radius=0.3"
FORCE = "social_force:preset=indoor"
BASELINES = ("orca:radius=0.2", ORCA, "orca:radius=0.5", FORCE, "go_to_goal")
"""All see the walls."""

OPEN_LOOP = ("approach_net_goal_map.controller_open", "approach_net_goal.controller_open")
"""Weights that were trained to forecast alone, with which trainings in the loop begin."""

APART = (
    "approach_net_goal_map.indoor:safety=false",
    f"{OPEN_LOOP[0]}:safety=true",
    "go_to_goal:safety=true",
)
"""What the training does without the safety layer, and the layer without the training, and all alone."""

_SEVERAL = (Target("clean", "at least", 0.95), Target("deadlock", "at most", 0.0))
_CROWD = (
    Target("success", "at least", 0.95),
    Target("contacts_per_min", "below", others=(ORCA, FORCE)),
)

TARGETS: dict[str, tuple[Target, ...]] = {
    "loop_doors varied": (Target("clean", "at least", 0.995), Target("time_ratio_median", "at most", 1.1)),
    "loop_doors hard": (Target("clean", "at least", 0.99),),
    "loop_doors mirror": (
        Target("clean", "at least", 0.98),
        Target("symmetry_m", "above", 0.3),
        Target("yield_delay_s", "above", 0.5),
    ),
    "loop_doors 2 against 2": _SEVERAL,
    "loop_doors 3 against 1": _SEVERAL,
    "loop_doors queue of 6": _SEVERAL,
    "loop_doors standing": (Target("clean", "at least", 0.95),),
    "loop_doors flow of 20": (
        Target("specific_flow_per_m_s", "at least", 1.5),
        Target("specific_flow_per_m_s", "at most", 2.5),
    ),
    "loop_buildings crowd of 20": _CROWD,
    "loop_buildings crowd of 50": _CROWD,
    "loop_noise who goes first": (Target("varied", "at least", 0.3),),
    "loop_noise passing side": (Target("varied", "at least", 0.3),),
    "loop_buildings": (
        Target("episode_success", "at least", 0.99),
        Target("contact_free", "at least", 0.95),
        Target("time_ratio", "at most", others=(ORCA,)),
    ),
    "loop_replay": (
        Target("realism", "below", others=BASELINES, of="least"),
        *(Target(f"acceleration_{tail}_ratio", "at least", 0.85) for tail in TAIL),
        *(Target(f"acceleration_{tail}_ratio", "at most", 1.15) for tail in TAIL),
        Target("agent_contact_excess", "at most", 0.005),
    ),
}
"""By table; the last two are those of the suites' tables on any floor plan or fold."""


def targets(table: str) -> tuple[Target, ...]:
    """Return what the rows of a table have to show."""
    return TARGETS.get(table) or TARGETS[table.split()[0]]


class Loop(Walked):
    """Doors, buildings, noise and recorded crowds."""

    title = "Controllers in the loop: what they have to show"
    stem = "LOOP"
    suites = ("loop_doors", "loop_buildings", "loop_noise", "loop_replay")
    models = ("approach_net_goal_map.indoor", "approach_net_goal.indoor")
    baselines = (*APART, *OPEN_LOOP, *BASELINES)

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        maps = self.evaluation.options.maps
        given = f", and those that were given: {', '.join(maps)}" if maps else ""
        trained = {}
        for policy in self.policies:
            file = weight_files().get(parse(policy).name)
            trained[policy] = _plans(read_config(file)) if file else []
        return [
            "a target is met by the number itself, not by its interval; every row says what is missing",
            f"unseen floor plans: {', '.join(DRAWN)} (crowds: {', '.join(OFFICES)})"
            f"{given}; training in the loop walks through apartment.100 to 111, office.100 and 101",
            *(f"{policy} was trained on {', '.join(plans)}" for policy, plans in trained.items() if plans),
            "doors of the tests are like those of training; width 1.1, offset -0.4 and seeds are their own",
            "free walking: the planner's way at the preferred speed; time ratios are of people who arrive",
            f"no slower than {ORCA}: by `time_ratio`, all times of those who arrive by those of free walking",
            f"noise: each scene is walked {DRAWS} times, everything but the noise the same; policies without"
            " noise would walk it alike and have no rows. Who walks through others varies, too: see `clean`",
            "cpu: seconds of one thread, all cases of the table",
        ]

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return which targets are met, and every table with what is missing in each row."""
        tables: dict[str, dict[str, dict[str, Any]]] = {}
        for row in report["summary"]:
            tables.setdefault(row["table"], {})[row["name"]] = row
        if not tables:
            return []
        forecast = forecasts(
            [*self.policies, *(f"{name}_{fold}" for name in self.policies for fold in SCENES)]
        )
        walked = [self._page(table, rows) for table, rows in tables.items()]
        return [_overview(tables), *walked, *([forecast] if forecast else [])]

    def _page(self, table: str, rows: Rows) -> ResultTable:
        case = next(iter(rows.values()))["case"]
        shown = self.evaluation.shown[case["suite"]]
        known = [key for key in shown.columns if any(key in row["metrics"] for row in rows.values())]
        if not any(row["metrics"].get("failed") for row in rows.values()):
            known = [key for key in known if key != "failed"]
        wanted, body = targets(table), []
        for name, row in rows.items():
            said = "" if name.startswith("real") else verdict(wanted, name, rows)
            numbers = [cell(row, key) for key in known]
            body.append([name, said, str(row["n"]), *numbers, f"{row['seconds']['cpu']:.0f}"])
        title = f"{_plain(table)} ({case['physics']}): {'; '.join(target.text for target in wanted)}"
        return ResultTable(title, ["policy", "target", shown.counted, *known, "cpu"], body, 1)


def _overview(tables: Mapping[str, Rows]) -> ResultTable:
    """Return the targets as rows and the policies as columns: the numbers, and which are enough."""
    names = dict.fromkeys(name for rows in tables.values() for name in rows if not name.startswith("real"))
    body = []
    for table, rows in tables.items():
        for target in targets(table):
            line = [_plain(table), target.text]
            for name in names:
                value = rows[name]["metrics"].get(target.key) if name in rows else None
                mark = " met" if value is not None and target.met(name, rows) else ""
                line.append("-" if value is None else f"{value:.3f}{mark}")
            body.append(line)
    return ResultTable("Targets", ["case", "target", *names], body, 2)


def _plain(table: str) -> str:
    """Return what people call a table."""
    suite, _, case = table.partition(" ")
    return f"{suite.removeprefix('loop_')}: {case}"


def _plans(config: Any) -> list[str]:
    """Return the floor plans of all scenarios in a training's settings."""
    if isinstance(config, Mapping | list):
        values = config.values() if isinstance(config, Mapping) else config
        return list(dict.fromkeys(plan for value in values for plan in _plans(value)))
    result = re.findall(r"map=(?:\[([^]]*)\]|([^,\s]+))", config) if isinstance(config, str) else []
    return [plan.strip() for several, one in result for plan in (several or one).split(",")]


MOST = 1.15
"""How much larger ADE may become by training in the loop."""


def forecasts(policies: Iterable[str]) -> ResultTable | None:
    """Return ADE of the most likely forecast on cards beside that of the weights before, None of none.

    Policies that are no weights of the zoo, or began with none, are left out.
    """
    body = []
    for name in dict.fromkeys(parse(policy).name for policy in policies):
        entry = find(name)
        begun = (entry.card.training["overrides"] or {}).get("weights") if entry else None
        before = find(begun) if isinstance(begun, str) else None
        if entry is None or before is None:
            continue
        theirs = [(report["protocol"], ade) for report, ade in _errors(before.card.evaluations)]
        for report, ade in _errors(entry.card.evaluations):
            other = next((value for protocol, value in theirs if protocol == report["protocol"]), None)
            if other is None:
                continue
            ratio = ade / other
            met = "met" if ratio <= MOST else f"{ratio:.3f}, not at most {MOST}"
            where = f"{report['protocol']['fold']} {report['protocol']['split']}"
            body.append([name, where, met, f"{ade:.4f}", before.card.name, f"{other:.4f}", f"{ratio:.3f}"])
    title = f"forecasts: ade_m at most {MOST} x that of the weights before (cards, goal of the window's end)"
    head = ["weights", "windows", "target", "ade_m", "before", "ade_m", "ratio"]
    return ResultTable(title, head, body, 2) if body else None


def _errors(evaluations: Iterable[dict[str, Any]]) -> list[tuple[dict[str, Any], float]]:
    """Return the reports of forecasts on a card with their ADE."""
    reports = [one for one in evaluations if one["command"] == "forecast"]
    values = [one["rows"][0]["metrics"].get("ade_m") for one in reports]
    return [(one, value) for one, value in zip(reports, values, strict=True) if value is not None]
