"""Write the generated tables of README.md and docs/: python -m tools.pages.tables [--check|--measure].

They come from the cards in checkpoints/ and from checkpoints/results/. ``--check`` only says which pages are
out of date; ``--measure`` first measures the column ms again, into checkpoints/results/STEP_MS.json.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from pedzoo.core.paths import CARD
from pedzoo.eval.trained_on import for_fold
from pedzoo.maps.grid import spread_points
from pedzoo.maps.plans import load_plan
from pedzoo.models.zoo.card import ModelCard, read_card
from pedzoo.models.zoo.store import ROBOTS, names
from tools.pages import results_tables

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "checkpoints" / "results"
STEP_MS = RESULTS / "STEP_MS.json"

CHOICE = {
    "sgan_goal_map.indoor": "people walk around your robot: the default",
    "social_walker.indoor": "people walk in groups that you name, and brake nearly as recorded ones do",
    "social_walker.styled": "people are hardest to tell from recorded ones",
    "sgan_goal_map.zara1": "you forecast with goals and floor plans, as the iGibson paper; not for walking",
    "sgan.zara1": "you forecast without goals: Social GAN; not for walking",
    "robot_ppo.mix": "you want a robot with a lidar to compare with",
}
"""The README's models, and when one takes them."""

LEARNED = ("sgan_goal_map.indoor", "social_walker.styled")
RULES = ("go_to_goal:safety=true", "orca:radius=0.2", "orca:radius=0.3", "social_force:preset=indoor")
"""Rows of the README's results; the first one is compared with all rules."""

COLUMNS = {
    "doors: all arrive, no touch": ("doors: varied", "clean"),
    "buildings: no touch": ("buildings: drawn", "contact_free"),
    "buildings: all arrive": ("buildings: drawn", "episode_success"),
}
"""Columns of the README's results by case and metric of LOOP.md; realism is the last."""

CHANCE = 0.03
"""Differences up to this are within chance."""

LESS = {
    "time in buildings, in times of free walking": ("buildings: drawn", "time_ratio"),
    "time in the scanned `aws_small_house`": ("buildings: aws_small_house", "time_ratio"),
    "time at doors": ("doors: varied", "time_ratio_median"),
    **{f"realism on {fold}": (f"replay: {fold}", "realism") for fold in results_tables.SCENES},
}
"""Numbers by which a rule may be better: less is."""

FLOOR, PEOPLE, STEPS, WARM, REPEATS = "office.0", 10, 20, 3, 4
"""Of the measured scene: floor plan, people, decisions, the first ones that do not count, and walks."""


def models() -> str:
    """Return the README's table of models."""
    speed = json.loads(STEP_MS.read_text())["ms"]
    cells = targets()
    rows = []
    for name, when in CHOICE.items():
        card = read_card(ROOT / "checkpoints" / name / CARD)
        robot = name.startswith(ROBOTS)
        values = in_results(name) or walked(card, "robots" if robot else "goals drawn")
        keys = ("agent_contacts_per_min", "wall_contacts_per_min")
        touches = sum(values[key] for key in keys) if keys[0] in values else None
        rows.append(
            [
                f"`{name}`",
                when,
                number(values.get("success")) + " (of robots)" * robot,
                number(touches),
                number(realism(name, cells)),
                number(speed.get(name), 0),
                "MIT, simulated people" if "simulated" in card.data["terms"] else "research",
            ]
        )
    head = ["name", "take it when", "success", "touches", "realism", "ms", "terms"]
    return table(head, rows) + (
        "\n- success: share of people who reach their goals in randomly generated apartments and offices, "
        "in 100 episodes. The robot is among the people and rooms of its training; "
        "elsewhere it gets less far ([ROBOTS](checkpoints/results/ROBOTS.md)).\n"
        "- touches: of other people and walls there, per person and minute. "
        "A person is a disc of radius 0.15 m. No robot is there; "
        "[how people treat robots](docs/simulate.md#people-around-a-robot) was tested, too.\n"
        "- realism: the distance of walks from those of recorded crowds; less is better. "
        "Each crowd is compared with weights that never saw it.\n"
        "  Two random halves of a real crowd differ by 0.12: better is hardly possible.\n"
        f"- ms: time of one decision for {PEOPLE} people on one CPU thread. "
        "People decide every 0.4 s, and keep their course between.\n"
        "- terms: *research* is research use only, because of the recordings. "
        "`zara1` is the crowd that training left out.\n"
        "- -: not measured, or it makes no sense for this model.\n"
    )


def results() -> str:
    """Return the README's table of results, and where a rule is better."""
    cells = targets()
    rows = []
    for name in (*LEARNED, *RULES):
        values = [number(cells[name].get(key)) for key in COLUMNS.values()]
        rows.append([f"`{name}`", *values, number(realism(name, cells))])
    text = table(["policy", *COLUMNS, "realism"], rows)
    better = []
    for what, key in LESS.items():
        best = min(RULES, key=lambda rule: cells[rule].get(key, np.inf))
        ours, theirs = cells[LEARNED[0]].get(key), cells[best].get(key)
        if ours is not None and theirs is not None and theirs < ours - CHANCE:
            better.append(f"{what} (`{best}` {theirs:.2f}, ours {ours:.2f})")
    quick, slow = (cells[name]["buildings: drawn", "time_ratio"] for name in LEARNED)
    lines = "".join(f"- {line}.\n" for line in better) or "- nothing of this table and its pages\n"
    return (
        f"{text}\n- The first two policies are learned, the others are rules. "
        f"The second needs {slow:.2f} times the time of free walking in buildings, the first {quick:.2f}.\n"
        "- All columns but realism are shares of episodes. Doors are 0.7 to 1.2 m wide; "
        "with `--scenario door` they are 0.85 m, and harder. "
        "Buildings are randomly generated, and in no training set.\n"
        f"- realism: as above. Differences of {CHANCE} are within chance.\n"
        "- `safety=true` is the safety layer that our weights use, too. "
        "Most of the freedom from contacts is its work. ORCA and social force walk without it.\n"
        "- Why a learned model: it is as free of contacts as the layer alone, and walks more like people.\n\n"
        f"**A rule-based policy measures better** than ours, `{LEARNED[0]}`, by more than {CHANCE} in:\n\n"
        f"{lines}"
        "\nAll of these numbers, and more: [results](docs/results.md#controllers-in-the-loop).\n"
    )


def zoo() -> str:
    """Return the table of all models of the zoo."""
    rows = []
    for name in shipped():
        card = read_card(ROOT / "checkpoints" / name / CARD)
        training, walking = card.training, walked(card, "goals drawn")
        robot = name.startswith(ROBOTS)
        rows.append(
            [
                f"`{name}`",
                text_of(training.get("seed")),
                "-" if robot else ("yes" if sees_plan(card) else "no"),
                "-" if robot or training["fold"] == "eth_ucy" else training["fold"],
                "-" if robot else f"{training['goal']}, {training['clock']}",
                number(forecast(card), 3),
                number(walked(card, "robots" if robot else "door").get("success")),
                number(walking.get("success")),
            ]
        )
    head = ["name", "seed", "sees map", "held-out scene", "goal, time base", "ADE, m", "door", "buildings"]
    return table(head, rows)


def shipped() -> list[str]:
    """Return the names of all models in checkpoints/."""
    return [name for name in names() if (ROOT / "checkpoints" / name / CARD).is_file()]


def sees_plan(card: ModelCard) -> bool:
    """Return whether the network reads the floor plan."""
    init = card.config.get("init", {})
    return bool(init.get("map") or init.get("walls")) or card.architecture == "social_vrnn"


def forecast(card: ModelCard) -> float | None:
    """Return ADE on the card's own fold."""
    rows = (row for report in card.evaluations if report["command"] == "forecast" for row in report["rows"])
    return next((row["metrics"].get("ade_m") for row in rows), None)


def walked(card: ModelCard, case: str) -> dict[str, float]:
    """Return the metrics of a card's table, by the beginning of its name; empty where there is none."""
    for report in card.evaluations:
        for row in report["rows"]:
            if str(row.get("table", "")).startswith(case):
                return row["metrics"]
    return {}


def in_results(name: str) -> dict[str, float]:
    """Return the metrics of a policy in drawn buildings of RESULTS.md; empty where it is not there."""
    page = (RESULTS / "RESULTS.md").read_text().partition("\n## goals drawn: mean")[2]
    head, *rows = results_tables.cells_of(page.partition("\n\n")[2].partition("\n\n")[0])
    row = next((row for row in rows if row[0] == name), [])
    cells = {key: cell.split()[0] for key, cell in zip(head[1:], row[1:], strict=False)}
    return {key: float(cell) for key, cell in cells.items() if cell != "-"}


def targets() -> dict[str, dict[tuple[str, str], float]]:
    """Return the numbers of the first table of LOOP.md, by policy, case and metric."""
    page = (RESULTS / "LOOP.md").read_text().partition("## Targets\n")[2].partition("\n## ")[0]
    head, *rows = results_tables.cells_of(page)
    result: dict[str, dict[tuple[str, str], float]] = {}
    for column, name in enumerate(head[2:], 2):
        values = ((row[0], row[1].split()[0], row[column].split()[0]) for row in rows)
        result[name] = {(case, key): float(value) for case, key, value in values if value != "-"}
    return result


def realism(name: str, cells: dict[str, dict[tuple[str, str], float]]) -> float | None:
    """Return the mean over the held-out recordings: of LOOP.md, else of SCORES.json or RESULTS.md."""
    here = [value for (_, metric), value in cells.get(name, {}).items() if metric == "realism"]
    here = here or scored(name)
    if here:
        return sum(here) / len(here)
    head, *rows = results_tables.cells_of(results_tables.walked())
    column = head.index("replay all realism")
    return next((float(row[column]) for row in rows if row[0] == name), None)


def scored(name: str) -> list[float]:
    """Return the realism on each recording of SCORES.json, of the weights that did not see it."""
    reports = json.loads((RESULTS / "SCORES.json").read_text())
    names = {fold: for_fold(name, fold) for fold in reports}
    rows = ((row, names[fold]) for fold, report in reports.items() for row in report["rows"])
    return [row["metrics"]["realism"] for row, wanted in rows if row["name"] == wanted]


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in [head, *rows]]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]]) + "\n"


def number(value: float | None, digits: int = 2) -> str:
    """Return a number, or - where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def text_of(value: Any) -> str:
    """Return a value, or - where there is none."""
    return "-" if value is None else str(value)


def measure() -> None:
    """Measure the decisions of the README's controllers, and write them with what they were measured on."""
    import torch

    import pedzoo

    torch.set_num_threads(1)
    places = spread_points(load_plan(FLOOR), "wall", 0.5, 1.0, seed=0)
    result = {}
    for name in CHOICE:
        if name.startswith(ROBOTS):
            continue
        controller = pedzoo.controller(name, FLOOR)
        goals, medians = dict(enumerate(places[PEOPLE : 2 * PEOPLE])), []
        for _ in range(REPEATS):
            controller.reset()
            people, took = dict(enumerate(places[:PEOPLE])), []
            for _ in range(STEPS):
                begin = time.perf_counter()
                velocity = controller.step(people, goals)
                took.append(1e3 * (time.perf_counter() - begin))
                people = {one: place + 0.4 * velocity[one] for one, place in people.items()}
            medians.append(median(took[WARM:]))
        result[name] = round(min(medians), 1)
        print(f"{name}: {result[name]} ms")
    about = {"people": PEOPLE, "map": FLOOR, "decisions": STEPS, "threads": 1, "torch": torch.__version__}
    STEP_MS.write_text(json.dumps({**about, "ms": result}, indent=1) + "\n")


PAGES: dict[str, dict[str, Callable[[], str]]] = {
    "README.md": {"models": models, "results": results},
    "docs/zoo.md": {"zoo": zoo},
    "docs/results.md": {
        "loop": results_tables.in_the_loop,
        "walked": results_tables.walked,
        "indoors": results_tables.indoors,
        "forecasts": results_tables.forecasts,
    },
}
"""Generated parts of pages, by the names of their markers."""


def filled(page: str) -> str:
    """Return the text of a page with what stands between its markers made anew."""
    text = (ROOT / page).read_text()
    for name, make in PAGES[page].items():
        begin, end = f"<!-- {name}: python -m tools.pages.tables -->\n", f"<!-- end of {name} -->"
        before, marker, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not marker or not closed:
            raise SystemExit(f"{page}: expected the markers {begin.strip()} and {end}")
        text = f"{before}{begin}\n{make().strip()}\n\n{end}{after}"
    return text


def main(words: list[str]) -> int:
    """Write, check or measure; returns the exit code."""
    if "--measure" in words:
        measure()
    stale = [page for page in PAGES if filled(page) != (ROOT / page).read_text()]
    if "--check" in words:
        print("\n".join(f"{page} is out of date: python -m tools.pages.tables" for page in stale))
        return bool(stale)
    for page in stale:
        (ROOT / page).write_text(filled(page))
        print(page)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
