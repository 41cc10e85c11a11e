"""The record of a checkpoint in the folder of a training run."""

import csv
import json
import re
from collections.abc import Sequence
from glob import escape
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import read_mapping

RECORDS = ("config.yaml", "metrics.csv", "versions.json")
"""Files that `pedzoo fit` writes beside the folder of checkpoints."""

_OF_THIS_MACHINE = ("runs", "wandb", "data.root", "trainer.enable_progress_bar")
"""Options without which the command does the same elsewhere."""

_SAID_ELSEWHERE = ("config", "data.fold", "seed_everything", "monitor", "monitor_mode")
"""Options that a card has in other places."""

_FREE = frozenset({"seed_everything", "runs", "wandb", "rollout", "root", "enable_progress_bar"})
"""Keys of a configuration in which runs may differ that are the same training with other seeds."""


class RunRecord(NamedTuple):
    """The record of a run.

    Attributes:
        training: As a model card has it, see `pedzoo.models.zoo.card.Training`.
        files: Recordings of one's own that it was trained on; None for those of a fold.
        versions: Versions it ran with.
        began_with: Weights or checkpoint that it began with, as they were named; None for new ones.
    """

    training: dict[str, Any]
    files: list[str] | None = None
    versions: dict[str, str] | None = None
    began_with: str | None = None


def read_run(checkpoint: Path, content: dict[str, Any]) -> RunRecord:
    """Return the record of a checkpoint's run, given the checkpoint's content.

    Raises:
        UserError: It does not lie in the folder of a run, or the records there are damaged.
    """
    run = checkpoint.resolve().parent.parent
    if missing := [name for name in RECORDS if not (run / name).is_file()]:
        raise UserError(
            f"checkpoint {str(checkpoint)!r} is not in the folder of its run: {str(run)!r} has no "
            f"{' and no '.join(missing)}; expected RUN/checkpoints/best.ckpt as pedzoo fit leaves it"
        )
    try:
        return _record(run, content)
    except (LookupError, TypeError, ValueError, AttributeError, csv.Error) as error:
        raise UserError(
            f"the records of the run {str(run)!r} are damaged ({error!r:.200}): expected those of pedzoo fit"
        ) from error


def _record(run: Path, content: dict[str, Any]) -> RunRecord:
    config = _config(run)
    # a resumed run keeps the records of how it began
    begun = run / "before-resume-1" / "versions.json"
    command = json.loads((begun if begun.is_file() else run / "versions.json").read_text())["command"]
    config_name = run.parent.name.replace(".", "/")  # `pedzoo.train.run.run_name`
    options = [
        Option("config", config_name, ["--config", config_name])
        if option.value.endswith(f"configs/{config_name}.yaml")
        else option
        for option in options_of(command)
        if option.key not in _OF_THIS_MACHINE
    ]
    protocol, monitor = content["pedzoo"]["protocol"], config["monitor"]
    seed, values = int(config["seed_everything"]), monitored(run, monitor)
    training = {
        "config": config_name,
        "fold": protocol["fold"],
        "clock": protocol["clock"],
        "goal": content["pedzoo"]["goal"] or protocol["goal"],
        "seed": seed,
        "seeds": dict(sorted((_other_seeds(run, config, values) | _best(seed, values, config)).items())),
        "chosen_by": monitor,
        "value": values.get(content["epoch"]),
        "step": content["global_step"],
        "epoch": content["epoch"],
        "command": [*command[:2], *(word for option in options for word in option.words)],
        "overrides": {
            option.key: option.value
            for option in options
            if option.key not in _SAID_ELSEWHERE and not option.key.startswith("rollout.")
        },
    }
    made_with = json.loads((run / "versions.json").read_text())["versions"]
    went_on = next((option.value for option in options if option.key == "ckpt_path"), None)
    return RunRecord(training, config["data"].get("files"), made_with, config.get("weights") or went_on)


def _config(run: Path) -> dict[str, Any]:
    return read_mapping(run / "config.yaml", "config", "one that pedzoo fit wrote")


def monitored(run: Path, metric: str) -> dict[int, float]:
    """Return a validation metric by epoch, also of the time before the run was resumed."""
    result: dict[int, float] = {}
    for file in (*run.glob("before-resume-*/metrics.csv"), run / "metrics.csv"):
        with file.open() as lines:
            rows = csv.DictReader(lines)
            result |= {int(row["epoch"]): float(row[metric]) for row in rows if row.get(metric)}
    return result


class Option(NamedTuple):
    """An option of a command line: its name without dashes, its value, and the words as they were typed."""

    key: str
    value: str
    words: Sequence[str]


def options_of(command: Sequence[str]) -> list[Option]:
    """Return the options of a command line, ``--key value`` or ``--key=value``, in their order."""
    starts = [i for i, word in enumerate(command) if word.startswith("--") or word == "-c"]
    result = []
    for start, end in pairwise([*starts, len(command)]):
        words = command[start:end]
        key, equals, value = words[0].lstrip("-").partition("=")
        value = value if equals else " ".join(words[1:]) or "true"
        result.append(Option("config" if key == "c" else key, value, words))
    return result


def _other_seeds(run: Path, config: dict[str, Any], own: dict[int, float]) -> dict[int, float]:
    """Return the best validation value of every run beside this one that differs in its seed alone.

    A run leaves no mark when it ends: one is finished that came as far as this one, by its ``own`` values.
    """
    result: dict[int, float] = {}
    family = re.sub(r"-seed\d+(-\d+)?$", "", run.name)
    for other in sorted(run.parent.glob(f"{escape(family)}-seed*")):
        if other == run or not all((other / name).is_file() for name in RECORDS):
            continue
        theirs = _config(other)
        values = monitored(other, config["monitor"])
        if _agree(theirs, config) and max(values, default=0) >= max(own, default=0):
            result |= _best(int(theirs["seed_everything"]), values, config)
    return result


def _best(seed: int, values: dict[int, float], config: dict[str, Any]) -> dict[int, float]:
    choose = max if config.get("monitor_mode") == "max" else min
    return {seed: choose(values.values())} if values else {}


def _agree(one: Any, other: Any) -> bool:
    """Return whether two configurations agree wherever both have a value."""
    if isinstance(one, dict) and isinstance(other, dict):
        return all(_agree(one[key], other[key]) for key in one.keys() & other.keys() - _FREE)
    return one == other
