"""``pedzoo export``: models for others, as weights with a card, as a folder for the hub, as an ONNX graph."""

from typing import Any

from pedzoo.cli.check import check_model
from pedzoo.cli.output import check_outputs, write_json
from pedzoo.core.errors import UserError, need
from pedzoo.core.machine import versions

HELP = "models for others: --zoo (weights and card), --hub (a folder to upload), --onnx (a graph)"
EXAMPLE = "pedzoo export runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt --zoo --to zoo"


def run(
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
    """Write what is asked for and say what it is.

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
        said = _hub(model, hub)
    else:
        said = _onnx(model, onnx, plan) if onnx else _zoo(model, to or "zoo", name, no_evaluation, data_root)
    if json:
        write_json(json, {"command": "export", "model": model, **said, "versions": versions()})
    return 0


def _zoo(model: str, folder: str, name: str | None, unmeasured: bool, root: str | None) -> dict[str, Any]:
    """Write weights and card, then measure the model, then write the card again with its numbers."""
    from pedzoo.cli.progress import progress_bar
    from pedzoo.core.paths import WEIGHTS
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


def _hub(model: str, hub: str) -> dict[str, Any]:
    from pedzoo.models.zoo.card_page import write_hub

    if model.endswith((".ckpt", ".safetensors")):
        raise UserError(f"{model!r} has no card: make one with pedzoo export CHECKPOINT --zoo --to zoo")
    files = [str(path) for path in write_hub(model, hub)]
    print(*files, sep="\n")
    print(f'pedzoo.load("{hub}") loads it; upload it with: hf upload OWNER/REPOSITORY {hub}')
    return {"files": files}


def _onnx(name: str, onnx: str, plan_name: str | None) -> dict[str, Any]:
    from pathlib import Path

    need("onnx", "--onnx")
    need("train", "--onnx")  # the check against torch reads recordings
    from pedzoo.core.types import AHEAD_SECONDS, PRED_LEN
    from pedzoo.maps.plans import load_plan
    from pedzoo.models.onnx import export_onnx, save_plan
    from pedzoo.models.zoo.loading import load, saved_config

    model = load(name)
    plan = load_plan(plan_name) if plan_name else None
    file, files = Path(onnx), [onnx]
    if plan:
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
    if model.walking.extend_goal:
        print(f"nearer goals are not moved out to {AHEAD_SECONDS:g} s at the desired velocity in the graph")
    for extra in files[1:]:
        print(f"{extra}  map_image and map_affine of {plan_name}")
    return {"files": files, "parity": [check._asdict() for check in result.parity]}
