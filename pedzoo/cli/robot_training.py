"""``pedzoo fit`` for robots: LightningCLI without recordings, with the run folders of all trainings."""

import shlex
from pathlib import Path
from time import monotonic
from typing import Any, cast

from lightning.pytorch.cli import LightningArgumentParser

from pedzoo.cli.parsing import parse
from pedzoo.cli.progress import duration
from pedzoo.cli.starting import ExpandedCommand, resumed
from pedzoo.cli.suggestions import given
from pedzoo.cli.training_parser import ConfigParser, ProgressBar, RunCLI, Signals, check_seed, result_line
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.train.modules.module import check_state, read_progress
from pedzoo.train.robots.ppo import RobotPPO
from pedzoo.train.run import RunFolder, run_name
from pedzoo.train.run_settings import check_unchanged, tell_changes

PLACE = ("scenarios", "people", "robot", "decision_dt")
"""Settings of a robot's training that its card has: where it was trained, among whom, and in which body."""


def trains_robots(argv: list[str]) -> bool:
    """Return whether a command line is for this: its config, or that of the run it resumes, says so."""
    resumed = given(argv, "--resume")
    name = str(Path(resumed) / "config.yaml") if resumed else given(argv, "--config") or given(argv, "-c")
    try:
        settings = load_config(name) if name else {}
    except UserError:
        return False  # the training of forecasters says what is wrong with it
    model = settings.get("model")
    return isinstance(model, dict) and str(model.get("class_path")).startswith("pedzoo.train.robots.")


class RobotTrainingCLI(RunCLI):
    """Its trainer writes into a run folder, ``runs/CONFIG/SCENARIO-seedN``."""

    def __init__(self, typed: list[str], about: str, example: str) -> None:
        """Parse the command line as it was ``typed``, and build trainer and model."""
        folder = given(typed, "--resume")
        self.typed, self.start = typed, resumed(typed, folder) if folder else ExpandedCommand(typed)
        self.run = self.start.run
        super().__init__(
            RobotPPO,
            args=self.start.argv,
            prog="pedzoo fit",
            usage=f"pedzoo fit --config robot/ppo [...]\nexample: {example}",
            description=about,
        )

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the options that are pedzoo's own."""
        for name, kind, default, said in (
            ("runs", str, "runs", "Folder of all run folders."),
            ("ckpt_path", str | None, None, "Start from this checkpoint."),
            ("resume", str | None, None, "Continue the run in this folder."),
            ("monitor", str, "val/return", "The metric in which best.ckpt is best."),
            ("monitor_mode", str, "max", "Which of its values is best: min or max."),
        ):
            parser.add_argument(f"--{name}", type=kind, default=default, help=said)

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        """Parse, with errors in one line."""
        cast("ConfigParser", parser).start = self.start
        self.config = parse(parser, args, [("model", RobotPPO)])
        check_seed(self.config["seed_everything"])
        if self.run:
            check_unchanged(self.run.path, self.plain_config(), "model.init_args", PLACE, RobotPPO)
            tell_changes(self.run.path, self.plain_config())

    def instantiate_trainer(self, **kwargs: Any) -> Any:
        """Build the trainer with the run folder's loggers and checkpoints."""
        if file := self.config["ckpt_path"]:
            check_state(self.model, read_progress(file))
        self.run = self.run or RunFolder.claim(self._base())
        self.go_on_from_last(self.run)
        self.run.begin()
        options = self.config_init["trainer"]
        callbacks = self.run.callbacks(
            self.plain_config(),
            ["pedzoo", "fit", *self.typed],
            self.config["monitor"],
            self.config["monitor_mode"],
        )
        if options.get("enable_progress_bar") is not False:
            callbacks.append(ProgressBar())
        callbacks.append(Signals())
        kwargs |= self.run.trainer_options(options.get("plugins"))
        return super().instantiate_trainer(callbacks=callbacks, logger=self.run.loggers("off"), **kwargs)

    def fit(self) -> int:
        """Train, and print what to do next."""
        run, began = self.run, monotonic()
        assert run
        with self.stoppable(run):
            self.trainer.fit(self.model, ckpt_path=self.config["ckpt_path"])
        chosen = run.best if run.best.is_file() else run.last
        said, values = result_line(run, chosen, self.config["monitor"])
        if success := values.get("val/success"):
            said += f", success {float(success):.2f}"
        print(f"\n{said}, {duration(monotonic() - began)}")
        words = [str(chosen), "straight", "--suite", "robots", "--people", self.model.people, "--quick"]
        print(f"next: pedzoo evaluate {shlex.join(words)}")
        return 0

    def _base(self) -> Path:
        config = self.config
        name = run_name(Path(str(config["config"][-1])))
        scenario = config["model"]["init_args"]["scenarios"][0].partition(":")[0]
        return Path(config["runs"]) / name / f"{scenario}-seed{int(config['seed_everything'])}"
