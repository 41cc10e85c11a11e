"""``pedzoo plans``: floor plans drawn from seeds, as ROS map files and as one picture."""

from pathlib import Path

from pedzoo.cli.output import check_outputs, write_json
from pedzoo.core.errors import UserError, at_least_one, at_least_zero, unknown
from pedzoo.core.machine import versions

HELP = "draw apartments and offices from seeds: ROS maps, and a picture of them"
EXAMPLE = "pedzoo plans apartment office --count 6 --seed 0 --out plans --sheet plans.png"


def run(
    kinds: list[str],
    /,
    count: int = 20,
    seed: int = 0,
    out: str = "plans",
    size: tuple[float, float] | None = None,
    resolution: float = 0.05,
    furnished: float = 1.0,
    doors: tuple[float, float] = (0.7, 1.5),
    sheet: str | None = None,
    json: str | None = None,
    overwrite: bool = False,
) -> int:
    """Write the floor plans and say what they are.

    Args:
        kinds: What is drawn: apartment, office.
        count: Plans of each kind.
        seed: Of the first one; the next counts on.
        out: Folder for KIND.SEED.yaml and .png.
        size: Outer width and height, metres, as ``12,9``; by default 8 to 14 m each for apartments, 20 to
            40 m by 12 to 25 m for offices.
        resolution: Side of a cell, metres: 0.05 or a whole part of it.
        furnished: From 0, bare rooms, to 1; the rooms are the same.
        doors: Least and largest width of a door, metres, as ``0.8,1.2``, within 0.7 to 1.5.
        sheet: Draw all plans into this .png.
        json: Also write what is printed to this file.
        overwrite: Replace files that are there already.
    """
    from pedzoo.cli.progress import progress_bar
    from pedzoo.maps.formats import write_ros
    from pedzoo.maps.procedural.plan import KINDS, FloorPlan, generate
    from pedzoo.viz.plan_sheet import save_sheet

    at_least_one("--count", count)
    at_least_zero("--", seed=seed)
    kinds, folder = list(dict.fromkeys(kinds)), Path(out)
    for kind in kinds:
        if kind not in KINDS:
            raise unknown("kind of floor plan", kind, KINDS)
    if sheet and Path(sheet).suffix != ".png":
        raise UserError(f"--sheet {sheet}: expected a name in .png")
    check_outputs(sheet=sheet, json=json)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--out {out}: is a file, expected a folder")
    seeds = range(seed, seed + count)
    suffix = ".yaml" if furnished else ".bare.yaml"
    files = {(kind, seed): folder / f"{kind}.{seed}{suffix}" for kind in kinds for seed in seeds}
    there = [name for file in files.values() for name in (file, file.with_suffix(".png")) if name.exists()]
    if there and not overwrite:
        raise UserError(f"{there[0]} exists: give another --out or --seed, or --overwrite")

    settings = {"size": size, "resolution": resolution, "furnished": furnished, "doors": doors}
    plans: list[FloorPlan] = []
    with progress_bar() as progress:
        for (kind, number), file in files.items():
            plans.append(generate(kind, number, **settings))
            write_ros(plans[-1].grid, file)
            progress("plans", len(plans), len(files))
    rows = []
    for plan, file in zip(plans, files.values(), strict=True):
        facts = plan.facts()
        row = {"name": plan.grid.name, "case": {}, "n": 1, "metrics": facts}
        rows.append(row | {"file": str(file), "digest": plan.grid.digest})
        print(
            f"{file}  {facts['width_m']:.2f} x {facts['height_m']:.2f} m, {facts['rooms']} rooms, "
            f"{facts['doors']} doors of {facts['narrowest_door_m']:.2f} to {facts['widest_door_m']:.2f} m, "
            f"{facts['pieces']} pieces of furniture, {facts['free_m2']:.0f} m2 free"
        )
    if sheet:
        save_sheet(plans, Path(sheet))
        print(f"sheet: {sheet}")
    if json:
        protocol = {"kinds": kinds, **settings}
        report = {"protocol": protocol, "seeds": list(seeds), "versions": versions(), "rows": rows}
        write_json(json, {"command": "plans", **report})
    return 0
