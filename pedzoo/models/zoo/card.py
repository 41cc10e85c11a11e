"""Model cards: what a file of weights is, what it was trained on and how well it does. Read without torch."""

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import yaml
from typing_extensions import TypedDict

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically
from pedzoo.core.size_limits import LARGEST_CARD, LARGEST_WEIGHTS, check_limit, load_yaml, read_text
from pedzoo.models.zoo.file_header import Config
from pedzoo.models.zoo.typed_fields import check, check_keys, check_plain

_FILE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*\.safetensors")


class Training(TypedDict, closed=True):
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


class Data(TypedDict, closed=True):
    """What the weights were trained on, and on whose terms."""

    recordings: list
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


@dataclass(frozen=True)
class ModelCard:
    """What is known about a file of weights. A card that contradicts itself cannot be made.

    Attributes:
        name: Zoo name, ``architecture.tag``.
        architecture: Registered name of the model's class.
        sha256: Of the weights.
        size: Bytes of the weights.
        config: As in the metadata of the weights: with it the model is built.
        training: Which run made them.
        data: What it was trained on.
        evaluations: What was measured.
        versions: Of what it was trained with.
        licence: Of the weights.
        file: Name of the weights beside ``NAME.yaml``. Beside ``card.yaml`` they are ``weights.safetensors``.
        url: Where to download them if they are not there; None: beside the place of the card.

    Raises:
        UserError: A value that cannot be.
    """

    name: str
    architecture: str
    sha256: str
    size: int
    config: Annotated[dict[str, Any], Config]
    training: Annotated[dict[str, Any], Training]
    data: Annotated[dict[str, Any], Data]
    evaluations: Annotated[list[dict[str, Any]], list[Evaluation]]
    versions: dict[str, str]
    licence: str
    file: str
    url: str | None

    def __post_init__(self) -> None:
        """Check everything that others rely on."""
        check_plain(vars(self))
        check(vars(self), ModelCard)
        check_name(self.name)
        if not _FILE.fullmatch(self.file):
            raise UserError(
                f"file {self.file!r}: expected the plain name of a .safetensors file beside the card, no path"
            )
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise UserError(f"sha256 {self.sha256!r}: expected 64 digits of 0-9 and a-f")
        check_limit(self.size, LARGEST_WEIGHTS, "size of weights", "bytes", "is the card right?")
        if self.url is not None and not re.fullmatch(r"https?://\S+", self.url):
            raise UserError(f"url {self.url!r}: expected an address at http:// or https://")
        if self.architecture != self.config["architecture"]:
            raise UserError(
                f"architecture {self.architecture!r}: its config is of {self.config['architecture']!r}"
            )
        if not all(isinstance(name, str) for name in self.data["recordings"]):
            raise UserError(f"data recordings are {self.data['recordings']!r:.60}, expected names")


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
    try:
        result = load_yaml(read_text(path, LARGEST_CARD))
        check_keys(result, ModelCard)
        return ModelCard(**result)
    except UserError as error:
        raise UserError(f"model card {str(path)!r}: {error}") from error


def write_card(card: ModelCard, path: str | Path) -> None:
    """Write a card, whole or not at all; the same card gives the same bytes."""
    text = yaml.dump(asdict(card), Dumper=_Plain, sort_keys=False, allow_unicode=True, width=110)
    write_atomically(Path(path), text.encode())


class _Plain(yaml.SafeDumper):
    """Writes a list out wherever it stands, never a reference to another place."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
