"""``pedzoo export``: models for others, as weights with a card, as a folder for the hub, as an ONNX graph."""

import argparse
from typing import Any

from pedzoo.cli.arguments import Arguments

HELP = "models for others: --zoo (weights and card), --hub (a folder to upload), --onnx (a graph)"
EXAMPLE = "pedzoo export runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt --zoo --to zoo"

_GOES_WITH = {"to": "zoo", "name": "zoo", "no_evaluation": "zoo", "data.root": "zoo", "plan": "onnx"}
"""Options that say something about one way out alone."""


def run(argv: list[str]) -> int:
    """Write what is asked for and say what it is; returns the exit code."""
    from pedzoo.cli.checks import check_model
    from pedzoo.cli.output import check_outputs, write_json
    from pedzoo.core.errors import UserError
    from pedzoo.core.machine import versions

    options = _parser().parse_args(argv)
    for option, way in _GOES_WITH.items():
        if vars(options)[option] and not vars(options)[way]:
            raise UserError(f"--{option.replace('_', '-')} goes with --{way}: leave it out")
    check_outputs(onnx=options.onnx, json=options.json)
    check_model(options.model)
    if options.zoo:
        said = _zoo(options)
    elif options.hub:
        said = _hub(options)
    else:
        said = _onnx(options)
    if options.json:
        write_json(
            options.json, {"command": "export", "model": options.model, **said, "versions": versions()}
        )
    return 0


def _parser() -> Arguments:
    parser = Arguments("export", HELP, EXAMPLE)
    parser.add_argument("model", help="a checkpoint of pedzoo fit, a zoo name, or another name of a model")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--zoo", action="store_true", help="ARCH.TAG/weights.safetensors and card.yaml")
    what.add_argument(
        "--hub", metavar="FOLDER", help="weights, card and README.md, to be uploaded as they are"
    )
    what.add_argument("--onnx", metavar="FILE", help="a graph, checked against torch (needs the extra onnx)")
    zoo = parser.add_argument_group("with --zoo, of a checkpoint in its run folder")
    zoo.add_argument("--to", metavar="FOLDER", help="where to write (default: zoo)")
    zoo.add_argument("--name", metavar="ARCH.TAG", help="default: the config and the fold, sgan_goal.zara1")
    zoo.add_argument(
        "--no-evaluation", action="store_true", help="the card gets no numbers: done in a second"
    )
    zoo.add_argument("--data.root", metavar="FOLDER", help="recordings (default: PEDZOO_DATA)")
    onnx = parser.add_argument_group("with --onnx, of a model that sees floor plans")
    onnx.add_argument(
        "--plan", metavar="PLAN", help="also write this plan as inputs: apartment.7, a map's yaml"
    )
    parser.add_argument("--json", metavar="FILE", help="also write what is printed to this file")
    return parser


def _zoo(options: argparse.Namespace) -> dict[str, Any]:
    """Write weights and card, then measure the model, then write the card again with its numbers."""
    from pedzoo.cli.progress import progress_bar
    from pedzoo.core.errors import UserError
    from pedzoo.core.paths import WEIGHTS
    from pedzoo.eval.cards import measure
    from pedzoo.models.zoo.publish import publish

    if not options.model.endswith(".ckpt"):
        raise UserError(
            f"--zoo makes weights of a run: expected RUN/checkpoints/best.ckpt, not {options.model!r}"
        )
    folder = options.to or "zoo"
    card = publish(options.model, folder, options.name)
    if not options.no_evaluation:
        with progress_bar() as progress:
            measured = measure(options.model, card.parent.name, vars(options)["data.root"], progress)
        publish(options.model, folder, card.parent.name, measured)
    weights = card.with_name(WEIGHTS)
    print(f"{weights}  {weights.stat().st_size:,} bytes\n{card}  its card")
    print(f'pedzoo.load("{card.parent}"), or by its name with PEDZOO_ZOO={folder}')
    return {"files": [str(weights), str(card)]}


def _hub(options: argparse.Namespace) -> dict[str, Any]:
    from pedzoo.core.errors import UserError
    from pedzoo.models.zoo.card_page import write_hub

    if options.model.endswith((".ckpt", ".safetensors")):
        raise UserError(
            f"{options.model!r} has no card: make one with pedzoo export CHECKPOINT --zoo --to zoo"
        )
    files = [str(path) for path in write_hub(options.model, options.hub)]
    print(*files, sep="\n")
    print(f'pedzoo.load("{options.hub}") loads it; upload it with: hf upload OWNER/REPOSITORY {options.hub}')
    return {"files": files}


def _onnx(options: argparse.Namespace) -> dict[str, Any]:
    from pathlib import Path

    from pedzoo.core.errors import need

    need("onnx", "--onnx")
    need("train", "--onnx")  # the check against torch reads recordings
    from pedzoo.core.types import AHEAD_SECONDS, PRED_LEN
    from pedzoo.maps.plans import load_plan
    from pedzoo.models.onnx import export_onnx, save_plan
    from pedzoo.models.zoo.loading import load, saved_config

    model = load(options.model)
    plan = load_plan(options.plan) if options.plan else None
    file, files = Path(options.onnx), [options.onnx]
    if plan:
        files.append(str(file.with_name(f"{file.stem}.{plan.name}.npz")))
        save_plan(model, plan, files[1])
    steps = saved_config(options.model).get("protocol", {}).get("pred_len", PRED_LEN)
    result = export_onnx(model, file, steps, {"name": options.model})
    print(f"{file}  {result.size:,} bytes")
    for title, ports in (("inputs", result.inputs), ("outputs", result.outputs)):
        print(f"{title}:")
        for name, port in ports.items():
            print(f"  {name:<17} ({', '.join(map(str, port.shape))})  {port.about}")
    print("against torch, largest difference in metres per step:")
    for check in result.parity:
        print(f"  {check.scenes:>3} scenes of {check.people:>3} people: {check.difference:.1e}")
    if model.walking_safety:
        print("the safety layer, which keeps steps clear of people and walls, is not in the graph")
    if model.walking_extend_goal:
        print(f"nearer goals are not moved out to {AHEAD_SECONDS:g} s at the desired velocity in the graph")
    for name in files[1:]:
        print(f"{name}  map_image and map_affine of {options.plan}")
    return {"files": files, "parity": [check._asdict() for check in result.parity]}
