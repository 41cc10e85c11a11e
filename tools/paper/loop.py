"""What controllers trained in the loop have to show, beside baselines and open-loop weights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pedzoo.core.paths import weight_files
from pedzoo.core.spec import parse
from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.eval.results import ResultTable, cell
from pedzoo.eval.suites.goals import DRAWN
from pedzoo.metrics.realism.crowds import TAIL
from pedzoo.models.zoo.card import read_config
from tools.paper.loop_forecasts import forecasts
from tools.paper.suites.loop_buildings import OFFICES
from tools.paper.suites.loop_noise import DRAWS
from tools.paper.targets import Target, verdict
from tools.paper.walked import Walked

ORCA = "orca:radius=0.3"
FORCE = "social_force:preset=indoor"
BASELINES = ("orca:radius=0.2", ORCA, "orca:radius=0.5", FORCE, "go_to_goal")
"""All see the walls."""

OPEN_LOOP = ("sgan_goal_map.controller_open", "sgan_goal.controller_open")
"""Weights that were trained to forecast alone, with which trainings in the loop begin."""

APART = (
    "sgan_goal_map.indoor:safety=false",
    f"{OPEN_LOOP[0]}:safety=true,extend_goal=true",
    "go_to_goal:safety=true",
)
"""What the training does without the safety layer, and the layer without the training, and all alone."""

_SEVERAL = (Target("clean", "at least", 0.95), Target("deadlock", "at most", 0.0))
_BUILDING = (
    Target("episode_success", "at least", 0.99),
    Target("contact_free", "at least", 0.95),
    Target("time_ratio", "at most", others=(ORCA,)),
)
_CROWD = (
    Target("success", "at least", 0.95),
    Target("contacts_per_min", "below", others=(ORCA, FORCE)),
)
_HUMAN = (
    Target("realism", "below", others=BASELINES, of="least"),
    *(Target(f"acceleration_{tail}_ratio", "at least", 0.85) for tail in TAIL),
    *(Target(f"acceleration_{tail}_ratio", "at most", 1.15) for tail in TAIL),
    Target("agent_contact_excess", "at most", 0.005),
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
}
"""By table; those on floor plans and folds, of which there may be any, are in `targets`."""


def targets(table: str) -> tuple[Target, ...]:
    """Return what the rows of a table have to show."""
    if table in TARGETS:
        return TARGETS[table]
    return {"loop_buildings": _BUILDING, "loop_replay": _HUMAN}[table.split()[0]]


class Loop(Walked):
    """Doors, buildings, noise and recorded crowds."""

    title = "Controllers in the loop: what they have to show"
    stem = "LOOP"
    suites = ("loop_doors", "loop_buildings", "loop_noise", "loop_replay")
    # three seeds of training each, the best one in validation first
    models = tuple(
        f"{name}.indoor{seed}" for name in ("sgan_goal_map", "sgan_goal") for seed in ("", "-seed1", "-seed2")
    )
    baselines = (*APART, *OPEN_LOOP, *BASELINES)

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        result = [
            "a target is met by the number itself, not by its interval; every row says what is missing",
            f"unseen floor plans: {', '.join(DRAWN)} (crowds: {', '.join(OFFICES)})"
            f"{self._given()}; training in the loop walks through apartment.100 to 111, office.100 and 101",
            *self._trained(),
            "doors of the tests are like those of training; width 1.1, offset -0.4 and seeds are their own",
            "free walking: the planner's way at the preferred speed; time ratios are of people who arrive",
            f"no slower than {ORCA}: by `time_ratio`, all times of those who arrive by those of free walking",
            f"noise: each scene is walked {DRAWS} times, everything but the noise the same; policies without"
            " noise would walk it alike and have no rows. Who walks through others varies, too: see `clean`",
            "cpu: seconds of one thread, all cases of the table",
        ]
        return result

    def _given(self) -> str:
        result = self.evaluation.options.maps
        return f", and those that were given: {', '.join(result)}" if result else ""

    def _trained(self) -> list[str]:
        """Return on which floor plans weights say that they were trained."""
        result = []
        for policy in self.policies:
            file = weight_files().get(parse(policy).name)
            plans = _plans(read_config(file)) if file else []
            if plans:
                result.append(f"{policy} was trained on {', '.join(plans)}")
        return result

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

    def _page(self, table: str, rows: Mapping[str, Mapping[str, Any]]) -> ResultTable:
        suite = next(iter(rows.values()))["case"]["suite"]
        shown = self.evaluation.shown[suite]
        known = [key for key in shown.columns if any(key in row["metrics"] for row in rows.values())]
        if not any(row["metrics"].get("failed") for row in rows.values()):
            known = [key for key in known if key != "failed"]
        wanted = targets(table)
        body = [
            [
                name,
                "" if name.startswith("real") else verdict(wanted, name, rows),
                str(row["n"]),
                *(cell(row, key) for key in known),
                f"{row['seconds']['cpu']:.0f}",
            ]
            for name, row in rows.items()
        ]
        physics = next(iter(rows.values()))["case"]["physics"]
        title = f"{_plain(table)} ({physics}): {'; '.join(target.text for target in wanted)}"
        return ResultTable(title, ["policy", "target", shown.counted, *known, "cpu"], body, 1)


def _overview(tables: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> ResultTable:
    """Return the targets as rows and the policies as columns: the numbers, and which are enough."""
    names = list(
        dict.fromkeys(name for rows in tables.values() for name in rows if not name.startswith("real"))
    )
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
    if isinstance(config, Mapping):
        return list(dict.fromkeys(plan for value in config.values() for plan in _plans(value)))
    if isinstance(config, list):
        return list(dict.fromkeys(plan for value in config for plan in _plans(value)))
    result = re.findall(r"map=(?:\[([^]]*)\]|([^,\s]+))", config) if isinstance(config, str) else []
    return [plan.strip() for several, one in result for plan in (several or one).split(",")]
