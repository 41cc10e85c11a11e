"""``pedzoo forecast``: open-loop errors of models between the trivial baselines."""

HELP = "ADE and FDE of models beside constant velocity and the lines to the goal"
EXAMPLE = "pedzoo forecast sgan_goal.zara1 --data.fold zara1 --samples 20 --json out.json"

TRAIN = (
    "Configs that are first trained on the training part of the data, between commas: their checkpoints are "
    "models of the table."
)


def run(argv: list[str]) -> int:
    """Print the table; returns the exit code."""
    from jsonargparse import ArgumentParser

    from pedzoo.cli.output import check_outputs, print_report, write_and_print
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import progress_bar
    from pedzoo.cli.suggestions import given
    from pedzoo.core.machine import versions
    from pedzoo.data.datamodule import Loading, TrajectoryDataModule
    from pedzoo.eval.forecast import forecast
    from pedzoo.models.zoo.loading import load

    usage = f"pedzoo forecast MODEL... [--data.fold FOLD] [--data.X ...] [--samples K]\nexample: {EXAMPLE}"
    parser = ArgumentParser(prog="pedzoo forecast", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument(
        "models", nargs="*", type=str, help="Zoo names, .safetensors, .ckpt or file.py:Class."
    )
    parser.add_class_arguments(TrajectoryDataModule, "data", skip={"imitated"})
    parser.add_function_arguments(forecast, as_group=False, skip={"names", "data", "progress"})
    parser.add_argument("--train", type=str, default="", help=TRAIN)
    parser.add_argument("--runs", type=str, default="runs", help="Folder of these runs.")
    parser.add_argument("--json", type=str | None, help="Also write the report to this file.")
    options = parse(parser, argv)
    check_outputs(json=options.json)

    names = [*options.models, *trained(options.train, argv, options.runs)]
    settings = options.data.as_dict()
    settings["loading"] = Loading(**settings["loading"])
    if not given(argv, "--data.goal"):  # then every model that has a goal protocol is asked for its own
        own = (load(name).goal_protocol for name in names)
        settings["goal"] = next((goal for goal in own if goal not in (None, "none")), "none")
    data = TrajectoryDataModule(**settings)
    with progress_bar() as progress:
        report = forecast(names, data, options.samples, options.seed, options.split, progress)
    report = {"command": "forecast", **report, "versions": versions()}
    write_and_print(report, options.json, lambda: print_report(report))
    return 0


def trained(configs: str, argv: list[str], runs: str) -> list[str]:
    """Train configs on the data that the words of a command name, and return their best checkpoints.

    Args:
        configs: Names between commas; empty for none.
        argv: The command's words; those of ``--data`` are handed on, and ``--seed`` seeds the training.
        runs: Folder of the runs.

    Raises:
        UserError: A config is unknown or a training fails.
    """
    from pathlib import Path

    from pedzoo.cli.main import main
    from pedzoo.core.configs import load_config
    from pedzoo.core.errors import UserError

    words = [word for pair in _pairs(argv) if pair[0].startswith("--data.") for word in pair]
    options = {name.partition("=")[0]: value for name, value in _pairs(argv)}
    result = []
    for config in filter(None, configs.split(",")):
        generator = load_config(config)["model"]["init_args"]["generator"]
        fixed = "steps" in generator.get("init_args", {}).get("architecture", {})
        steps = options.get("--data.pred_len") if fixed else None
        more = ["--model.generator.architecture.steps", steps] if steps else []
        before = set(Path(runs).rglob("best.ckpt"))
        seed = ["--seed_everything", options.get("--seed", "0")]
        if main(["fit", "--config", config, "--runs", runs, *seed, *words, *more]):
            raise UserError(f"the training of {config!r} failed: see above")
        result += [str(file) for file in sorted(set(Path(runs).rglob("best.ckpt")) - before)]
    return result


def _pairs(argv: list[str]) -> list[list[str]]:
    """Return the options of a command, each with its value: ``--a 1`` and ``--a=1`` alike."""
    pairs = []
    for place, word in enumerate(argv):
        if word.startswith("--"):
            name, equal, value = word.partition("=")
            pairs.append([name, value if equal else "".join(argv[place + 1 : place + 2])])
    return pairs
