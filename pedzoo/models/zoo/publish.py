"""Makes weights of the zoo and their model card of a training run."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from glob import escape
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.paths import CARD, WEIGHTS
from pedzoo.core.registry import names_code
from pedzoo.core.types import PRED_LEN
from pedzoo.core.untrusted import read_mapping
from pedzoo.data.recordings import find_fold, licence, provenance, together
from pedzoo.models.zoo.card import ModelCard, check_name, read_card, read_config, write_card
from pedzoo.models.zoo.loading import load, read_checkpoint, save_weights
from pedzoo.models.zoo.store import find

IN_WEIGHTS = ("config", "fold", "seed", "chosen_by")
"""Metadata of weights about their training; the rest is in the card."""

WHOLE_WALKS = ("social_walker", "social_walker_indoor", "social_walker_styled")
"""Configs that train on whole crowds from the start."""

RECORDS = ("config.yaml", "metrics.csv", "versions.json")
"""Files that `pedzoo fit` writes beside the folder of checkpoints."""

_OF_THIS_MACHINE = ("runs", "wandb", "data.root", "trainer.enable_progress_bar")
"""Options without which the command does the same elsewhere."""

_SAID_ELSEWHERE = ("config", "data.fold", "seed_everything", "monitor", "monitor_mode")
"""Options that a card has in other places."""

_FREE = frozenset({"seed_everything", "runs", "wandb", "rollout", "root", "enable_progress_bar"})
"""Keys of a configuration in which runs may differ that are the same training with other seeds."""


class RunRecord(NamedTuple):
    """The record of a run."""

    training: dict[str, Any]  # as of `pedzoo.models.zoo.card.Training`
    files: list[str] | None  # recordings of one's own that it was trained on; None for those of a fold
    versions: dict[str, str]  # it ran with
    began_with: str | None  # weights or checkpoint, as they were named; None for new ones


class Option(NamedTuple):
    """An option of a command line: its name without dashes, its value, and the words as they were typed."""

    key: str
    value: str
    words: Sequence[str]


def publish(
    checkpoint: str | Path,
    folder: str | Path,
    name: str | None = None,
    measured: list[dict[str, Any]] | None = None,
    half: bool = False,
) -> Path:
    """Write ``NAME/weights.safetensors`` and ``NAME/card.yaml`` and return the path of the latter.

    The same checkpoint gives the same weights, byte for byte.

    Args:
        checkpoint: ``RUN/checkpoints/best.ckpt`` of ``pedzoo fit``, in its run folder.
        folder: Where to write; made where it is missing.
        name: ``architecture.tag``; None for that of the config and the data (`zoo_name`).
        measured: Reports of evaluations for the card; None keeps those of a card of the same weights.
        half: As of `save_weights`.

    Raises:
        UserError: The checkpoint is none of ``pedzoo fit``'s or not in its run folder, the model is a class
            in your own file, or the name is impossible.
    """
    checkpoint = Path(checkpoint)
    content = read_checkpoint(checkpoint)
    if names_code(architecture := content["pedzoo"]["architecture"]):
        raise UserError(
            f"{str(checkpoint)!r} is of {architecture!r}, and weights never make a file of code run where "
            "they are loaded: install the class as a plugin and train it by its name"
        )
    record, model = _read_run(checkpoint, content), load(checkpoint)
    protocol, training = content["pedzoo"]["protocol"], record.training
    name = check_name(name or zoo_name(training["config"], protocol))
    data = _trained_on(record, plans="map" in model.needs)
    path = Path(folder) / name / CARD
    weights = path.with_name(WEIGHTS)
    # a damaged card raises here, before the weights change
    earlier = read_card(path) if measured is None and path.is_file() else None
    said = {key: training[key] for key in IN_WEIGHTS}
    digest = save_weights(model, weights, half, protocol=protocol, training=said)
    if measured is None:
        measured = earlier.evaluations if earlier and earlier.sha256 == digest else []
    card = ModelCard(
        name=name,
        architecture=architecture,
        sha256=digest,
        size=weights.stat().st_size,
        config=read_config(weights),
        training=training,
        data=data,
        evaluations=measured,
        versions=record.versions,
        licence=licence(data["terms"]),
    )
    write_card(card, path)
    return path


def zoo_name(config: str, protocol: Mapping[str, Any]) -> str:
    """Return what weights of a config are called: after the scene that they did not see.

    What differs from the usual follows: ``sgan.zara1_pred12``, ``sgan_goal.zara1_destination``. The usual
    clock is the benchmark's, and the true one for weights that saw every scene and for controllers. Those are
    ``.controller_open_zara1`` (``open_loop/``), ``.indoor_zara1`` and ``.styled_zara1`` (``closed_loop/``),
    without a scene if they saw all. Of ``closed_loop/mdn_walker`` on ``mixed_zara1`` comes
    ``mdn_walker.zara1``, and of its first stage ``.likelihood_zara1``.
    """
    if config.endswith("/mdn_walker"):
        parts = (
            "likelihood" * (config == "open_loop/mdn_walker"),
            protocol["fold"].removeprefix("mixed").removeprefix("_"),
        )
        return f"mdn_walker.{'_'.join(filter(None, parts)) or 'mixed'}"
    folder, _, config = config.rpartition("/")
    whole_walks = config in WHOLE_WALKS
    fold = find_fold(protocol["fold"])
    tag, whole = (fold.name, fold.whole) if fold else (protocol["fold"], False)
    if folder == "closed_loop" and config != "social_walker":
        kind = "styled" if config.endswith("_styled") else "indoor"
        tag = kind if whole else f"{kind}_{tag}"
    elif folder and not whole_walks:
        open_loop = "controller_open" if whole else f"controller_open_{tag}"
        tag = open_loop if folder == "open_loop" else f"{tag}_{folder}"
    if protocol["goal"] in ("destination", "planner") and not whole_walks:
        tag += f"_{protocol['goal']}"
    if protocol["pred_len"] != PRED_LEN:
        tag += f"_pred{protocol['pred_len']}"
    if protocol["clock"] != ("true" if folder or whole else "benchmark"):
        tag += f"_{protocol['clock']}"
    architecture = config.removesuffix("_destination").removesuffix("_indoor").removesuffix("_styled")
    return f"{architecture}.{tag}"


def _trained_on(record: RunRecord, plans: bool) -> dict[str, Any]:
    """Return the data section of a card, with those of the weights that the run began with."""
    data = provenance(record.training["fold"], record.files, plans)
    if not (weights := record.began_with):
        return data
    try:
        if entry := find(weights):
            seen = entry.card.data
        elif weights.endswith(".ckpt"):
            seen = _trained_on(_read_run(Path(weights), read_checkpoint(weights)), plans)
        else:
            seen = provenance(read_config(weights).get("protocol", {}).get("fold"), plans=plans)
        return together(data, seen)
    except UserError as error:
        raise UserError(
            f"the run began with {weights!r}, and the card has to say what they saw: {error}"
        ) from error


def _read_run(checkpoint: Path, content: dict[str, Any]) -> RunRecord:
    """Return the record of the run in whose folder a checkpoint with some content lies."""
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
    own = [one for one in options if one.key not in _SAID_ELSEWHERE and not one.key.startswith("rollout.")]
    protocol, values = content["pedzoo"]["protocol"], monitored(run, config["monitor"])
    training = {
        "config": config_name,
        "fold": protocol["fold"],
        "clock": protocol["clock"],
        "goal": content["pedzoo"]["goal"] or protocol["goal"],
        "seed": int(config["seed_everything"]),
        "seeds": _best_by_seed(run, config, values),
        "chosen_by": config["monitor"],
        "value": values.get(content["epoch"]),
        "step": content["global_step"],
        "epoch": content["epoch"],
        "command": [*command[:2], *(word for option in options for word in option.words)],
        "overrides": {option.key: option.value for option in own},
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


def _best_by_seed(run: Path, config: dict[str, Any], own: dict[int, float]) -> dict[int, float]:
    """Return the best validation value of a run, and of those beside it that differ in their seed alone."""
    values_of = {}
    family = re.sub(r"-seed\d+(-\d+)?$", "", run.name)
    for other in sorted(run.parent.glob(f"{escape(family)}-seed*")):
        if other == run or not all((other / name).is_file() for name in RECORDS):
            continue
        theirs, values = _config(other), monitored(other, config["monitor"])
        # a run leaves no mark when it ends: one is finished that came as far as this one
        if _agree(theirs, config) and max(values, default=0) >= max(own, default=0):
            values_of[int(theirs["seed_everything"])] = values
    values_of[int(config["seed_everything"])] = own
    choose = max if config.get("monitor_mode") == "max" else min
    return {seed: choose(values.values()) for seed, values in sorted(values_of.items()) if values}


def _agree(one: Any, other: Any) -> bool:
    """Return whether two configurations agree wherever both have a value."""
    if isinstance(one, dict) and isinstance(other, dict):
        return all(_agree(one[key], other[key]) for key in one.keys() & other.keys() - _FREE)
    return one == other
