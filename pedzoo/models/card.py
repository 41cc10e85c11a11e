"""Model cards: what a file of weights is, what it was trained on and how well it does. Read without torch."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from pedzoo.errors import UserError
from pedzoo.models.header import check_config
from pedzoo.models.keys import NOTHING, Kinds, check_keys, check_numbers, check_plain
from pedzoo.paths import write_whole

_FILE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*\.safetensors")
_LARGEST = 2_000_000
"""Bytes of a card."""

_DEEPEST = 20
"""Levels of a card; libyaml does not survive a hundred thousand."""

TRAINING: Kinds = {
    "config": (str, NOTHING),
    "fold": (str, NOTHING),
    "clock": (str, NOTHING),
    "goal": (str, NOTHING),
    "seed": (int, NOTHING),
    "seeds": (dict, NOTHING),
    "chosen_by": (str, NOTHING),
    "value": (float, int, NOTHING),
    "step": (int, NOTHING),
    "epoch": (int, NOTHING),
    "command": (list, NOTHING),
    "overrides": (dict, NOTHING),
}
"""Keys of a card's ``training``; None stands for what is not known any more."""

DATA: Kinds = {"recordings": (list,), "source": (str,), "terms": (str,), "citation": (str,)}
EVALUATION: Kinds = {
    "command": (str,),
    "protocol": (dict,),
    "seeds": (list,),
    "versions": (dict,),
    "rows": (list,),
}
_ROW: Kinds = {"name": (str,), "case": (dict,), "n": (int,), "metrics": (dict,), "ci95": (dict,)}

_NO_YAML = (yaml.YAMLError, ValueError, LookupError, AttributeError)
"""What reading values ends in that are not what they say they are, such as the 99th of a month."""


@dataclass(frozen=True)
class ModelCard:
    """What is known about a file of weights. A card that contradicts itself cannot be made.

    Attributes:
        name: Zoo name, ``architecture.tag``.
        architecture: Registered name of the model's class.
        sha256: Of the weights.
        size: Bytes of the weights.
        config: As in the metadata of the weights: with it the model is built.
        training: Which run made them (`TRAINING`): config, fold, clock, goal protocol and seed; ``seeds``
            with the monitored validation value of each, by which this one was chosen; that value, step and
            epoch of the checkpoint; the command, and its options beyond the config.
        data: What it was trained on (`DATA`), on whose terms.
        evaluations: Reports of ``pedzoo forecast`` and ``pedzoo evaluate``, of this model's rows.
        versions: Of what it was trained with.
        licence: Of the weights.
        file: Name of the weights beside the card.
        url: Where to download them if they are not there; None: beside the place of the card.

    Raises:
        UserError: A value that cannot be.
    """

    name: str
    architecture: str
    sha256: str
    size: int
    config: dict[str, Any]
    training: dict[str, Any]
    data: dict[str, Any]
    evaluations: list[dict[str, Any]]
    versions: dict[str, str]
    licence: str
    file: str
    url: str | None

    def __post_init__(self) -> None:
        """Check everything that others rely on."""
        check_plain(vars(self))
        check_keys(vars(self), _CARD)
        check_name(self.name)
        if not _FILE.fullmatch(self.file):
            raise UserError(
                f"file {self.file!r}: expected the plain name of a .safetensors file beside the card, no path"
            )
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise UserError(f"sha256 {self.sha256!r}: expected 64 digits of 0-9 and a-f")
        if self.url is not None and not re.fullmatch(r"https?://\S+", self.url):
            raise UserError(f"url {self.url!r}: expected an address at http:// or https://")
        check_config(self.config)
        if self.architecture != self.config["architecture"]:
            raise UserError(
                f"architecture {self.architecture!r}: its config is of {self.config['architecture']!r}"
            )
        check_keys(self.training, TRAINING, "training")
        check_keys(self.data, DATA, "data")
        if not all(isinstance(name, str) for name in self.data["recordings"]):
            raise UserError(f"data recordings are {self.data['recordings']!r:.60}, expected names")
        check_numbers(self.training["seeds"] or {}, "training seeds")
        for report in self.evaluations:
            check_keys(report, EVALUATION, "evaluations", more=True)
            for row in report["rows"]:
                check_keys(row, _ROW, "evaluations rows", more=True)
                check_numbers(row["metrics"], "evaluations rows metrics")
                check_numbers(row["ci95"], "evaluations rows ci95", ends=2)


_CARD: Kinds = {
    "name": (str,),
    "architecture": (str,),
    "sha256": (str,),
    "size": (int,),
    "config": (dict,),
    "training": (dict,),
    "data": (dict,),
    "evaluations": (list,),
    "versions": (dict,),
    "licence": (str,),
    "file": (str,),
    "url": (str, NOTHING),
}


def check_name(name: str) -> str:
    """Return a zoo name as it is.

    Raises:
        UserError: It is none.
    """
    if not is_name(name):
        raise UserError(f"name {name!r}: expected ARCHITECTURE.TAG of letters, digits, _ and -")
    return name


def is_name(text: str) -> bool:
    """Return whether a text can be a zoo name, ``architecture.tag``."""
    return bool(re.fullmatch(r"[A-Za-z0-9_]+\.[A-Za-z0-9_-]+", text))


def read_card(path: str | Path) -> ModelCard:
    """Return the card in a file.

    Raises:
        UserError: No such file, no YAML, or no card: unknown or missing keys, wrong types, or a name of the
            weights that leads out of the card's folder.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no model card at {str(path)!r}")
    if path.stat().st_size > _LARGEST:
        raise UserError(f"{str(path)!r} is no model card: larger than {_LARGEST // 1_000_000} MB")
    try:
        found = load_yaml(path.read_bytes())
        check_keys(found, _CARD)
        return ModelCard(**found)
    except UserError as error:
        raise UserError(f"model card {str(path)!r}: {error}") from error


def load_yaml(text: bytes | str) -> Any:
    """Return what YAML of somebody else's says, without the ways in which a small text becomes endless.

    Raises:
        UserError: It is no YAML, has values that are not of the kind they say, references or many levels.
    """
    try:
        return _loaded(text)
    except UserError:
        raise
    except _NO_YAML as error:
        raise UserError(f"cannot be read: {error}") from error


def _loaded(text: bytes | str) -> Any:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's: `pedzoo models` reads all cards
    depth = 0
    for event in yaml.parse(text, loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST or isinstance(event, yaml.AliasEvent):
            raise UserError(f"expected no references (*) and at most {_DEEPEST} levels of values")
    return yaml.load(text, loader)


def write_card(card: ModelCard, path: str | Path) -> None:
    """Write a card, whole or not at all; the same card gives the same bytes."""
    text = yaml.dump(asdict(card), Dumper=_Plain, sort_keys=False, allow_unicode=True, width=110)
    write_whole(Path(path), text.encode())


class _Plain(yaml.SafeDumper):
    """Writes a list out wherever it stands, never a reference to another place."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
