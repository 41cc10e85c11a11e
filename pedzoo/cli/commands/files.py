"""Files for others and from others: downloads, exported models, floor plans, and a page of results."""

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from pedzoo.cli.check import check_model
from pedzoo.cli.output import check_outputs, progress_bar, write_json, write_text
from pedzoo.cli.parsing import command
from pedzoo.core.errors import UserError, at_least_one, at_least_zero, need, unknown
from pedzoo.core.machine import versions
from pedzoo.core.paths import PAGES, WEIGHTS, data_home, expanded
from pedzoo.core.registry import DATASETS

ALEXNET = "alexnet"


@command("pedzoo download eth_ucy")
def download(name: str, /, to: str | None = None) -> int:
    """Download a dataset, AlexNet's weights or a model, checked, to where they are found.

    Args:
        name: eth_ucy or another dataset, alexnet, or a model as `pedzoo info` takes it.
        to: Put a dataset into this folder; by default into one of the user's cache.
    """
    from pedzoo.data.published.files import published
    from pedzoo.models.zoo.store import find, no_model, weights_of

    datasets = published()
    if name in datasets:
        _download_dataset(name, to)
    elif to:
        raise UserError(f"--to {to}: only for datasets ({', '.join(datasets)}), not {name!r}")
    elif name == ALEXNET:
        from pedzoo.models.blocks.alexnet import obtain

        print(obtain())
    elif entry := find(name):
        print(weights_of(entry))
    else:
        raise no_model(name, [*datasets, ALEXNET], "dataset or model")
    return 0


def _download_dataset(name: str, to: str | None) -> None:
    """Download a dataset, and print what came, where it is and on whose terms."""
    module = import_module(f"pedzoo.data.published.{name}")
    folder = expanded(to) if to else data_home() / name
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{str(folder)!r} is a file, expected a folder: give another --to")
    print(f"terms: {module.TERMS}\ncite: {module.CITATION}")
    files = module.download(folder)
    size = sum(file.size for file in files) / 1e6
    print(f"{name}: {len(files)} files, {size:.1f} MB, each with the expected sha256, in {folder}")
    found_without = not to and not os.environ.get("PEDZOO_DATA")
    fold = next(iter(DATASETS.constant(name, "FOLDS")))
    print(f"use: --data.fold {fold}{'' if found_without else f' --data.root {folder}'}")


@command("pedzoo export runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt --zoo --to zoo")
def export(
    model: str,
    /,
    zoo: bool = False,
    hub: str | None = None,
    onnx: str | None = None,
    to: str | None = None,
    name: str | None = None,
    no_evaluation: bool = False,
    data_root: str | None = None,
    plan: str | None = None,
    json: str | None = None,
) -> int:
    """Models for others: --zoo (weights and card), --hub (a folder to upload), --onnx (a graph).

    Args:
        model: A checkpoint of pedzoo fit, a zoo name, or another name of a model.
        zoo: ARCH.TAG/weights.safetensors and card.yaml, of a checkpoint in its run folder.
        hub: Weights, card and README.md, to be uploaded as they are, into this folder.
        onnx: A graph, checked against torch (needs the extra onnx), in this file.
        to: With --zoo: where to write; by default zoo.
        name: With --zoo: ARCH.TAG; by default the config and the fold, sgan_goal.zara1.
        no_evaluation: With --zoo: the card gets no numbers, done in a second.
        data_root: With --zoo: recordings; by default PEDZOO_DATA.
        plan: With --onnx, of a model that sees floor plans: also write this plan as inputs: apartment.7, a
            map's yaml.
        json: Also write what is printed to this file.
    """
    ways = [way for way, value in (("--zoo", zoo), ("--hub", hub), ("--onnx", onnx)) if value]
    if len(ways) != 1:
        several = f"{ways[-1]}: not allowed with argument {ways[0]}" if ways else ""
        raise UserError(several or "one of the arguments --zoo --hub --onnx is required")
    only_zoo = {"to": to, "name": name, "no-evaluation": no_evaluation, "data.root": data_root}
    for option, value, way in [*((*item, "--zoo") for item in only_zoo.items()), ("plan", plan, "--onnx")]:
        if value and way not in ways:
            raise UserError(f"--{option} goes with {way}: leave it out")
    check_outputs(onnx=onnx, json=json)
    check_model(model)
    if hub:
        said = _to_hub(model, hub)
    elif onnx:
        said = _to_onnx(model, onnx, plan)
    else:
        said = _to_zoo(model, to or "zoo", name, no_evaluation, data_root)
    if json:
        write_json(json, {"command": "export", "model": model, **said, "versions": versions()})
    return 0


def _to_zoo(model: str, folder: str, name: str | None, unmeasured: bool, root: str | None) -> dict[str, Any]:
    """Write weights and card, then measure the model, then write the card again with its numbers."""
    from pedzoo.eval.cards import measure
    from pedzoo.models.zoo.publish import publish

    if not model.endswith(".ckpt"):
        raise UserError(f"--zoo makes weights of a run: expected RUN/checkpoints/best.ckpt, not {model!r}")
    card = publish(model, folder, name)
    if not unmeasured:
        with progress_bar() as progress:
            measured = measure(model, card.parent.name, root, progress)
        publish(model, folder, card.parent.name, measured)
    weights = card.with_name(WEIGHTS)
    print(f"{weights}  {weights.stat().st_size:,} bytes\n{card}  its card")
    print(f'pedzoo.load("{card.parent}"), or by its name with PEDZOO_ZOO={folder}')
    return {"files": [str(weights), str(card)]}


def _to_hub(model: str, hub: str) -> dict[str, Any]:
    from pedzoo.models.zoo.card_page import write_hub

    if model.endswith((".ckpt", ".safetensors")):
        raise UserError(f"{model!r} has no card: make one with pedzoo export CHECKPOINT --zoo --to zoo")
    files = [str(path) for path in write_hub(model, hub)]
    print(*files, sep="\n")
    print(f'pedzoo.load("{hub}") loads it; upload it with: hf upload OWNER/REPOSITORY {hub}')
    return {"files": files}


def _to_onnx(name: str, onnx: str, plan_name: str | None) -> dict[str, Any]:
    need("onnx", "--onnx")
    need("train", "--onnx")  # the check against torch reads recordings
    from pedzoo.core.types import PRED_LEN
    from pedzoo.maps.plans import load_plan
    from pedzoo.models.onnx import export_onnx, save_plan
    from pedzoo.models.zoo.loading import load, saved_config

    model = load(name)
    file, files = Path(onnx), [onnx]
    if plan := load_plan(plan_name) if plan_name else None:
        files.append(str(file.with_name(f"{file.stem}.{plan.name}.npz")))
        save_plan(model, plan, files[1])
    steps = saved_config(name).get("protocol", {}).get("pred_len", PRED_LEN)
    result = export_onnx(model, file, steps, {"name": name})
    print(f"{file}  {result.size:,} bytes")
    for title, ports in (("inputs", result.inputs), ("outputs", result.outputs)):
        print(f"{title}:")
        for key, port in ports.items():
            print(f"  {key:<17} ({', '.join(map(str, port.shape))})  {port.about}")
    print("against torch, largest difference in metres per step:")
    for check in result.parity:
        print(f"  {check.scenes:>3} scenes of {check.people:>3} people: {check.difference:.1e}")
    if model.walking.safety:
        print("the safety layer, which keeps steps clear of people and walls, is not in the graph")
    for extra in files[1:]:
        print(f"{extra}  map_image and map_affine of {plan_name}")
    return {"files": files, "parity": [check._asdict() for check in result.parity]}


@command("pedzoo plans apartment office --count 6 --seed 0 --out plans --sheet plans.png")
def plans(
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
    """Draw apartments and offices from seeds: ROS maps, and a picture of them.

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
        sheet: Draw all plans into this .png, .pdf or .svg.
        json: Also write what is printed to this file.
        overwrite: Replace files that are there already.
    """
    from pedzoo.maps.formats import write_ros
    from pedzoo.maps.procedural import KINDS, generate

    at_least_one("--count", count)
    at_least_zero("--", seed=seed)
    kinds, folder = list(dict.fromkeys(kinds)), Path(out)
    for kind in kinds:
        if kind not in KINDS:
            raise unknown("kind of floor plan", kind, KINDS)
    if sheet:
        need("video", "--sheet")
    check_outputs(sheet=sheet, json=json)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--out {out}: is a file, expected a folder")
    seeds, suffix = range(seed, seed + count), ".yaml" if furnished else ".bare.yaml"
    files = {(kind, seed): folder / f"{kind}.{seed}{suffix}" for kind in kinds for seed in seeds}
    there = [name for file in files.values() for name in (file, file.with_suffix(".png")) if name.exists()]
    if there and not overwrite:
        raise UserError(f"{there[0]} exists: give another --out or --seed, or --overwrite")

    settings = {"size": size, "resolution": resolution, "furnished": furnished, "doors": doors}
    drawn, rows = [], []
    with progress_bar() as progress:
        for (kind, number), file in files.items():
            drawn.append(generate(kind, number, **settings))
            write_ros(drawn[-1].grid, file)
            progress("plans", len(drawn), len(files))
    for plan, file in zip(drawn, files.values(), strict=True):
        facts, grid = plan.facts(), plan.grid
        row = {"name": grid.name, "case": {}, "n": 1, "metrics": facts, "file": str(file)}
        rows.append(row | {"digest": grid.digest})
        print(
            f"{file}  {facts['width_m']:.2f} x {facts['height_m']:.2f} m, {facts['rooms']} rooms, "
            f"{facts['doors']} doors of {facts['narrowest_door_m']:.2f} to {facts['widest_door_m']:.2f} m, "
            f"{facts['pieces']} pieces of furniture, {facts['free_m2']:.0f} m2 free"
        )
    if sheet:
        from pedzoo.viz.plots import save_sheet

        save_sheet(drawn, sheet)
        print(f"sheet: {sheet}")
    if json:
        report = {"command": "plans", "protocol": {"kinds": kinds, **settings}, "seeds": list(seeds)}
        write_json(json, {**report, "versions": versions(), "rows": rows})
    return 0


@command("pedzoo report results.json runs -o report.html")
def report(results: list[str], /, out: str = "report.html", title: str = "pedzoo report") -> int:
    """Results as one page: sortable tables, replays from above, distributions, curves.

    Args:
        results: JSON of evaluate, rollout, forecast, score or bench, and folders of trainings; with replays
            where evaluate or rollout ran with --keep_episodes 3.
        out: The page.
        title: Its heading.
    """
    check_outputs({"out": PAGES}, out=out)
    from pedzoo.viz.report import content_of, page

    content = content_of(results)
    text = page(content, title)
    write_text(out, text)
    if out != "-":
        replays = sum(len(policy["episodes"]) for case in content["cases"] for policy in case["policies"])
        shown = f"{replays} replays" if replays else "no replays: evaluate with --keep_episodes 3 for some"
        print(f"report: {out} ({len(text.encode()) / 1e6:.1f} MB, {shown})")
    return 0
