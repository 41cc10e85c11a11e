"""Write the generated tables of README.md and docs/: python -m tools.pages.tables [--check|--measure].

``--check`` only says which pages are out of date; ``--measure`` first measures the column ms again.
"""

import json
import re
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np

from pedzoo.core.paths import CARD
from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.eval.forecast import BASELINES
from pedzoo.eval.trained_on import for_fold
from pedzoo.maps.grid import spread_points
from pedzoo.maps.plans import load_plan
from pedzoo.models.zoo.card import ModelCard, read_card
from pedzoo.models.zoo.store import ROBOTS, names

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "checkpoints" / "results"
STEP_MS = RESULTS / "STEP_MS.json"

Key = tuple[str, str]
"""A case and a metric of checkpoints/results/LOOP.md."""

CHOICE = {
    "approach_net_goal_map.indoor": "people walk around your robot: the default",
    "social_walker.indoor": "people walk in groups that you name, and brake nearly as recorded ones do",
    "social_walker.styled": "people are hardest to tell from recorded ones",
    "sgan_goal_map.zara1": "you forecast with goals and floor plans, as the iGibson paper; not for walking",
    "sgan_nopool.zara1": "you forecast without goals: Social GAN; not for walking",
    "robot_ppo.mix": "you want a robot with a lidar to compare with",
}
"""The README's models, and when one takes them."""

LEARNED = ("approach_net_goal_map.indoor", "social_walker.styled")
RULES = ("go_to_goal:safety=true", "orca:radius=0.2", "orca:radius=0.3", "social_force:preset=indoor")
"""Rows of the README's results; the first one is compared with all rules."""

COLUMNS: dict[str, Key] = {
    "doors: all arrive, no touch": ("doors: varied", "clean"),
    "buildings: no touch": ("buildings: drawn", "contact_free"),
    "buildings: all arrive": ("buildings: drawn", "episode_success"),
}
"""Columns of the README's results; realism is the last."""

CHANCE = 0.03
"""Differences up to this are within chance."""

LESS: dict[str, Key] = {
    "time in buildings, in times of free walking": ("buildings: drawn", "time_ratio"),
    "time in the scanned `aws_small_house`": ("buildings: aws_small_house", "time_ratio"),
    "time at doors": ("doors: varied", "time_ratio_median"),
    **{f"realism on {fold}": (f"replay: {fold}", "realism") for fold in SCENES},
}
"""Numbers by which a rule may be better: less is."""

SHOWN: dict[str, Key] = {
    "two at doors of 0.7 to 1.2 m: clean": ("doors: varied", "clean"),
    "their time / free walking, median": ("doors: varied", "time_ratio_median"),
    "doors of 0.7 to 0.85 m, both there within 0.4 s: clean": ("doors: hard", "clean"),
    "each the mirror image of the other: clean": ("doors: mirror", "clean"),
    "how much later the second one passes, s": ("doors: mirror", "yield_delay_s"),
    "2 against 2 at a door: clean": ("doors: 2 against 2", "clean"),
    "queue of 6: clean": ("doors: queue of 6", "clean"),
    "a person stands at the door: clean": ("doors: standing", "clean"),
    "queue of 20 at doors of 0.8 to 1.2 m: people / (m s) (real: about 1.9)": (
        *("doors: flow of 20", "specific_flow_per_m_s"),
    ),
    "unseen drawn floor plans: all people reach all goals": ("buildings: drawn", "episode_success"),
    "no person touches anything there": ("buildings: drawn", "contact_free"),
    "time / planned way's": ("buildings: drawn", "time_ratio"),
    "time / planned way's in `aws_small_house`": ("buildings: aws_small_house", "time_ratio"),
    "50 people in an unseen office: share who arrive": ("buildings: crowd of 50", "success"),
    "their touches per minute": ("buildings: crowd of 50", "contacts_per_min"),
    "share of doors at which another draw of noise lets another person go first": (
        *("noise: who goes first", "varied"),
    ),
    **{f"realism among the people of {fold}": (f"replay: {fold}", "realism") for fold in SCENES},
}
"""Rows of docs/results.md about controllers in the loop."""

SEEDED = ("approach_net_goal_map.indoor", "approach_net_goal.indoor")
POLICIES = {name: [f"{name}{seed}" for seed in ("", "-seed1", "-seed2")] for name in SEEDED}
WALKERS = ("social_walker.eth_ucy", "social_walker.styled", "approach_net_goal_map.controller_open")
POLICIES |= {name: [name] for name in (*WALKERS, *RULES)}
"""Their columns, and those of LOOP.md of which they show the least and the most, if any."""

FLOOR, PEOPLE, STEPS, WARM, REPEATS = "office.0", 10, 20, 3, 4
"""Of the measured scene: floor plan, people, decisions, the first ones that do not count, and walks."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in [head, *rows]]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]]) + "\n"


def number(value: float | None, digits: int = 2) -> str:
    """Return a number, or - where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def section(page: str, title: str) -> str:
    """Return what stands below a heading of a page of checkpoints/results."""
    return (RESULTS / page).read_text().partition(f"## {title}")[2].partition("\n## ")[0]


def cells_of(text: str) -> list[list[str]]:
    """Return the cells of the last Markdown table in a text, the head first, without the line of dashes."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [head, *rows]


def targets() -> dict[str, dict[Key, str]]:
    """Return the cells of the first table of LOOP.md, by policy, case and metric."""
    head, *rows = cells_of(section("LOOP.md", "Targets\n"))
    keys = [(row[0], row[1].split()[0]) for row in rows]
    return {
        name: {key: row[place].split()[0] for key, row in zip(keys, rows, strict=True) if row[place] != "-"}
        for place, name in enumerate(head)
        if place >= 2
    }


def realism(name: str) -> float | None:
    """Return the mean over the held-out recordings: of LOOP.md, else of SCORES.json or RESULTS.md."""
    cells = targets().get(name, {})
    values = [float(value) for (_, metric), value in cells.items() if metric == "realism"] or scored(name)
    if values:
        return fmean(values)
    head, *rows = cells_of(walked_page())
    column = head.index("replay all realism")
    return next((float(row[column]) for row in rows if row[0] == name), None)


def scored(name: str) -> list[float]:
    """Return the realism on each recording of SCORES.json, of the weights that did not see it."""
    reports = json.loads((RESULTS / "SCORES.json").read_text())
    names = {fold: for_fold(name, fold) for fold in reports}
    rows = ((row, names[fold]) for fold, report in reports.items() for row in report["rows"])
    return [row["metrics"]["realism"] for row, wanted in rows if row["name"] == wanted]


def card_of(name: str) -> ModelCard:
    """Return the card of shipped weights."""
    return read_card(ROOT / "checkpoints" / name / CARD)


def shipped() -> list[str]:
    """Return the names of all models in checkpoints/."""
    return [name for name in names() if (ROOT / "checkpoints" / name / CARD).is_file()]


def walked(card: ModelCard, case: str) -> dict[str, float]:
    """Return the metrics of a card's table, by the beginning of its name; empty where there is none."""
    rows = (row for report in card.evaluations for row in report["rows"])
    return next((row["metrics"] for row in rows if str(row.get("table", "")).startswith(case)), {})


def in_results(name: str) -> dict[str, float]:
    """Return the metrics of a policy in drawn buildings of RESULTS.md; empty where it is not there."""
    head, *rows = cells_of(section("RESULTS.md", "goals drawn: mean"))
    row = next((row for row in rows if row[0] == name), [])
    cells = {key: cell.split()[0] for key, cell in zip(head[1:], row[1:], strict=False)}
    return {key: float(cell) for key, cell in cells.items() if cell != "-"}


def models() -> str:
    """Return the README's table of models."""
    speed, rows = json.loads(STEP_MS.read_text())["ms"], []
    for name, when in CHOICE.items():
        card, robot = card_of(name), name.startswith(ROBOTS)
        values = in_results(name) or walked(card, "robots" if robot else "goals drawn")
        keys = ("agent_contacts_per_min", "wall_contacts_per_min")
        touches = sum(values[key] for key in keys) if keys[0] in values else None
        success = number(values.get("success")) + " (of robots)" * robot
        terms = "MIT, simulated people" if "simulated" in card.data["terms"] else "research"
        cells = [success, number(touches), number(realism(name)), number(speed.get(name), 0), terms]
        rows.append([f"`{name}`", when, *cells])
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
    cells = {
        name: {key: float(value) for key, value in mine.items()}
        for name, mine in targets().items()
        if name in (*LEARNED, *RULES)
    }
    rows = [
        [f"`{name}`", *(number(cells[name].get(key)) for key in COLUMNS.values()), number(realism(name))]
        for name in (*LEARNED, *RULES)
    ]
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
        card, robot = card_of(name), name.startswith(ROBOTS)
        training, init, seed = card.training, card.config.get("init", {}), card.training.get("seed")
        sees_plan = init.get("map") or init.get("walls") or card.architecture == "social_vrnn"
        forecasts = (one for one in card.evaluations if one["command"] == "forecast")
        ade = next((row["metrics"].get("ade_m") for one in forecasts for row in one["rows"]), None)
        about = ["-"] * 3
        if not robot:
            fold = "-" if training["fold"] == "eth_ucy" else training["fold"]
            about = ["yes" if sees_plan else "no", fold, f"{training['goal']}, {training['clock']}"]
        successes = [
            number(walked(card, case).get("success"))
            for case in ("robots" if robot else "door", "goals drawn")
        ]
        cells = [*about, number(ade, 3), uses(card), *successes]
        rows.append([f"`{name}`", "-" if seed is None else str(seed), *cells])
    head = ["name", "seed", "sees map", "held-out scene", "goal, time base", "ADE, m", "uses, m", "door"]
    return table([*head, "buildings"], rows)


def uses(card: ModelCard) -> str:
    """Return by how far the forecasts of a card's model move without each of its inputs."""
    reports = (report for report in card.evaluations if report["command"] == "inputs")
    shifts = {
        row["case"]["without"]: row["metrics"]["shift_m"] for report in reports for row in report["rows"]
    }
    shifts.pop("others of another scene", None)
    return ", ".join(f"{name} {number(shift, 3)}" for name, shift in shifts.items()) or "-"


def walked_page(page: str = "RESULTS.md") -> str:
    """Return the headline of a page of closed-loop results, without its intervals."""
    text = re.sub(r" \[[^]]*]", "", section(page, "all suites\n").strip())
    return f"\n{text.replace('_per_min', ' / min').replace('agent_', '')}\n"


def indoors() -> str:
    """Return the headline of what people do indoors, a policy in each column."""
    head, *rows = cells_of(walked_page("INDOOR.md"))
    columns = [[name.replace("_", " ") for name in head], *([f"`{row[0]}`", *row[1:]] for row in rows)]
    first, *rest = zip(*columns, strict=True)
    return table(first, rest)


def in_the_loop() -> str:
    """Return what controllers trained in the loop do, of several trainings the least and the most.

    Among recorded people those walk that have not seen them; where there are none, others, marked.
    """
    known = targets()
    columns = {name: [one for one in several if one in known] for name, several in POLICIES.items()}
    columns = {name: several for name, several in columns.items() if several}
    page = (RESULTS / "LOOP.md").read_text()
    seen = re.findall(r"^\* loop_replay: (\S+) was trained on", page, re.MULTILINE)
    rows = []
    for label, key in SHOWN.items():
        rows.append([label])
        for several in columns.values():
            fresh = [one for one in several if one not in seen or not key[0].startswith("replay")]
            values = {known[one].get(key, "-") for one in fresh or several}
            ends = [min(values, key=float), max(values, key=float)] if len(values) > 1 else values
            rows[-1].append(" to ".join(ends) + "*" * (not fresh))
    return table(["", *(f"`{name}`" for name in columns)], rows).replace("|  |", "| |", 1)


def forecasts() -> str:
    """Return the tables of forecasting errors."""
    known: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for row in json.loads((RESULTS / "FORECAST.json").read_text())["rows"]:
        if row["case"].get("pred_len", 8) == 8:
            known.setdefault((row["case"]["fold"], row["case"]["goal"]), {})[row["name"]] = row

    def value(row: dict[str, Any], metric: str) -> str:
        spread = row.get("spread", {}).get(metric)
        return f"{row['metrics'][metric]:.4f}" + (f" ± {spread:.4f}" if spread is not None else "")

    errors = []
    for goal in ("none", "window_end", "destination"):
        for name, row in known["zara1", goal].items():
            line = name in BASELINES
            keys = ("{}_m", "{}_sampled_m", "min_{}_20_scene_m")[: 1 if line else 3]
            cells = [" / ".join(value(row, key.format(end)) for end in ("ade", "fde")) for key in keys]
            cells = [*cells, *[""] * (3 - len(cells)), value(row, "next_step_m")]
            errors.append([f"`{goal}`", f"`{name}`", "" if line else str(row["seeds"]), *cells])
    best = ("sgan_goal", "bent_line", "straight_line")
    by_fold = {fold: known[fold, "window_end"] for fold in SCENES}
    folds = [
        [fold, *(value(rows[one], "ade_m") if one in rows else "-" for one in best)]
        for fold, rows in by_fold.items()
    ]
    head = ["goal", "model", "trainings", "most likely", "one random sample", "best of 20, per scene"]
    return (
        "zara1, 8 observed and 8 predicted steps, ADE / FDE in metres. Learned rows are the mean of so many "
        "trainings ±\ntheir standard deviation, each checkpoint chosen on the validation windows of the "
        f"other scenes.\n\n{table([*head, 'next step'], errors)}\n"
        "`sgan` is made for the best of 20: one of its random samples is worse than constant velocity. "
        "`window_end`\nis the paper's protocol and leaks the answer. ADE of the most likely prediction of "
        "`sgan_goal` beside the\nlines, on every fold:\n\n"
        f"{table(['fold', *(f'`{name}`' for name in best)], folds)}"
    )


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
    "docs/results.md": dict(loop=in_the_loop, walked=walked_page, indoors=indoors, forecasts=forecasts),
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
