"""``pedzoo plans``: floor plans drawn from seeds, as ROS map files and as one picture."""

from pedzoo.maps.formats import write_ros

HELP = "draw apartments and offices from seeds: ROS maps, and a picture of them"
EXAMPLE = "pedzoo plans apartment office --count 6 --seed 0 --out plans --sheet plans.png"


def run(argv: list[str]) -> int:
    """Write the floor plans and say what they are; returns the exit code."""
    from pathlib import Path

    from jsonargparse import ArgumentParser
    from jsonargparse.typing import NonNegativeInt, PositiveInt

    from pedzoo.cli.output import check_outputs, write_json
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import progress_bar
    from pedzoo.core.errors import UserError, unknown
    from pedzoo.core.machine import versions
    from pedzoo.maps.procedural.plan import KINDS, FloorPlan, generate
    from pedzoo.viz.plan_sheet import save_sheet

    usage = f"pedzoo plans KIND... [--count N] [--seed S] [--out FOLDER] [...]\nexample: {EXAMPLE}"
    parser = ArgumentParser(prog="pedzoo plans", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument("kinds", nargs="+", type=str, help=f"What is drawn: {', '.join(KINDS)}.")
    parser.add_argument("--count", type=PositiveInt, default=20, help="Plans of each kind.")
    parser.add_argument(
        "--seed", type=NonNegativeInt, default=0, help="Of the first one; the next counts on."
    )
    parser.add_argument("--out", type=str, default="plans", help="Folder for KIND.SEED.yaml and .png.")
    settings = parser.add_function_arguments(generate, as_group=False, skip={"kind", "seed"})
    parser.add_argument("--sheet", type=str | None, help="Draw all plans into this .png.")
    parser.add_argument("--json", type=str | None, help="Also write what is printed to this file.")
    parser.add_argument("--overwrite", action="store_true", help="Replace files that are there already.")
    options = parse(parser, argv)

    kinds, folder = list(dict.fromkeys(options.kinds)), Path(options.out)
    for kind in kinds:
        if kind not in KINDS:
            raise unknown("kind of floor plan", kind, KINDS)
    if options.sheet and Path(options.sheet).suffix != ".png":
        raise UserError(f"--sheet {options.sheet}: expected a name in .png")
    check_outputs(sheet=options.sheet, json=options.json)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--out {options.out}: is a file, expected a folder")
    seeds = range(options.seed, options.seed + options.count)
    suffix = ".yaml" if options.furnished else ".bare.yaml"
    files = {(kind, seed): folder / f"{kind}.{seed}{suffix}" for kind in kinds for seed in seeds}
    there = [name for file in files.values() for name in (file, file.with_suffix(".png")) if name.exists()]
    if there and not options.overwrite:
        raise UserError(f"{there[0]} exists: give another --out or --seed, or --overwrite")

    settings = {key: options[key] for key in settings}
    plans: list[FloorPlan] = []
    with progress_bar() as progress:
        for (kind, seed), file in files.items():
            plan = generate(kind, seed, **settings)
            write_ros(plan.grid, file)
            plans.append(plan)
            progress("plans", len(plans), len(files))
    rows = [{"name": plan.grid.name, "case": {}, "n": 1, "metrics": plan.facts()} for plan in plans]
    for row, file, plan in zip(rows, files.values(), plans, strict=True):
        row |= {"file": str(file), "digest": plan.grid.digest}
        facts = row["metrics"]
        print(
            f"{file}  {facts['width_m']:.2f} x {facts['height_m']:.2f} m, {facts['rooms']} rooms, "
            f"{facts['doors']} doors of {facts['narrowest_door_m']:.2f} to {facts['widest_door_m']:.2f} m, "
            f"{facts['pieces']} pieces of furniture, {facts['free_m2']:.0f} m2 free"
        )
    if options.sheet:
        save_sheet(plans, Path(options.sheet))
        print(f"sheet: {options.sheet}")
    if options.json:
        protocol = {"kinds": kinds, **settings}
        report = {"protocol": protocol, "seeds": list(seeds), "versions": versions(), "rows": rows}
        write_json(options.json, {"command": "plans", **report})
    return 0
