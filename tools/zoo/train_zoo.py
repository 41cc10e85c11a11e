"""Train the weights in checkpoints/, and make their cards and their table.

    python tools/zoo/train_zoo.py train | export | measure | table [--only sgan_goal]

``train`` runs ``pedzoo fit`` for every recipe and seed, as a user would, skips what is finished and resumes
what was interrupted; closed-loop recipes go on from the exported weights of the open-loop ones. ``export``
publishes the seed that is best in validation, as ``pedzoo export --zoo`` does. ``measure`` puts the numbers
on the cards that lack them, with ``--again`` on all. ``table`` evaluates every seed on the test scenes and
writes checkpoints/results/FORECAST.md and .json. The recordings are found by PEDZOO_DATA.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
from zoo_recipes import RECIPES, Recipe

from pedzoo.core.machine import versions
from pedzoo.core.paths import CARD, shipped, weight_files, write_atomically
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.cards import MEASURED, measure
from pedzoo.eval.forecast import forecast, forecast_row
from pedzoo.models.zoo.card import read_card, write_card
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.publish import publish
from tools.pages.tables import table as markdown
from tools.zoo.robots import fit_whole, is_finished, over_seeds, with_spread

HEADER = """# Open-loop results of every seed

Made by `python tools/zoo/train_zoo.py train && python tools/zoo/train_zoo.py table`; as JSON: FORECAST.json.
Social GAN's windows of 8 observed steps of 0.4 s, metres; the checkpoint of every run is chosen on the
validation windows of the other scenes. Mean of the seeds, their standard deviation behind ±. The weights that
were chosen, beside the published numbers: TABLE1.md, made by `pedzoo reproduce table1`.

`ade`, `fde` and `next_step` judge the one most likely prediction (noise zero); `sampled ade` is one random
sample; `best of 20` takes one sample for all people of a window together (scene), or each their own
(agent); `anchors` are centroids of training futures, the floor under it.
Under `window_end` the goal is the answer's last position and leaks it: read the lines' rows.
"""

COLUMNS = {
    "ade_m": "ade", "fde_m": "fde", "next_step_m": "next step", "ade_sampled_m": "sampled ade",
    "min_ade_20_scene_m": "best of 20 ade, scene", "min_fde_20_scene_m": "fde, scene",
    "min_ade_20_agent_m": "ade, agent", "min_fde_20_agent_m": "fde, agent",
    "fde_of_min_ade_20_agent_m": "fde of the best by ade", "miss_rate_20": "missed by 2 m",
    "sample_distance_m": "samples apart", "calibration_error": "calibration error",
    "nll_nats_per_step": "nll",
}  # fmt: skip


def train(recipes: list[Recipe], root: Path, jobs: int) -> None:
    """Train every seed of every recipe, the first seeds of all before the second ones."""
    seeds = range(max(recipe.seeds for recipe in recipes))
    wanted = [(recipe, seed) for seed in seeds for recipe in recipes if seed < recipe.seeds]
    with ThreadPoolExecutor(jobs) as pool:
        for done in [pool.submit(train_one, recipe, seed, root) for recipe, seed in wanted]:
            done.result()


def train_one(recipe: Recipe, seed: int, root: Path) -> None:
    """Train one seed in a process of its own; finished runs are left alone, interrupted ones resumed."""
    run = recipe.run(seed, root)
    if is_finished(run):
        return
    options = {**recipe.options, "seed_everything": str(seed), "runs": str(recipe.runs(root))}
    if (weights := recipe.begins_with) and weights not in weight_files():
        raise SystemExit(f"{recipe.name} begins with {weights}: train and export these first")
    fit_whole(run, options, root / f"{recipe.name}-{seed}.log")
    print(f"{recipe.name} seed {seed}: {recipe.monitor} {recipe.finished(root)[seed]:.4f}", flush=True)


def export(recipes: list[Recipe], root: Path) -> None:
    """Publish the seed of every recipe that is best in validation."""
    for recipe in recipes:
        if values := recipe.finished(root):
            seed = recipe.best(values, key=values.__getitem__)
            half = recipe.config in ("anchor_mlp", "anchor_net")
            card = publish(recipe.run(seed, root).best, shipped("checkpoints"), recipe.name, half=half)
            print(f"{card}: seed {seed} of {len(values)}, {recipe.monitor} {values[seed]:.4f}", flush=True)


def numbers(recipes: list[Recipe], again: bool) -> None:
    """Measure what cards of shipped weights lack; ``again``: all of it, of all recipes."""
    for name in (recipe.name for recipe in recipes):
        path = shipped("checkpoints") / name / CARD
        if not path.is_file():
            continue
        card = read_card(path)
        known = [] if again else card.evaluations
        lacking = set(MEASURED) - {report["command"] for report in known}
        if lacking and (new := measure(name, commands=sorted(lacking))):
            evaluations = sorted([*new, *known], key=lambda report: MEASURED.index(str(report["command"])))
            write_card(msgspec.structs.replace(card, evaluations=evaluations), path)
            print(path, flush=True)


def table(root: Path) -> None:
    """Write both files; rows of more seeds than there are runs of below ``root`` stay as they are."""
    target = shipped("checkpoints") / "results"
    result: dict[tuple, dict] = {}
    for row in [*json.loads((target / "FORECAST.json").read_text())["rows"], *rows(root)]:
        key = row["name"], place_of(row["case"])
        if key not in result or row["seeds"] >= result[key]["seeds"]:
            result[key] = row
    ordered = sorted(result.values(), key=lambda row: place_of(row["case"]))
    report = {"command": "tools/zoo/train_zoo.py table", "versions": versions(), "rows": ordered}
    write_atomically(target / "FORECAST.json", (json.dumps(report, separators=(",", ":")) + "\n").encode())
    write_atomically(target / "FORECAST.md", page(ordered).encode())


def rows(root: Path) -> Iterator[dict]:
    """Yield one row per recipe and baseline: test errors of every seed."""
    done: set[tuple[int, str, str]] = set()
    for recipe in RECIPES:
        # on the true clock other windows are scored, and the cards say with which errors
        if recipe.clock == "true" or not (seeds := recipe.finished(root)):
            continue
        data = TrajectoryDataModule(fold=recipe.fold, goal=recipe.goal, pred_len=recipe.pred_len)
        case = {"fold": recipe.fold, "goal": recipe.goal, "pred_len": recipe.pred_len}
        baselines = () if place_of(case) in done else forecast([], data)["rows"]
        done.add(place_of(case))
        yield from ({**row, "case": case, "seeds": 1} for row in baselines)
        models = {seed: load(recipe.run(seed, root).best) for seed in seeds}
        by_seed = [forecast_row(recipe.config, model, data, seed=seed) for seed, model in models.items()]
        row = {"name": recipe.config, "case": case, "n": by_seed[0]["n"], "seeds": len(by_seed)}
        yield row | over_seeds([row["metrics"] for row in by_seed])


def page(rows: list[dict]) -> str:
    """Return the tables, one for each fold and protocol."""
    lines = [HEADER]
    for place in dict.fromkeys(place_of(row["case"]) for row in rows):
        mine = [row for row in rows if place_of(row["case"]) == place]
        pred_len, goal, fold = place
        columns = {key: title for key, title in COLUMNS.items() if any(key in row["metrics"] for row in mine)}
        lines += [f"## {fold}, goal `{goal}`, {pred_len} predicted steps, {mine[0]['n']} people\n"]
        cells = [
            [row["name"], str(row["seeds"]), *(with_spread(row, key) for key in columns)] for row in mine
        ]
        lines += [markdown(["model", "seeds", *columns.values()], cells)]
    return "\n".join(lines)


def place_of(case: dict) -> tuple[int, str, str]:
    """Return steps, goal protocol and fold; rows of earlier tables do not say how many steps."""
    return case.get("pred_len", 8), case["goal"], case["fold"]


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["train", "export", "measure", "table"])
    parser.add_argument("--runs", type=Path, default=Path("runs/zoo"))
    parser.add_argument("--jobs", type=int, default=2, help="trainings at a time")
    parser.add_argument("--only", default="", help="only recipes whose name starts with this")
    parser.add_argument("--again", action="store_true", help="measure cards that have numbers, too")
    options = parser.parse_args()
    recipes = [recipe for recipe in RECIPES if recipe.name.startswith(options.only)]
    if not recipes:
        parser.error(f"--only {options.only}: no recipe's name starts with it")
    match options.what:
        case "train":
            train(recipes, options.runs, options.jobs)
        case "export":
            export(recipes, options.runs)
        case "measure":
            numbers(recipes, options.again)
        case _:
            table(options.runs)


if __name__ == "__main__":
    main()
