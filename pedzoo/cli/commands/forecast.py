"""``pedzoo forecast``: open-loop errors of models between the trivial baselines."""

HELP = "ADE and FDE of models beside constant velocity and the lines to the goal"
EXAMPLE = "pedzoo forecast sgan_goal.zara1 --data.fold zara1 --samples 20 --json out.json"


def run(argv: list[str]) -> int:
    """Print the table; returns the exit code."""
    from jsonargparse import ArgumentParser

    from pedzoo.cli.output import check_outputs, print_report, write_and_print
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import progress_bar
    from pedzoo.cli.words import given
    from pedzoo.core.machine import versions
    from pedzoo.data.datamodule import Loading, TrajectoryDataModule
    from pedzoo.eval.forecast import forecast
    from pedzoo.models.zoo.loading import load

    usage = f"pedzoo forecast MODEL... [--data.fold FOLD] [--data.X ...] [--samples K]\nexample: {EXAMPLE}"
    parser = ArgumentParser(prog="pedzoo forecast", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument(
        "models", nargs="+", type=str, help="Zoo names, .safetensors, .ckpt or file.py:Class."
    )
    parser.add_class_arguments(TrajectoryDataModule, "data", skip={"imitated"})
    parser.add_function_arguments(forecast, as_group=False, skip={"names", "data", "progress"})
    parser.add_argument("--json", type=str | None, help="Also write the report to this file.")
    options = parse(parser, argv)
    check_outputs(json=options.json)

    settings = options.data.as_dict()
    settings["loading"] = Loading(**settings["loading"])
    if not given(argv, "--data.goal"):  # then every model that has a goal protocol is asked for its own
        own = (load(name).goal_protocol for name in options.models)
        settings["goal"] = next((goal for goal in own if goal not in (None, "none")), "none")
    data = TrajectoryDataModule(**settings)
    with progress_bar() as progress:
        report = forecast(options.models, data, options.samples, options.seed, options.split, progress)
    report = {"command": "forecast", **report, "versions": versions()}
    write_and_print(report, options.json, lambda: print_report(report))
    return 0
