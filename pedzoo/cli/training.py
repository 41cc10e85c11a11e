"""``pedzoo fit``, ``validate`` and ``test`` of people and of robots: Lightning's trainer with run folders."""

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
from traceback import extract_tb
from typing import Any, Literal

import yaml
from jsonargparse import Namespace
from lightning import LightningDataModule, Trainer, __version__, seed_everything
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, LambdaCallback

from pedzoo.cli.check import ROBOT_MODULES, trained_class
from pedzoo.cli.output import check_outputs, duration, write_json
from pedzoo.cli.parsing import parse
from pedzoo.cli.signals import reinstall_handlers
from pedzoo.cli.starting import (
    Command,
    ConfigParser,
    ProgressBar,
    expand,
    how_to_go_on,
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
            training = Training(command, argv)
            return training.fit() if command == "fit" else training.measure()
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


class Training:
    """A trainer with its model and data, made from a command line; errors are `UserError`.

    Attributes:
        command: What is done.
        typed: The command line.
        robots: Whether a robot is trained: there are no recordings then.
        run: The folder that the trainer writes into; None where there is none, or none yet.
        config: All options.
        made: What the options of classes became; of the trainer they stay options.
        model: What is trained or measured.
        trainer: Lightning's.
    """

    def __init__(self, command: Command, typed: list[str]) -> None:
        """Parse the command line as it was ``typed``, and build trainer, model and data."""
        self.command: Command = command
        self.typed = typed
        self.robots = command == "fit" and trained_class(typed).startswith(ROBOT_MODULES)
        self.owner: type = ForecastModule
        if self.robots:
            from pedzoo.train.ppo.robots import RobotPPO

            self.owner = RobotPPO
        self.start = expand(command, typed)
        self.run: RunFolder | None = self.start.run
        self.parser = self._parser()
        self.config = self._parsed()
        if (seed := self.config["seed_everything"]) is not False:
            self.config["seed_everything"] = seed_everything(None if seed is True else seed, workers=True)
        try:
            with ExitStack() as if_it_fails:
                if_it_fails.callback(lambda: self.run and self.run.end())
                self.made = self.parser.instantiate_classes(self.config)
                self.model: Any = self.made["model"]
                self.trainer = self._trainer()
                if_it_fails.pop_all()
        except ValueError as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, UserError):
                cause = cause.__cause__  # jsonargparse says of what type nothing was, and shows all options
            if cause is not None:
                raise cause from None
            raise

    def _parser(self) -> ConfigParser:
        fit = self.command == "fit"
        usage = "--ckpt_path FILE [--data.X ...]"
        if fit:
            usage = "--config robot/ppo" if self.robots else "--config NAME | --weights NAME [--data.X ...]"
        parser = ConfigParser(
            prog=f"pedzoo {self.command}",
            usage=f"pedzoo {self.command} {usage} [...]\nexample: {COMMANDS.declared(self.command)[0]}",
            description=COMMANDS.describe(self.command),
            dump_header=[f"lightning.pytorch=={__version__}"],
        )
        parser.start = self.start
        add, add_class = parser.add_argument, parser.add_lightning_class_args
        add("-c", "--config", action="config", help="A shipped config's name, or a file.")
        add("--seed_everything", type=bool | int, default=0, help="Seed of the run; true for any.")
        add_class(Trainer, "trainer")
        parser.set_defaults({"trainer.logger": None, "trainer.enable_model_summary": False})
        add_class(self.owner, "model", subclass_mode=True)
        data = LightningDataModule if self.robots else TrajectoryDataModule
        add_class(data, "data", subclass_mode=self.robots, required=not self.robots)
        add("--ckpt_path", type=str | None, help="Start from this checkpoint.")
        best, mode = ("val/return", "max") if self.robots else ("val/ade", "min")
        # the configuration of a run must be readable by `validate` and `test`, too
        for name, kind, default, text in (
            ("runs", str, "runs", "Folder of all run folders."),
            ("monitor", str, best, "The metric in which best.ckpt is best."),
            ("monitor_mode", Literal["min", "max"], mode, "Which of its values is best."),
            ("weights", str | None, None, "Fine-tune these: a zoo name, a .ckpt or a .safetensors file."),
            ("wandb", Wandb, "off", "Log to Weights & Biases beside metrics.csv."),
        )[: 3 if self.robots else 5]:
            add(f"--{name}", type=kind, default=default, help=text if fit else SUPPRESS)
        if fit:
            add("--resume", type=str | None, help="Continue the run in this folder.")
        else:
            add("--json", type=str | None, help="Also write the table to this file.")
        if not self.robots:
            # one seed for a run; the data's own is for those who load them without a trainer
            parser.link_arguments("seed_everything", "data.loading.seed", compute_fn=int)
            add_class(ClosedLoopValidation, "rollout")
        return parser

    def _parsed(self) -> Namespace:
        words = self.start.argv
        words = [
            import_path(word) if before in ("--model", "--model.generator") and names_code(word) else word
            for before, word in zip(["", *words], words, strict=False)
        ]
        self.config = parse(self.parser, words, [("model", self.owner)])
        if not 0 <= (seed := self.config["seed_everything"]) < 2**32:
            given = f"{seed:d}" if abs(seed) < 2**63 else f"a number of {len(str(abs(seed)))} digits"
            raise UserError(f"--seed_everything is {given}, expected 0 to {2**32 - 1}")
        if self.command == "fit" and self.config["resume"] and self.run:
            place = ("model", _ROBOT_PLACE, self.owner)
            fixed = place if self.robots else ("data", DATA, TrajectoryDataModule)
            check_unchanged(self.run.path, self.plain_config(), *fixed)
        return self.config

    def _trainer(self) -> Trainer:
        """Build the trainer with the run folder's loggers and checkpoints."""
        self._check_start()
        options: dict[str, Any] = {**self.made["trainer"]}
        own = options.get("callbacks") or []
        callbacks: list[Any] = [*own] if isinstance(own, list) else [own]
        if options.get("enable_progress_bar") is not False:
            callbacks.append(ProgressBar())
        # Lightning's own handlers talk to other processes in the midst of a step
        hooks = dict.fromkeys(("on_train_start", "on_sanity_check_start"), lambda *_: reinstall_handlers())
        callbacks.append(LambdaCallback(**hooks))
        known = getattr(self.model, "precisions", ["32-true"])
        given = str(options.get("precision") or known[0])
        usual = {"16": "16-mixed", "bf16": "bf16-mixed", "32": "32-true", "64": "64-true"}
        # checkpoints of Slurm's for other programs may lie in the working directory, Lightning's own choice
        more: dict[str, Any] = {"default_root_dir": self.config["runs"]}
        if self.command != "fit":
            more |= {"logger": False, "enable_checkpointing": False}
        elif options.get("fast_dev_run") and not self.robots:
            more |= {"logger": False}
        else:
            callbacks += self._records(options, more)
        if usual.get(given, given) not in known:
            raise UserError(f"--trainer.precision {given}: this trains in {' or '.join(known)} alone")
        for name in ("check_val_every_n_epoch", "accumulate_grad_batches"):
            if (number := options.get(name)) is not None:
                at_least_one(f"--trainer.{name}", number)
        if not self.robots:
            callbacks.append(self.made["rollout"])
        try:
            return Trainer(**{**options, **more, "callbacks": callbacks})
        except ValueError as error:
            raise UserError(str(error)) from error

    def _check_start(self) -> None:
        """Check that checkpoint, weights and walks fit: Lightning asks when metrics are removed already."""
        file = self.config["ckpt_path"]
        if self.robots:
            if file:
                check_state(self.model, read_progress(file))
            return
        if file:
            checkpoint = read_progress(file) if self.command == "fit" else read_checkpoint(file)
            self.model.on_load_checkpoint(checkpoint)
        elif self.command == "fit" and (weights := self.config["weights"]):
            start_from(self.model, weights)
            print(f"starts from: {weights}")
        if self.command != "test":
            self.made["rollout"].check(self.model.generator, self.made["data"])

    def _records(self, options: dict[str, Any], more: dict[str, Any]) -> list[Callback]:
        """Claim and lock the run folder, and return the callbacks that write into it."""
        monitor, mode = self.config["monitor"], self.config["monitor_mode"]
        if not self.robots:
            monitor = None if options.get("enable_checkpointing") is False else monitor
            self.made["rollout"].check_monitor(monitor, mode)
        self.run = self.run or RunFolder.claim(self._base())
        if self.run.goes_on and not self.config["resume"] and self.run.last.is_file():
            self.config["ckpt_path"] = str(self.run.last)  # a job that Slurm runs again
        self.run.begin()
        more |= self.run.trainer_options(options.get("plugins"))
        if options.get("logger") in (None, True):
            more["logger"] = self.run.loggers(self.config.get("wandb", "off"))
        return self.run.callbacks(self.plain_config(), ["pedzoo", self.command, *self.typed], monitor, mode)

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

    def plain_config(self) -> dict[str, Any]:
        """Return the resolved configuration as plain values, without what belongs to this call only."""
        result = yaml.safe_load(self.parser.dump(self.config, skip_none=False))
        result = with_classes(result, file_path)
        return {key: value for key, value in result.items() if key not in ("ckpt_path", "resume", "config")}

    def fit(self) -> int:
        """Train, and print what to do next."""
        run, began = self.run, monotonic()
        data = {} if self.robots else {"datamodule": self.made["data"]}
        with self._stoppable():
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
        for name in () if self.robots else self.made["rollout"].scenarios:
            if success := values.get(f"rollout/{name}/success"):
                said += f", {name.partition(':')[0]} success {float(success):.2f}"
        return said

    def _next_commands(self, chosen: Path) -> list[str]:
        """Return what to type next: an evaluation of robots; a forecast, and a walk on their floor plan."""
        if self.robots:
            words = [str(chosen), "straight", "--suite", "robots", "--people", self.model.people, "--quick"]
            return [f"next: pedzoo evaluate {shlex.join(words)}"]
        code = architecture_of(self.model.generator)
        weights = shlex.quote(f"{code}:weights={chosen}" if names_code(code) else str(chosen))
        data, defaults = self.config["data"].as_dict(), inspect.signature(TrajectoryDataModule).parameters
        said = {"fold": data["fold"]} if not data.get("files") else {}
        left_out = {"fold", *setting_groups(TrajectoryDataModule)}  # the groups are of training alone
        for key, value in data.items():
            if key not in left_out and value not in (defaults[key].default, "random_future"):
                said[key] = ",".join(value) if isinstance(value, list) else value
        options = " ".join(f"--data.{key} {shlex.quote(str(value))}" for key, value in said.items())
        plan = data.get("map")
        scenario = shlex.quote(with_settings("goals", {"map": str(plan)})) if plan else "door"
        return [
            f"next: pedzoo forecast {weights} {options} --samples 20",
            f"      pedzoo rollout {weights} --scenario {scenario} --plot rollout.png",
        ]

    def measure(self) -> int:
        """Validate or test, and print the table."""
        check_outputs(json=self.config["json"])
        if not self.config["ckpt_path"] and any(True for _ in self.model.parameters()):
            raise UserError(f"pedzoo {self.command} needs --ckpt_path FILE: these weights are untrained")
        action, data = getattr(self.trainer, self.command), self.made["data"]
        result = action(self.model, datamodule=data, ckpt_path=self.config["ckpt_path"])[0]
        if (file := self.config["json"]) and self.trainer.is_global_zero:
            content = {"command": self.command, "protocol": data.protocol, "versions": versions()}
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
                    rows[where] |= self.made["rollout"].case(where.removeprefix("rollout/"))
                rows[where]["metrics"] = {}
            if not math.isnan(value):
                rows[where]["metrics"][metric] = value
        return sorted(rows.values(), key=lambda row: "case" in row)

    @contextmanager
    def _stoppable(self) -> Iterator[None]:
        """Let signals end a training, and say how to go on; for Slurm's the job is run again."""
        run = self.run
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
            frames = extract_tb(error.__traceback__)
            restores = any("checkpoint_connector" in one.filename and "restore" in one.name for one in frames)
            if restores and not isinstance(error, UserError | MisconfigurationException):
                said, file = " ".join(str(error).split()), self.config["ckpt_path"]
                raise UserError(
                    f"cannot go on from {file!r} ({type(error).__name__}: {said:.300}): is it damaged, or of "
                    "another training?"
                ) from error
            if self.trainer.is_global_zero and (how := how_to_go_on(run)):
                print(f"\nbroken off{how}", flush=True)
            raise
