"""Where a training starts from: what ``--resume``, ``--weights`` and checkpoints stand for."""

import re
from collections.abc import Set
from pathlib import Path
from typing import Literal, NamedTuple

from pedzoo.cli.suggestions import given, split_names
from pedzoo.core.errors import UserError
from pedzoo.core.forms import refuse_code
from pedzoo.core.registry import names_code, whole_name
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.train.fine_tuning import architecture_options, config_beside, options_of, options_to_continue
from pedzoo.train.run import RunFolder

Command = Literal["fit", "validate", "test"]


class ExpandedCommand(NamedTuple):
    """A command line with what its options stand for.

    Attributes:
        argv: With the options that were left to runs and weights.
        run: The run that goes on, if one does.
        beside: The config among these options that the person did not name: it lies beside a checkpoint.
        typed: What the person did name, where ``beside`` is that of a run that goes on.
    """

    argv: list[str]
    run: RunFolder | None = None
    beside: Path | None = None
    typed: Set[str] | None = None


def expand(command: Command, argv: list[str]) -> ExpandedCommand:
    """Write out what ``--resume RUN``, ``--weights NAME`` and a checkpoint in a run folder stand for.

    Raises:
        UserError: No such run, checkpoint or weights, a damaged checkpoint, or two of them at once.
    """
    options = ("--resume", "--ckpt_path", "--weights") if command == "fit" else ("--ckpt_path",)
    named = {option: value for option in options if (value := given(argv, option))}
    if "--weights" in named and len(named) > 1:
        other = next(option for option in named if option != "--weights")
        raise UserError(f"--weights begins a training and {other} goes on with one: give one of them")
    if folder := named.get("--resume"):
        return resumed(argv, folder)
    configured = given(argv, "--config") or given(argv, "-c")
    if weights := named.get("--weights"):
        if configured:
            options = _without_code(architecture_options(weights, configured), argv, weights)
            return ExpandedCommand(_behind_configs(argv, options))
        options = _without_code(options_of(weights), argv, weights)
        return ExpandedCommand([*options, *argv], beside=config_beside(weights))
    checkpoint = named.get("--ckpt_path")
    if checkpoint and not Path(checkpoint).is_file():
        raise UserError(f"no checkpoint {checkpoint!r}")
    if command != "fit" and checkpoint and not configured:
        if config := config_beside(checkpoint):
            return ExpandedCommand(["--config", str(config), *argv], beside=config)
        _check_checkpoint(checkpoint)
    return ExpandedCommand(argv)


def resumed(argv: list[str], folder: str) -> ExpandedCommand:
    """Write out what ``--resume RUN`` stands for.

    Raises:
        UserError: No such run, or its checkpoint is damaged.
    """
    run = RunFolder.resume(folder)
    config = run.path / "config.yaml"
    named = given(argv, "--config") or given(argv, "-c")
    beside = None if named and Path(named).resolve() == config.resolve() else config
    return ExpandedCommand([*options_to_continue(run), *argv], run, beside, names_typed(argv))


def names_typed(argv: list[str]) -> set[str]:
    """Return all that a command line may name, as of `whole_name`: values, and the parts of lists."""
    values = [word.partition("=")[2] if word.startswith("--") else word for word in argv]
    parts = [part for value in values for part in (*split_names(value), *re.split(r"[][{}\"',\s]+", value))]
    return {whole_name(name) for name in (*values, *parts)}


def _check_checkpoint(file: str) -> None:
    """Refuse what is no checkpoint, where it would be said that there is no model."""
    if Path(file).suffix != ".ckpt":
        weights = (
            f"; weights are measured by: pedzoo forecast {file}" if file.endswith(".safetensors") else ""
        )
        raise UserError(f"--ckpt_path {file}: expected a .ckpt file, as pedzoo fit writes it{weights}")
    read_checkpoint(file)


def _without_code(options: list[str], argv: list[str], weights: str) -> list[str]:
    """Return what weights say, as options, without what was typed instead of a file of code.

    Raises:
        UserError: They name a file of code.
    """
    left = [one for one in options if not (names_code(one) and given(argv, one.partition("=")[0]))]
    refuse_code(left, f"--weights {weights}", "name it yourself, as in --data.fold file.py:Class:fold")
    return left


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
