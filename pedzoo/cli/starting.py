"""Where a training starts from: what ``--resume``, ``--weights`` and checkpoints stand for."""

from pathlib import Path
from typing import Literal

from pedzoo.cli.parsing import given
from pedzoo.core.errors import UserError
from pedzoo.train.fine_tuning import architecture_options, options_of, options_to_continue
from pedzoo.train.run import RunFolder

Command = Literal["fit", "validate", "test"]


def expand(command: Command, argv: list[str]) -> tuple[list[str], RunFolder | None]:
    """Write out what ``--resume RUN``, ``--weights NAME`` and a checkpoint in a run folder stand for.

    Returns:
        The command line with the options that were left to them, and the run that goes on, if one does.

    Raises:
        UserError: No such run, checkpoint or weights, or two of them at once.
    """
    options = ("--resume", "--ckpt_path", "--weights") if command == "fit" else ("--ckpt_path",)
    named = {option: value for option in options if (value := given(argv, option))}
    if "--weights" in named and len(named) > 1:
        other = next(option for option in named if option != "--weights")
        raise UserError(f"--weights begins a training and {other} goes on with one: give one of them")
    if folder := named.get("--resume"):
        run = RunFolder.resume(folder)
        return [*options_to_continue(run), *argv], run
    configured = given(argv, "--config") or given(argv, "-c")
    if weights := named.get("--weights"):
        if configured:
            return _behind_configs(argv, architecture_options(weights, configured)), None
        return [*options_of(weights), *argv], None
    checkpoint = named.get("--ckpt_path")
    if checkpoint and not Path(checkpoint).is_file():
        raise UserError(f"no checkpoint {checkpoint!r}")
    if command != "fit" and checkpoint and not configured:
        config = Path(checkpoint).parent.parent / "config.yaml"
        if config.is_file():
            return ["--config", str(config), *argv], None
    return argv, None


def _behind_configs(argv: list[str], options: list[str]) -> list[str]:
    """Return a command line with ``options`` that win over its configs, and not over what else was typed."""
    configs, rest, words = [], [], iter(argv)
    for word in words:
        if word in ("--config", "-c"):
            configs += [word, next(words)]
        elif word.startswith(("--config=", "-c=")):
            configs.append(word)
        else:
            rest.append(word)
    return [*configs, *options, *rest]
