"""``pedzoo fit``, ``validate`` and ``test`` of people and of robots: LightningCLI with run folders."""

import errno
import inspect
import logging
import math
import shlex
import warnings
from argparse import SUPPRESS
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic
from typing import Any, Literal, cast

import yaml
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI

from pedzoo.cli.check import ROBOT_MODULES, trained_class
from pedzoo.cli.output import check_outputs, duration, write_json
from pedzoo.cli.parsing import parse
from pedzoo.cli.starting import (
    Command,
    ConfigParser,
    ProgressBar,
    Signals,
    expand,
    how_to_go_on,
    restores_checkpoint,
    with_classes,
)
from pedzoo.core.errors import NO_ROOM, UserError, at_least_one
from pedzoo.core.machine import versions
from pedzoo.core.registry import COMMANDS, file_path, import_path, names_code
from pedzoo.core.spec import setting_groups, with_settings
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.recordings import find_fold
from pedzoo.models.zoo.loading import architecture_of, read_checkpoint
from pedzoo.train.module import ForecastModule, check_state, read_progress
from pedzoo.train.run import RunFolder, Wandb, finish_wandb, rows_of, run_again, run_name
from pedzoo.train.settings import DATA, check_unchanged, start_from
from pedzoo.train.validation import ClosedLoopValidation

_EXPECTED = (
    "LeafSpec.* is deprecated",  # Lightning 2.6 beside torch 2.13
    "callbacks used to create the checkpoint need to be provided",  # validate and test need none of them
    "does not have many workers",  # batches are cut from tensors in memory: workers would slow it down
    "is smaller than the logging interval",  # small recordings; epoch means are logged anyway
    "The method <bound method TensorDictBase.__deepcopy__",  # in 64-true Lightning copies batches
    "Checkpoint directory .* exists and is not empty",  # a resumed run
)

_USAGE = {"fit": "--config NAME | --weights NAME", "validate": "--ckpt_path FILE", "test": "--ckpt_path FILE"}

_ROBOT_PLACE = ("scenarios", "people", "robot", "decision_dt")
"""Settings of a robot's training that its card has: where it was trained, among whom, and in which body."""


def train(command: Command, argv: list[str]) -> int:
    """Run one of the three commands and return the exit code."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)  # seeds, devices, tips
    with warnings.catch_warnings():
        for message in _EXPECTED:
            warnings.filterwarnings("ignore", f".*{message}")
        try:
            cli = TrainingCLI(command, argv)
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


class TrainingCLI(LightningCLI):
    """Trains, validates or tests forecasters, or trains robots; errors are `UserError`.

    Attributes:
        robots: Whether a robot is trained: there are no recordings then.
        kinds: The classes of model and data.
        run: The folder that the trainer writes into; None where there is none, or none yet.
    """

    def __init__(self, command: Command, typed: list[str]) -> None:
        """Parse the command line as it was ``typed``, and build trainer, model and data."""
        self.robots = command == "fit" and trained_class(typed).startswith(ROBOT_MODULES)
        self.kinds: list[type] = [ForecastModule, TrajectoryDataModule]
        if self.robots:
            from pedzoo.train.ppo.robots import RobotPPO

            self.kinds = [RobotPPO]
        self.start = expand(command, typed)
        self.run: RunFolder | None = self.start.run
        self.command: Command = command
        self.typed = typed
        usage = "--config robot/ppo" if self.robots else f"{_USAGE[command]} [--data.X ...]"
        super().__init__(
            *self.kinds,
            args=self.start.argv,
            run=False,
            parser_class=ConfigParser,
            subclass_mode_model=True,
            seed_everything_default=0,
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,  # a checkpoint names its model itself, see `pedzoo.load`
            save_config_callback=None,
            trainer_defaults={"logger": None, "enable_model_summary": False},
            parser_kwargs={
                "prog": f"pedzoo {command}",
                "usage": f"pedzoo {command} {usage} [...]\nexample: {COMMANDS.declared(command)[0]}",
                "description": COMMANDS.describe(command),
            },
        )

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the options that are pedzoo's own."""
        fit = self.command == "fit"
        best, mode = ("val/return", "max") if self.robots else ("val/ade", "min")
        parser.add_argument("--ckpt_path", type=str | None, help="Start from this checkpoint.")
        # The configuration of a run must be readable by `validate` and `test`, too.
        for name, kind, default, text in (
            ("runs", str, "runs", "Folder of all run folders."),
            ("monitor", str, best, "The metric in which best.ckpt is best."),
            ("monitor_mode", Literal["min", "max"], mode, "Which of its values is best."),
            ("weights", str | None, None, "Fine-tune these: a zoo name, a .ckpt or a .safetensors file."),
            ("wandb", Wandb, "off", "Log to Weights & Biases beside metrics.csv."),
        )[: 3 if self.robots else 5]:
            parser.add_argument(f"--{name}", type=kind, default=default, help=text if fit else SUPPRESS)
        if fit:
            parser.add_argument("--resume", type=str | None, help="Continue the run in this folder.")
        else:
            parser.add_argument("--json", type=str | None, help="Also write the table to this file.")
        if not self.robots:
            # One seed for a run. The data's own is for those who load them without a trainer.
            parser.link_arguments("seed_everything", "data.loading.seed", compute_fn=int)
            parser.add_lightning_class_args(ClosedLoopValidation, "rollout")

    def _parse_ckpt_path(self) -> None:
        """Leave the command line alone: it wins over what a checkpoint remembers."""

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        """Parse, with errors in one line."""
        cast("ConfigParser", parser).start = self.start
        args = [
            import_path(word) if before in ("--model", "--model.generator") and names_code(word) else word
            for before, word in zip(["", *args], args, strict=False)
        ]
        self.config = parse(parser, args, [("model", self.kinds[0])])
        if not 0 <= (seed := self.config["seed_everything"]) < 2**32:
            given = f"{seed:d}" if abs(seed) < 2**63 else f"a number of {len(str(abs(seed)))} digits"
            raise UserError(f"--seed_everything is {given}, expected 0 to {2**32 - 1}")
        if self.command == "fit" and self.config["resume"] and self.run:
            fixed = ("model", _ROBOT_PLACE) if self.robots else ("data", DATA)
            check_unchanged(self.run.path, self.plain_config(), *fixed, self.kinds[-1])

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
        """Build the trainer with the run folder's loggers and checkpoints.

        Raises:
            UserError: It refuses its options.
        """
        self._check_start()
        options = self.config_init["trainer"]
        callbacks = options.get("callbacks") or []
        callbacks = [*callbacks] if isinstance(callbacks, list) else [callbacks]
        if options.get("enable_progress_bar") is not False:
            callbacks.append(ProgressBar())
        callbacks.append(Signals())
        # checkpoints of Slurm's for other programs may lie in the working directory, Lightning's own choice
        kwargs |= {"default_root_dir": self.config["runs"]}
        if self.command != "fit":
            kwargs |= {"logger": False, "enable_checkpointing": False}
        elif options.get("fast_dev_run") and not self.robots:
            kwargs |= {"logger": False}
        else:
            callbacks += self._records(options, kwargs)
        self._check_trainer(options)
        try:
            return super().instantiate_trainer(callbacks=callbacks, **kwargs)
        except ValueError as error:
            raise UserError(str(error)) from error

    def _check_start(self) -> None:
        """Check that checkpoint, weights and walks fit the model.

        Lightning would ask, too, but only after its logger has removed an earlier run's metrics.
        """
        file = self.config["ckpt_path"]
        if self.robots:
            if file:
                check_state(self.model, read_progress(file))
            return
        model = cast("ForecastModule", self.model)
        if file:
            model.on_load_checkpoint(read_progress(file) if self.command == "fit" else read_checkpoint(file))
        elif self.command == "fit" and (weights := self.config["weights"]):
            start_from(model, weights)
            print(f"starts from: {weights}")
        if self.command != "test":
            self.config_init["rollout"].check(model.generator, self.datamodule)

    def _records(self, options: Any, kwargs: dict[str, Any]) -> list[Callback]:
        """Claim and lock the run folder, and return the callbacks that write into it."""
        monitor, mode = self.config["monitor"], self.config["monitor_mode"]
        if not self.robots:
            monitor = None if options.get("enable_checkpointing") is False else monitor
            self.config_init["rollout"].check_monitor(monitor, mode)
        self.run = self.run or RunFolder.claim(self._base())
        if self.run.goes_on and not self.config["resume"] and self.run.last.is_file():
            self.config["ckpt_path"] = str(self.run.last)  # a job that Slurm runs again
        self.run.begin()
        kwargs |= self.run.trainer_options(options.get("plugins"))
        if options.get("logger") in (None, True):
            kwargs |= {"logger": self.run.loggers(self.config.get("wandb", "off"))}
        return self.run.callbacks(self.plain_config(), ["pedzoo", self.command, *self.typed], monitor, mode)

    def _check_trainer(self, options: Any) -> None:
        known = getattr(self.model, "precisions", ["32-true"])
        given = str(options.get("precision") or known[0])
        usual = {"16": "16-mixed", "bf16": "bf16-mixed", "32": "32-true", "64": "64-true"}
        if usual.get(given, given) not in known:
            raise UserError(f"--trainer.precision {given}: this trains in {' or '.join(known)} alone")
        for name in ("check_val_every_n_epoch", "accumulate_grad_batches"):
            if (number := options.get(name)) is not None:
                at_least_one(f"--trainer.{name}", number)

    def fit(self) -> int:
        """Train, and print what to do next."""
        run, began = self.run, monotonic()
        data = {} if self.robots else {"datamodule": self.datamodule}
        with self._stoppable(run):
            try:
                self.trainer.fit(self.model, **data, ckpt_path=self.config["ckpt_path"])
            finally:
                if self.config.get("wandb", "off") != "off":
                    finish_wandb(self.trainer.state.finished)
        if not self.trainer.is_global_zero:
            return 0
        if run and (chosen := next((path for path in (run.best, run.last) if path.is_file()), None)):
            print(f"\n{self._summary(run, chosen)}, {duration(monotonic() - began)}")
            print("\n".join(self._next_commands(chosen)))
        return 0

    def _summary(self, run: RunFolder, chosen: Path) -> str:
        """Return what the weights are worth by the run's own table: ``val/ade 0.075 (epoch 2)`` and so on."""
        epoch, monitor = read_checkpoint(chosen).get("epoch"), self.config["monitor"]
        rows = (row for row in rows_of(run.path / "metrics.csv") if row.get("epoch") == str(epoch))
        values = {key: value for row in rows for key, value in row.items()}
        said = f"epoch {epoch}"
        if monitor in values:
            said = f"{monitor} {float(values[monitor]):.3f} ({said})"
        if self.robots and (success := values.get("val/success")):
            said += f", success {float(success):.2f}"
        for name in () if self.robots else self.config_init["rollout"].scenarios:
            if success := values.get(f"rollout/{name}/success"):
                said += f", {name.partition(':')[0]} success {float(success):.2f}"
        return said

    def _next_commands(self, chosen: Path) -> list[str]:
        """Return what to type next: an evaluation of robots; a forecast, and a walk on their floor plan."""
        if self.robots:
            words = [str(chosen), "straight", "--suite", "robots", "--people", self.model.people, "--quick"]
            return [f"next: pedzoo evaluate {shlex.join(words)}"]
        code = architecture_of(cast("ForecastModule", self.model).generator)
        weights = shlex.quote(f"{code}:weights={chosen}" if names_code(code) else str(chosen))
        plan = self.config["data"].get("map")
        scenario = shlex.quote(with_settings("goals", {"map": str(plan)})) if plan else "door"
        return [
            f"next: pedzoo forecast {weights} {self._data_options()} --samples 20",
            f"      pedzoo rollout {weights} --scenario {scenario} --plot rollout.png",
        ]

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
        """Return where the run goes: config (or model), then scenario or data, and seed."""
        config = self.config
        files = config.get("config") or []
        file = Path(str(files[-1])) if files else Path(config["model"]["class_path"].rpartition(".")[2])
        # a run's own configuration is called like all others: the run has the name
        name = file.parent.parent.name if (file.parent / "versions.json").is_file() else run_name(file)
        if self.robots:
            place = config["model"]["init_args"]["scenarios"][0].partition(":")[0]
        elif files := config["data"].get("files"):
            place = Path(str(files[0])).stem
        else:
            place = known.name if (known := find_fold(fold := config["data"]["fold"])) else fold
        return Path(config["runs"]) / name / f"{place}-seed{int(config['seed_everything'])}"

    def _data_options(self) -> str:
        """Return the data options that differ from the defaults, but for those of training alone."""
        data, defaults = self.config["data"].as_dict(), inspect.signature(TrajectoryDataModule).parameters
        result = {"fold": data["fold"]} if not data.get("files") else {}
        said = {"fold", *setting_groups(TrajectoryDataModule)}
        for key, value in data.items():
            if key not in said and value not in (defaults[key].default, "random_future"):
                result[key] = ",".join(value) if isinstance(value, list) else value
        return " ".join(f"--data.{key} {shlex.quote(str(value))}" for key, value in result.items())

    def plain_config(self) -> dict[str, Any]:
        """Return the resolved configuration as plain values, without what belongs to this call only."""
        result = yaml.safe_load(self.parser.dump(self.config, skip_none=False))
        result = with_classes(result, file_path)
        return {key: value for key, value in result.items() if key not in ("ckpt_path", "resume", "config")}

    @contextmanager
    def _stoppable(self, run: RunFolder | None) -> Iterator[None]:
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
                print(f"\ninterrupted{how_to_go_on(run) or ', nothing saved yet'}", flush=True)
                if str(stop) == "SIGUSR1":
                    print(run_again(), flush=True)
            raise
        except Exception as error:  # raised again; such as that of a process whose neighbour was killed
            if not isinstance(error, UserError | MisconfigurationException) and restores_checkpoint(error):
                said, file = " ".join(str(error).split()), self.config["ckpt_path"]
                raise UserError(
                    f"cannot go on from {file!r} ({type(error).__name__}: {said:.300}): is it damaged, or of "
                    "another training?"
                ) from error
            if self.trainer.is_global_zero and (how := how_to_go_on(run)):
                print(f"\nbroken off{how}", flush=True)
            raise
