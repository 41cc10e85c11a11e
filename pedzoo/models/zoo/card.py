"""Model cards: what weights are, what they were trained on and how well they do. Read without torch.

A model is a folder of its name, with its card, ``card.yaml``, and its weights, ``weights.safetensors``.
"""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import yaml
from safetensors import SafetensorError, safe_open
from typing_extensions import TypedDict

from pedzoo.core.errors import UserError
from pedzoo.core.paths import CARD, WEIGHTS, write_atomically
from pedzoo.core.untrusted import (
    LARGEST_CARD,
    LARGEST_WEIGHTS,
    check,
    check_limit,
    check_plain,
    load_yaml,
    read_text,
    said,
)

_FORMS = {
    "name": (r"[A-Za-z0-9_]+\.[A-Za-z0-9_-]+", "ARCHITECTURE.TAG of letters, digits, _ and -"),
    "file": (re.escape(WEIGHTS), f"{WEIGHTS}, beside the card, and no path"),
    "sha256": ("[0-9a-f]{64}", "64 digits of 0-9 and a-f"),
    "url": (r"https?://\S+", "an address at http:// or https://"),
}
"""Patterns of texts on a card, and how messages name them."""


class Config(msgspec.Struct, forbid_unknown_fields=True):
    """Keys of a config in the metadata of weights; the first two are all that a model is built from."""

    architecture: str
    init: dict[str, Any]
    goal: str | None = None
    protocol: dict[str, Any] = {}
    training: dict[str, Any] = {}


class Training(msgspec.Struct, forbid_unknown_fields=True):
    """Which run made the weights; None stands for what is not known any more.

    ``seeds`` has the monitored validation value of each seed, by which this one was chosen; ``value``,
    ``step`` and ``epoch`` are those of the checkpoint; ``overrides`` are options beyond the config.
    """

    config: str | None
    fold: str | None
    clock: str | None
    goal: str | None
    seed: int | None
    seeds: dict[int, float] | None
    chosen_by: str | None
    value: float | None
    step: int | None
    epoch: int | None
    command: list | None
    overrides: dict | None


class Data(msgspec.Struct, forbid_unknown_fields=True):
    """What the weights were trained on, and on whose terms."""

    recordings: list[str]
    source: str
    terms: str
    citation: str


class Row(TypedDict):
    """A row of an evaluation: a mean with its 95 % interval by metric. It may have more keys."""

    name: str
    case: dict[str, Any]
    n: int
    metrics: dict[str, float]
    ci95: dict[str, tuple[float, float]]


class Evaluation(TypedDict):
    """A report of ``pedzoo forecast`` or ``pedzoo evaluate``, of this model's rows. It may have more keys."""

    command: str
    protocol: dict[str, Any]
    seeds: list
    versions: dict[str, Any]
    rows: list[Row]


_PARTS = {"training": Training, "data": Data, "evaluations": list[Evaluation]}


class ModelCard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known about a file of weights. Raises UserError: it contradicts itself."""

    name: str  # zoo name, ``architecture.tag``
    architecture: str  # registered name of the model's class
    sha256: str  # of the weights, of ``size`` bytes
    size: int
    config: dict[str, Any]  # as in the metadata of the weights: a `Config`
    training: dict[str, Any]  # which run made them: a `Training`
    data: dict[str, Any]  # what it was trained on: a `Data`
    evaluations: list[dict[str, Any]]  # what was measured: `Evaluation`s
    versions: dict[str, str]  # of what it was trained with
    licence: str  # of the weights
    file: str = WEIGHTS
    url: str | None = None  # where to download them if they are not there; None: beside the place of the card

    def __post_init__(self) -> None:
        """Check everything that others rely on."""
        check_plain(msgspec.structs.asdict(self))
        check(self.config, Config, "config")
        for key, form in _PARTS.items():
            check(getattr(self, key), form, key)
        for key, (pattern, expected) in _FORMS.items():
            value = getattr(self, key)
            if value is not None and not re.fullmatch(pattern, value):
                raise UserError(f"{key} {value!r}: expected {expected}")
        check_limit(self.size, LARGEST_WEIGHTS, "size of weights", "bytes", "is the card right?")
        if self.architecture != (its := self.config["architecture"]):
            raise UserError(f"architecture {self.architecture!r}: its config is of {its!r}")


def is_name(text: str) -> bool:
    """Return whether a text can be a zoo name, ``architecture.tag``."""
    return bool(re.fullmatch(_FORMS["name"][0], text))


def check_name(name: str) -> str:
    """Return a zoo name as it is. Raises UserError: it is none."""
    if not is_name(name):
        raise UserError(f"name {name!r}: expected {_FORMS['name'][1]}")
    return name


def read_card(path: str | Path) -> ModelCard:
    """Return the card in a file. Raises UserError: no such file, no YAML, or no card."""
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no model card at {str(path)!r}")
    try:
        values = load_yaml(read_text(path, LARGEST_CARD))
        check_plain(values)
        return msgspec.convert(values, ModelCard)
    except (UserError, msgspec.ValidationError) as error:
        why = said(error) if isinstance(error, msgspec.ValidationError) else error
        raise UserError(f"model card {str(path)!r}: {why}") from error


def write_card(card: ModelCard, path: str | Path) -> None:
    """Write a card, whole or not at all; the same card gives the same bytes."""
    values = msgspec.to_builtins(card)  # new values: YAML writes a reference where one stands twice
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=110)
    write_atomically(Path(path), text.encode())


def card_files(folder: Path) -> dict[str, Path]:
    """Return the cards of the models in a folder by name, in alphabetical order."""
    files = {path.parent.name: path for path in folder.glob(f"*/{CARD}")}
    return {name: files[name] for name in sorted(files) if is_name(name)}


def read_config(path: str | Path) -> dict[str, Any]:
    """Return the config in the metadata of a file of weights; errors as `read_file`."""
    return read_file(path, tensors=False)[0]


def read_file(path: str | Path, tensors: bool = True) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return config and, if wanted, ``tensors`` of a file of weights. Raises UserError: it is damaged."""
    what = f"weights {str(path)!r}"
    if not Path(path).is_file():
        raise UserError(f"no weights at {str(path)!r}")
    try:
        with safe_open(path, "pt" if tensors else "np") as file:
            metadata = file.metadata() or {}
            state = {key: file.get_tensor(key) for key in file.keys()} if tensors else {}
    except SafetensorError as error:
        raise UserError(f"{what} cannot be read ({error}): is the file cut off?") from error
    if "config" not in metadata:
        raise UserError(f"{what} have no pedzoo config in their metadata: not a file of this zoo")
    try:
        config = json.loads(metadata["config"])
        check_plain(config)
        check(config, Config, "config")
    except (ValueError, RecursionError) as error:
        raise UserError(f"{what} have a pedzoo config that cannot be read: {error}") from error
    return config, state
