"""Train the weights in checkpoints/, and make their cards and their table.

    python tools/zoo/train_zoo.py train | export | measure | table [--only sgan_goal]

``train`` runs ``pedzoo fit`` for every recipe and seed, as a user would, skips what is finished and resumes
what was interrupted; closed-loop recipes go on from the exported weights of the open-loop ones. ``export``
publishes the seed that is best in validation, as ``pedzoo export --zoo`` does. ``measure`` puts the numbers
on the cards that have none, with ``--again`` on all. ``table`` evaluates every seed on the test scenes and
writes checkpoints/results/FORECAST.md. The recordings are found by PEDZOO_DATA.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
from forecast_table import table
from zoo_recipes import RECIPES, Recipe

from pedzoo.core.paths import CARD, shipped, weight_files
from pedzoo.eval.cards import measure
from pedzoo.models.zoo.card import read_card, write_card
from pedzoo.models.zoo.publish import publish
from tools.zoo.robots import fit


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
    if (run.path / "finished").is_file():
        return
    options = {**recipe.options, "seed_everything": str(seed), "runs": str(recipe.runs(root))}
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    if (weights := recipe.begins_with) and weights not in weight_files():
        raise SystemExit(f"{recipe.name} begins with {weights}: train and export these first")
    fit(["--resume", str(run.path)] if run.last.is_file() else words, root / f"{recipe.name}-{seed}.log")
    (run.path / "finished").touch()
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
    """Measure the shipped weights whose cards have no numbers yet; ``again``: those of all recipes."""
    for name in (recipe.name for recipe in recipes):
        path = shipped("checkpoints") / name / CARD
        if path.is_file() and (not (card := read_card(path)).evaluations or again):
            write_card(msgspec.structs.replace(card, evaluations=measure(name)), path)
            print(path, flush=True)


def main() -> None:
    """Parse and run."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
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
