"""``pedzoo fit``, ``validate`` and ``test``: LightningCLI with run folders and readable errors."""

import errno
import inspect
import logging
import math
import shlex
import warnings
from argparse import SUPPRESS
from collections.abc import Mapping
from pathlib import Path
from time import monotonic
from typing import Any, Literal, cast

from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.cli import LightningArgumentParser

from pedzoo.cli.output import check_outputs, write_json
from pedzoo.cli.parsing import parse
from pedzoo.cli.progress import duration
from pedzoo.cli.robot_training import RobotTrainingCLI, trains_robots
from pedzoo.cli.starting import Command, expand
from pedzoo.cli.training_parser import ConfigParser, ProgressBar, RunCLI, Signals, check_seed, result_line
from pedzoo.core.errors import NO_ROOM, UserError
from pedzoo.core.machine import versions
from pedzoo.core.registry import import_path, names_code
from pedzoo.core.spec import setting_groups, spelled
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.recordings import find_fold
from pedzoo.models.zoo.loading import architecture_of, read_checkpoint
from pedzoo.train.fine_tuning import start_from
from pedzoo.train.modules.module import ForecastModule, read_progress
from pedzoo.train.run import RunFolder, Wandb, finish_wandb, run_name
from pedzoo.train.run_settings import DATA, check_unchanged, tell_changes
from pedzoo.train.validation.rollout_validation import ClosedLoopValidation

_EXPECTED = (
    "LeafSpec.* is deprecated",  # Lightning 2.6 beside torch 2.13
    "callbacks used to create the checkpoint need to be provided",  # validate and test need none of them
    "does not have many workers",  # batches are cut from tensors in memory: workers would slow it down
    "is smaller than the logging interval",  # small recordings; epoch means are logged anyway
    "The method <bound method TensorDictBase.__deepcopy__",  # in 64-true Lightning copies batches
    "Checkpoint directory .* exists and is not empty",  # a resumed run
)

_USAGE = {"fit": "--config NAME | --weights NAME", "validate": "--ckpt_path FILE", "test": "--ckpt_path FILE"}


def train(command: Command, argv: list[str], about: str, example: str) -> int:
    """Run one of the three commands and return the exit code."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)  # seeds, devices, tips
    with warnings.catch_warnings():
        for message in _EXPECTED:
            warnings.filterwarnings("ignore", f".*{message}")
        try:
            if command == "fit" and trains_robots(argv):
                return RobotTrainingCLI(argv, about, example).fit()
            cli = TrainingCLI(command, argv, about, example)
            return cli.fit() if command == "fit" else cli.measure()
        except SystemExit as error:
            if isinstance(stop := error.__context__, KeyboardInterrupt):  # Lightning makes exit code 1 of it
                raise stop from None
            raise
        except MisconfigurationException as error:  # options that do not go together, no such metric, no GPU
            raise UserError(str(error)) from error
        except OSError as error:
            if error.errno not in (*NO_ROOM, errno.EACCES):
                raise
            raise UserError(f"cannot write {error.filename or 'a file'}: {error.strerror}") from error


class TrainingCLI(RunCLI):
    """Trains, validates or tests forecasters; errors are `UserError`."""

    def __init__(self, command: Command, typed: list[str], about: str = "", example: str = "") -> None:
        """Parse the command line as it was ``typed``, and build trainer, model and data."""
        self.start = expand(command, typed)
        self.run = self.start.run
        self.command: Command = command
        self.typed = typed
        super().__init__(
            ForecastModule,
            TrajectoryDataModule,
            args=self.start.argv,
            prog=f"pedzoo {command}",
            usage=f"pedzoo {command} {_USAGE[command]} [--data.X ...] [...]\nexample: {example}",
            description=about,
        )

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the options that are pedzoo's own."""
        # One seed for a run. The data's own is for those who load them without a trainer.
        parser.link_arguments("seed_everything", "data.loading.seed", compute_fn=int)
        parser.add_argument("--ckpt_path", type=str | None, help="Start from this checkpoint.")
        parser.add_lightning_class_args(ClosedLoopValidation, "rollout")
        fit = self.command == "fit"
        # The configuration of a run must be readable by `validate` and `test`, too.
        for name, kind, default, help in (
            ("runs", str, "runs", "Folder of all run folders."),
            ("weights", str | None, None, "Fine-tune these: a zoo name, a .ckpt or a .safetensors file."),
            ("wandb", Wandb, "off", "Log to Weights & Biases beside metrics.csv."),
            ("monitor", str, "val/ade", "The metric in which best.ckpt is best."),
            ("monitor_mode", Literal["min", "max"], "min", "Which of its values is best."),
        ):
            parser.add_argument(f"--{name}", type=kind, default=default, help=help if fit else SUPPRESS)
        if fit:
            parser.add_argument("--resume", type=str | None, help="Continue the run in this folder.")
        else:
            parser.add_argument("--json", type=str | None, help="Also write the table to this file.")

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        """Parse, with errors in one line."""
        files = cast("ConfigParser", parser)
        files.start = self.start
        args = [
            import_path(word) if before in ("--model", "--model.generator") and names_code(word) else word
            for before, word in zip(["", *args], args, strict=False)
        ]
        self.config = parse(parser, args, [("model", ForecastModule)])
        check_seed(self.config["seed_everything"])
        if self.command == "fit" and self.config["resume"] and self.run:
            check_unchanged(self.run.path, self.plain_config(), "data", DATA, TrajectoryDataModule)
            tell_changes(self.run.path, self.plain_config())

    def instantiate_trainer(self, **kwargs: Any) -> Any:
        """Build the trainer with the run folder's loggers and checkpoints."""
        if file := self.config["ckpt_path"]:
            # Lightning would ask, too, but only after its logger has removed an earlier run's metrics.
            read = read_progress if self.command == "fit" else read_checkpoint
            cast("ForecastModule", self.model).check(read(file))
        elif self.command == "fit" and (weights := self.config["weights"]):
            start_from(cast("ForecastModule", self.model), weights)
            print(f"starts from: {weights}")
        options, rollout = self.config_init["trainer"], self.config_init["rollout"]
        if self.command != "test":
            rollout.check(cast("ForecastModule", self.model).generator, self.datamodule)
        callbacks = options.get("callbacks") or []
        callbacks = [*callbacks] if isinstance(callbacks, list) else [callbacks]
        if options.get("enable_progress_bar") is not False:
            callbacks.append(ProgressBar())
        callbacks.append(Signals())
        # checkpoints of Slurm's for other programs may lie in the working directory, Lightning's own choice
        kwargs |= {"default_root_dir": self.config["runs"]}
        if self.command != "fit":
            kwargs |= {"logger": False, "enable_checkpointing": False}
        elif options.get("fast_dev_run"):
            kwargs |= {"logger": False}
        else:
            monitor = None if options.get("enable_checkpointing") is False else self.config["monitor"]
            rollout.check_monitor(monitor, self.config["monitor_mode"])
            self.run = self.run or RunFolder.claim(self._base())
            self.go_on_from_last(self.run)
            self.run.begin()
            kwargs |= self.run.trainer_options(options.get("plugins"))
            typed = ["pedzoo", self.command, *self.typed]
            callbacks += self.run.callbacks(self.plain_config(), typed, monitor, self.config["monitor_mode"])
            if options.get("logger") in (None, True):
                kwargs |= {"logger": self.run.loggers(self.config["wandb"])}
        return super().instantiate_trainer(callbacks=callbacks, **kwargs)

    def fit(self) -> int:
        """Train, and print what to do next."""
        run, began = self.run, monotonic()
        with self.stoppable(run):
            try:
                self.trainer.fit(self.model, self.datamodule, ckpt_path=self.config["ckpt_path"])
            finally:
                if self.config["wandb"] != "off":
                    finish_wandb(self.trainer.state.finished)
        if not self.trainer.is_global_zero:
            return 0
        if run and (chosen := next((path for path in (run.best, run.last) if path.is_file()), None)):
            print(f"\n{self._summary(run, chosen)}, {duration(monotonic() - began)}")
            code = architecture_of(cast("ForecastModule", self.model).generator)
            weights = shlex.quote(f"{code}:weights={chosen}" if names_code(code) else str(chosen))
            print(f"next: pedzoo forecast {weights} {self._data_options()} --samples 20")
            print(f"      pedzoo rollout {weights} --scenario {self._scenario()} --plot rollout.png")
        return 0

    def _summary(self, run: RunFolder, chosen: Path) -> str:
        """Return what the weights are worth by the run's own table: ``val/ade 0.075 (epoch 2)`` and so on."""
        said, values = result_line(run, chosen, self.config["monitor"])
        for name in self.config_init["rollout"].scenarios:
            if success := values.get(f"rollout/{name}/success"):
                said += f", {name.partition(':')[0]} success {float(success):.2f}"
        return said

    def _scenario(self) -> str:
        """Return where to watch the weights walk: on the floor plan of their recordings, if there is one."""
        plan = self.config["data"].get("map")
        return shlex.quote(spelled("goals", {"map": str(plan)})) if plan else "door"

    def measure(self) -> int:
        """Validate or test, and print the table."""
        check_outputs(json=self.config["json"])
        if not self.config["ckpt_path"] and any(True for _ in self.model.parameters()):
            raise UserError(f"pedzoo {self.command} needs --ckpt_path FILE: these weights are untrained")
        action = getattr(self.trainer, self.command)
        result = action(self.model, datamodule=self.datamodule, ckpt_path=self.config["ckpt_path"])[0]
        if (file := self.config["json"]) and self.trainer.is_global_zero:
            content = {"command": self.command, "protocol": self.datamodule.protocol, "versions": versions()}
            content |= {"seeds": [self.config["seed_everything"]], "rows": self._rows(result)}
            write_json(file, content)
        return 0

    def _rows(self, result: Mapping[str, float]) -> list[dict[str, Any]]:
        """Return what was measured: one row of the forecasts, and one of every scenario that was walked."""
        rows: dict[str, dict[str, Any]] = {}
        for key, value in result.items():
            where, _, metric = key.rpartition("/")
            if where == "rollout":
                continue  # means of other rows
            if where not in rows:
                rows[where] = {"name": self.config["ckpt_path"] or self.config["model"]["class_path"]}
                if where.startswith("rollout/"):
                    rows[where] |= self.config_init["rollout"].case(where.removeprefix("rollout/"))
                rows[where]["metrics"] = {}
            if not math.isnan(value):
                rows[where]["metrics"][metric] = value
        return sorted(rows.values(), key=lambda row: "case" in row)

    def _base(self) -> Path:
        """Return where the run goes: config (or model), then data and seed."""
        config = self.config
        files = config.get("config") or []
        file = Path(str(files[-1])) if files else Path(config["model"]["class_path"].rpartition(".")[2])
        # a run's own configuration is called like all others: the run has the name
        name = file.parent.parent.name if (file.parent / "versions.json").is_file() else run_name(file)
        files, fold = config["data"].get("files"), config["data"]["fold"]
        data = Path(str(files[0])).stem if files else (known.name if (known := find_fold(fold)) else fold)
        return Path(config["runs"]) / name / f"{data}-seed{int(config['seed_everything'])}"

    def _data_options(self) -> str:
        """Return the data options that differ from the defaults, but for those of training alone."""
        data, defaults = self.config["data"].as_dict(), inspect.signature(TrajectoryDataModule).parameters
        result = {"fold": data["fold"]} if not data.get("files") else {}
        said = {"fold", *setting_groups(TrajectoryDataModule)}
        for key, value in data.items():
            if key not in said and value not in (defaults[key].default, "random_future"):
                result[key] = ",".join(value) if isinstance(value, list) else value
        return " ".join(f"--data.{key} {shlex.quote(str(value))}" for key, value in result.items())
