"""Where a training starts from: what configs, ``--resume``, ``--weights`` and checkpoints stand for."""

import os
import re
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml
from jsonargparse import Namespace
from lightning.pytorch.callbacks import RichProgressBar
from lightning.pytorch.cli import LightningArgumentParser

from pedzoo.cli.check import given
from pedzoo.cli.parsing import PARSER_SETTINGS
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.registry import import_path, names_code
from pedzoo.core.untrusted import refuse_code
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.train.run import RunFolder
from pedzoo.train.settings import (
    architecture_options,
    config_beside,
    options_of,
    resumable_settings,
    reusable_settings,
)

Command = Literal["fit", "validate", "test"]

_TRAINER = re.compile("Customize every aspect of training via flags:.*?\n\n", re.DOTALL)
_TRAINER_IN_SHORT = """\
Lightning's trainer, as --trainer.max_epochs 20; `pedzoo fit --config NAME --help` explains all:
  max_epochs, max_steps, max_time, devices, accelerator, strategy, precision, check_val_every_n_epoch,
  limit_train_batches, limit_val_batches, log_every_n_steps, enable_progress_bar, callbacks, ...

"""


class ExpandedCommand(NamedTuple):
    """A command line ``argv`` with the options that were left to runs and weights.

    ``run`` is the one that goes on, if one does. ``beside`` is the config that lies beside a checkpoint,
    where the person did not name it.
    """

    argv: list[str]
    run: RunFolder | None = None
    beside: Path | None = None


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
    configured = given(argv, "--config") or given(argv, "-c")
    if folder := named.get("--resume"):
        run = RunFolder.resume(folder)
        config = run.path / "config.yaml"
        beside = None if configured and Path(configured).resolve() == config.resolve() else config
        options = ["--config", str(config), "--ckpt_path", str(run.last)]
        return ExpandedCommand([*options, *argv], run, beside)
    if weights := named.get("--weights"):
        if configured:
            options = _without_code(architecture_options(weights, configured), argv, weights)
            # they win over configs, and not over what else was typed
            parser = ArgumentParser(add_help=False, allow_abbrev=False)
            parser.add_argument("--config", "-c", action="append", default=[])
            known, rest = parser.parse_known_args(argv)
            return ExpandedCommand([*(f"--config={one}" for one in known.config), *options, *rest])
        options = _without_code(options_of(weights), argv, weights)
        return ExpandedCommand([*options, *argv], beside=config_beside(weights))
    checkpoint = named.get("--ckpt_path")
    if checkpoint and not Path(checkpoint).is_file():
        raise UserError(f"no checkpoint {checkpoint!r}")
    if command != "fit" and checkpoint and not configured:
        if config := config_beside(checkpoint):
            return ExpandedCommand(["--config", str(config), *argv], beside=config)
        # what is no checkpoint is refused: else it would be said that there is no model
        if Path(checkpoint).suffix != ".ckpt":
            more = f"; weights are measured by: pedzoo forecast {checkpoint}"
            more *= checkpoint.endswith(".safetensors")
            expected = "expected a .ckpt file, as pedzoo fit writes it"
            raise UserError(f"--ckpt_path {checkpoint}: {expected}{more}")
        read_checkpoint(checkpoint)
    return ExpandedCommand(argv)


def _without_code(options: list[str], argv: list[str], weights: str) -> list[str]:
    """Return what weights say, as options, without what was typed instead of a file of code; others raise."""
    left = [one for one in options if not (names_code(one) and given(argv, one.partition("=")[0]))]
    refuse_code(left, f"--weights {weights}", "name it yourself, as in --data.fold file.py:Class:fold")
    return left


class ConfigParser(LightningArgumentParser):
    """Reads config files with what they inherit.

    Attributes:
        start: What the command goes on from. A config that the person did not name is not trusted.
    """

    start: ExpandedCommand = ExpandedCommand([])

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a parser with `PARSER_SETTINGS`, also one of a class within."""
        super().__init__(*args, **PARSER_SETTINGS | kwargs)

    def format_help(self) -> str:
        """Return the help text, without 300 lines about Lightning's trainer where no config is named."""
        text = super().format_help()
        return text if given(self.start.argv, "--config") else _TRAINER.sub(_TRAINER_IN_SHORT, text)

    def parse_path(self, path: str | os.PathLike, *args: Any, **kwargs: Any) -> Namespace:
        """Parse a config file."""
        settings = load_config(os.fspath(path))
        if (beside := self.start.beside) and Path(path).resolve() == beside.resolve():
            settings = (resumable_settings if self.start.run else reusable_settings)(settings, beside)
        settings = with_classes(settings, lambda path: import_path(path) if names_code(path) else path)
        text = yaml.safe_dump(settings, sort_keys=False)
        return self.parse_string(text, os.path.basename(path), *args, **kwargs)


def with_classes(settings: Any, change: Callable[[str], str]) -> Any:
    """Return settings in which every ``class_path`` is changed."""
    if isinstance(settings, list):
        return [with_classes(one, change) for one in settings]
    if not isinstance(settings, dict):
        return settings
    result = {key: with_classes(value, change) for key, value in settings.items()}
    if isinstance(path := result.get("class_path"), str):
        result["class_path"] = change(path)
    return result


def how_to_go_on(run: RunFolder | None) -> str:
    """Return the command that goes on with a run; '' where it has no checkpoint."""
    if not run or not run.last.is_file():
        return ""
    config = run.path / "config.yaml"
    try:
        resumable_settings(load_config(config), config)
    except UserError:  # code of one's own has to be named again
        return f"; continue with: pedzoo fit --resume {run.path} --config {config}"
    return f"; continue with: pedzoo fit --resume {run.path}"


class ProgressBar(RichProgressBar):
    """Lightning's bar without the version, which here is the name of the run folder."""

    def get_metrics(self, *args: Any) -> dict[str, Any]:
        """Return what is shown beside the bar."""
        return {key: value for key, value in super().get_metrics(*args).items() if key != "v_num"}
