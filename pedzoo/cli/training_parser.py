"""What all trainings at the command line share: config files with what they inherit, and a progress bar."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from csv import DictReader
from pathlib import Path
from traceback import extract_tb
from typing import Any

import yaml
from jsonargparse import Namespace
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, RichProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI

from pedzoo.cli.parsing import PARSER_SETTINGS
from pedzoo.cli.signals import reinstall_handlers
from pedzoo.cli.starting import ExpandedCommand
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError, at_least_one
from pedzoo.core.registry import file_path, import_path, names_code
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.train.run import RunFolder
from pedzoo.train.run_settings import resumable_settings, reusable_settings
from pedzoo.train.slurm import run_again


def result_line(run: RunFolder, chosen: Path, monitor: str) -> tuple[str, dict[str, str]]:
    """Return ``val/ade 0.075 (epoch 2)`` of a run's checkpoint, and all that was logged in its epoch."""
    epoch, file = read_checkpoint(chosen).get("epoch"), run.path / "metrics.csv"
    rows = list(DictReader(file.read_text().splitlines())) if file.is_file() else []
    its = [row for row in rows if row.get("epoch") == str(epoch)]
    values = {key: value for row in its for key, value in row.items() if value}
    value = (
        f"{monitor} {float(values[monitor]):.3f} (epoch {epoch})" if monitor in values else f"epoch {epoch}"
    )
    return value, values


class ProgressBar(RichProgressBar):
    """Lightning's bar without the version, which here is the name of the run folder."""

    def get_metrics(self, *args: Any) -> dict[str, Any]:
        """Return what is shown beside the bar."""
        return {key: value for key, value in super().get_metrics(*args).items() if key != "v_num"}


class Signals(Callback):
    """Takes signals back from Lightning, whose handler talks to other processes in the midst of a step."""

    def on_sanity_check_start(self, *_: Any) -> None:
        """Do so before the first validation."""
        reinstall_handlers()

    def on_train_start(self, *_: Any) -> None:
        """Do so before the first step."""
        reinstall_handlers()


class ConfigParser(LightningArgumentParser):
    """Reads config files with what they inherit.

    Attributes:
        start: What the command goes on from. A config that the person did not name is not trusted.
    """

    start: ExpandedCommand = ExpandedCommand([])

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a parser, also one of a class within: these have no settings of `PARSER_SETTINGS`."""
        super().__init__(*args, **PARSER_SETTINGS | kwargs)

    def parse_path(self, path: str | os.PathLike, *args: Any, **kwargs: Any) -> Namespace:
        """Parse a config file; arguments as of jsonargparse's."""
        settings = load_config(os.fspath(path))
        beside, typed = self.start.beside, self.start.typed
        if beside and Path(path).resolve() == beside.resolve():
            if typed is None:
                settings = reusable_settings(settings, beside)
            else:
                settings = resumable_settings(settings, beside, typed)
        settings = with_classes(settings, lambda path: import_path(path) if names_code(path) else path)
        whole = yaml.safe_dump(settings, sort_keys=False)
        return self.parse_string(whole, os.path.basename(path), *args, **kwargs)


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


def check_seed(seed: int) -> None:
    """Check that the seed of a run is one that all generators of random numbers take.

    Raises:
        UserError: It is not.
    """
    if not 0 <= seed < 2**32:
        given = f"{seed:d}" if abs(seed) < 2**63 else f"a number of {len(str(abs(seed)))} digits"
        raise UserError(f"--seed_everything is {given}, expected 0 to {2**32 - 1}")


class RunCLI(LightningCLI):
    """LightningCLI of one command, whose trainer writes into a run folder.

    Attributes:
        run: The folder; None where there is none, or none yet.
    """

    run: RunFolder | None = None

    def __init__(self, *classes: type, args: list[str], **texts: str) -> None:
        """Parse ``args`` and build trainer and ``classes``; ``texts`` are prog, usage and description."""
        super().__init__(
            *classes,
            args=args,
            run=False,
            parser_class=ConfigParser,
            subclass_mode_model=True,
            seed_everything_default=0,
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,  # a checkpoint names its model itself, see `pedzoo.load`
            save_config_callback=None,
            trainer_defaults={"logger": None, "enable_model_summary": False},
            parser_kwargs=texts,
        )

    def _parse_ckpt_path(self) -> None:
        """Leave the command line alone: it wins over what a checkpoint remembers."""

    def instantiate_classes(self) -> None:
        """Build all objects; where a class refuses its options, the message is that of the class.

        The folder of the run is let go of then.

        Raises:
            UserError: A class refused its options.
        """
        try:
            with ExitStack() as if_it_fails:
                if_it_fails.callback(lambda: self.run and self.run.end())
                super().instantiate_classes()
                if_it_fails.pop_all()
        except ValueError as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, UserError):
                cause = cause.__cause__  # jsonargparse says of what type nothing was, and shows all options
            if cause is not None:
                raise cause from None
            raise

    def instantiate_trainer(self, **kwargs: Any) -> Any:
        """Build the trainer.

        Raises:
            UserError: It refuses its options.
        """
        self._check_precision()
        for name in ("check_val_every_n_epoch", "accumulate_grad_batches"):
            if (number := self.config_init["trainer"].get(name)) is not None:
                at_least_one(f"--trainer.{name}", number)
        try:
            return super().instantiate_trainer(**kwargs)
        except ValueError as error:
            raise UserError(str(error)) from error

    def _check_precision(self) -> None:
        known = getattr(self.model, "precisions", ["32-true"])
        given = str(self.config_init["trainer"].get("precision") or known[0])
        usual = {"16": "16-mixed", "bf16": "bf16-mixed", "32": "32-true", "64": "64-true"}
        if usual.get(given, given) not in known:
            raise UserError(f"--trainer.precision {given}: this trains in {' or '.join(known)} alone")

    def go_on_from_last(self, run: RunFolder) -> None:
        """Start from the last checkpoint where the run of a Slurm job goes on that is run again."""
        if run.goes_on and not self.config["resume"] and run.last.is_file():
            self.config["ckpt_path"] = str(run.last)

    @contextmanager
    def stoppable(self, run: RunFolder | None) -> Iterator[None]:
        """Let signals end a training, and say how to go on; for Slurm's the job is run again."""
        try:
            try:
                yield
            except (UserError, MisconfigurationException):
                if run:  # with these options there is nothing to go on with
                    run.forget()
                raise
            finally:
                if run:
                    run.end()  # before Slurm hears of it: another run of the job may begin at once
        except SystemExit as error:
            stop = error.__context__
            if isinstance(stop, KeyboardInterrupt) and self.trainer.is_global_zero:
                print(f"\ninterrupted{_how_to_go_on(run) or ', nothing saved yet'}", flush=True)
                if str(stop) == "SIGUSR1":
                    print(run_again(), flush=True)
            raise
        except Exception as error:  # raised again; such as that of a process whose neighbour was killed
            if not isinstance(error, UserError | MisconfigurationException) and _restores(error):
                said, file = " ".join(str(error).split()), self.config["ckpt_path"]
                raise UserError(
                    f"cannot go on from {file!r} ({type(error).__name__}: {said:.300}): is it damaged, or of "
                    "another training?"
                ) from error
            if self.trainer.is_global_zero and (how := _how_to_go_on(run)):
                print(f"\nbroken off{how}", flush=True)
            raise

    def plain_config(self) -> dict[str, Any]:
        """Return the resolved configuration as plain values, without what belongs to this call only."""
        result = yaml.safe_load(self.parser.dump(self.config, skip_none=False))
        result = with_classes(result, file_path)
        return {key: value for key, value in result.items() if key not in ("ckpt_path", "resume", "config")}


def _restores(error: Exception) -> bool:
    """Return whether an error was raised while Lightning took a checkpoint's state."""
    frames = extract_tb(error.__traceback__)
    return any("checkpoint_connector" in frame.filename and "restore" in frame.name for frame in frames)


def _how_to_go_on(run: RunFolder | None) -> str:
    if not run or not run.last.is_file():
        return ""
    config = run.path / "config.yaml"
    try:
        resumable_settings(load_config(config), config, frozenset())
    except UserError:  # code of one's own has to be named again
        return f"; continue with: pedzoo fit --resume {run.path} --config {config}"
    return f"; continue with: pedzoo fit --resume {run.path}"
