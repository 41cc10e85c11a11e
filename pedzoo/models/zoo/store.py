"""Models by name: on this machine, in the user's folders, and at addresses on the net. Needs no torch.

Addresses are ``hf://OWNER/REPO[@REVISION][/ARCH.TAG]`` of the Hugging Face hub, and
``https://HOST/FOLDER/ARCH.TAG``. What was fetched stays in the cache: its model stays what it was.
"""

import os
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote, urlsplit
from urllib.request import url2pathname

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.fetch import fetch, sha256_of
from pedzoo.core.paths import CARD, WEIGHTS, cache_home, expanded, shipped
from pedzoo.core.registry import MODELS, names_code
from pedzoo.core.size_limits import LARGEST_CARD, load_yaml
from pedzoo.models.zoo.card import (
    ModelCard,
    card_files,
    check_name,
    is_name,
    name_of_files,
    read_card,
    weights_beside,
)

SOURCES = "PEDZOO_ZOO"
"""Environment variable: folders and addresses, with commas between, where names are looked up, too."""

ROBOTS = "robot_"
"""Name prefix of robot policies."""

FETCHED = "models"
"""Folder of the cache that holds what was fetched."""

_WORD = "[A-Za-z0-9][A-Za-z0-9_.-]*"
_HUB = re.compile(f"hf://({_WORD})/({_WORD})(?:@({_WORD}))?(?:/([^/]+))?")
_FRONT = re.compile(r"---\n(.*?)\n---\n", re.DOTALL)


class ModelAddress(NamedTuple):
    """Where a model is.

    Attributes:
        url: Of the folder with its files: its own folder, or one that has folders or files of several models.
        folder: Path of the files below the cache: ``ARCH.TAG.yaml`` and ``ARCH.TAG.safetensors``.
        model: ``ARCH.TAG``.
    """

    url: str
    folder: str
    model: str

    @property
    def cards(self) -> list[str]:
        """Addresses at which the card may be, in the order in which they are tried."""
        return [f"{self.url}/{self.model}.yaml", f"{self.url}/{self.model}/{CARD}", f"{self.url}/{CARD}"]

    def weights(self, card: ModelCard) -> list[str]:
        """Return the addresses at which the weights may be, in the order of `cards`."""
        return [f"{self.url}/{card.file}", f"{self.url}/{self.model}/{WEIGHTS}", f"{self.url}/{WEIGHTS}"]


def is_address(name: str) -> bool:
    """Return whether a name is an address on the net."""
    return name.startswith(("hf://", "http://", "https://"))


def place(name: str) -> ModelAddress:
    """Return where the model of an address is.

    A repository of the Hugging Face hub without the name of a model is one model's: the front matter of its
    README says which, as ``model_name``.

    Raises:
        UserError: The address is of another form, or the README cannot be had or does not say.
    """
    return _on_hub(name) if name.startswith("hf:") else _on_web(name)


def fetched_models() -> dict[str, list[str]]:
    """Return the addresses of all models whose cards were fetched, by their plain names."""
    root = cache_home() / FETCHED
    result: dict[str, list[str]] = {}
    for path in sorted(root.glob("hf/*/*/*/*.yaml")):
        owner, repo, revision = path.relative_to(root).parts[1:-1]
        result.setdefault(path.stem, []).append(f"hf://{owner}/{repo}@{revision}/{path.stem}")
    for path in sorted(root.glob("http*/*/**/*.yaml")):
        scheme, host, *folders = path.relative_to(root).parts[:-1]
        address = "/".join([unquote(host), *folders, path.stem])
        result.setdefault(path.stem, []).append(f"{scheme}://{address}")
    return {name: addresses for name, addresses in result.items() if is_name(name)}


def download(
    urls: Sequence[str], filename: str, sha256: str | None = None, size: int | None = None, hint: str = ""
) -> Path:
    """Fetch a file; only the hub gets the user's token. Arguments as of `fetch`.

    A file without a ``size`` is a card or the page of one.
    """
    limit, token = (LARGEST_CARD if size is None else None), None
    if all(url.startswith(f"{_hub()}/") for url in urls):
        from huggingface_hub import get_token  # takes 0.1 s: only downloads from the hub pay for it

        token = get_token()
    return fetch(urls, sha256, filename, hint, size, limit=limit, token=token)


def _hub() -> str:
    return os.environ.get("HF_ENDPOINT", "https://huggingface.co").rstrip("/")


def _on_hub(name: str) -> ModelAddress:
    match = _HUB.fullmatch(name)
    if not match:
        raise UserError(f"{name!r}: expected hf://OWNER/REPO, with @REVISION and /ARCH.TAG where wanted")
    owner, repo, revision, model = match.groups()
    revision = revision or "main"
    url, below = f"{_hub()}/{owner}/{repo}/resolve/{revision}", f"{FETCHED}/hf/{owner}/{repo}/{revision}"
    return ModelAddress(url, below, check_name(model) if model else _only_model(name, url, below))


def _only_model(name: str, url: str, below: str) -> str:
    text = download([f"{url}/README.md"], f"{below}/README.md").read_text("utf-8", errors="replace")
    front = _FRONT.match(text)
    try:
        said = load_yaml(front[1]) if front else None
    except UserError as error:
        raise UserError(f"{name}: the front matter of its README {error}") from error
    model = said.get("model_name") if isinstance(said, dict) else None
    if not isinstance(model, str) or not is_name(model):
        raise UserError(f"{name}: its README does not say which model it is (model_name); add /ARCH.TAG")
    return model


def _on_web(name: str) -> ModelAddress:
    try:
        parts = urlsplit(name)
    except ValueError as error:  # brackets that do not close
        raise UserError(f"{name!r}: {error}") from error
    folder, _, last = parts.path.rpartition("/")
    model = last.removesuffix(".safetensors").removesuffix(".yaml")
    if not parts.hostname or parts.username or parts.query or parts.fragment or not is_name(model):
        raise UserError(f"{name!r}: expected {parts.scheme}://HOST/FOLDER/ARCH.TAG and nothing else")
    below = f"{FETCHED}/{parts.scheme}/{quote(parts.netloc, safe='')}{folder}"
    return ModelAddress(f"{parts.scheme}://{parts.netloc}{folder}", below, model)


class ZooEntry(NamedTuple):
    """A model of the zoo or of a file: its card, and where that is.

    Attributes:
        card: Its card.
        path: Where the card lies.
        place: Where on the net it is from; None for one of this machine.
    """

    card: ModelCard
    path: Path
    place: ModelAddress | None = None


def find(name: str) -> ZooEntry | None:
    """Return the model of a name; its card is fetched where it must, its weights are not.

    Args:
        name: ``ARCH.TAG``; ``FOLDER/ARCH.TAG``, or a ``FOLDER`` of one model; an address:
            ``hf://OWNER/REPO[@REVISION][/ARCH.TAG]`` or ``https://HOST/FOLDER/ARCH.TAG``.

    Returns:
        None for what has no card: a file of weights or of code, an architecture, a word that is nothing.

    Raises:
        UserError: There is no model at that place, several have the name, or its card is refused.
    """
    check_scheme(name)
    try:
        return _found(name)
    except OSError as error:  # longer than names of files may be, a folder that others may not read
        raise UserError(f"no model {name!r:.100}: {error.strerror}") from error


def _found(name: str) -> ZooEntry | None:
    if is_address(name):
        return _fetched(name)
    if is_file(name):
        return None
    path = expanded(name)
    if path.name == name:
        if is_name(name) and (result := _by_name(name)):
            return result
        has_card = (path / CARD).is_file() or card_files(path)
        return _only_one(path) if name not in MODELS.names() and has_card else None
    if path.is_dir():
        return _only_one(path)
    if file := (there := card_files(path.parent)).get(path.name):
        return _named(file)
    raise unknown(f"model of {str(path.parent)!r}", path.name, there)


def is_file(name: str) -> bool:
    """Return whether a name is that of a file: weights, a checkpoint, or a class in a file of one's own."""
    check_scheme(name)
    return not is_address(name) and (names_code(name) or name.endswith((".ckpt", ".safetensors")))


def check_scheme(name: str) -> None:
    """Refuse the address of a file of this machine, in the place of its path.

    Raises:
        UserError: It is one.
    """
    if name.startswith("file:"):
        path = url2pathname(urlsplit(name).path) or "FOLDER/ARCH.TAG"
        raise UserError(f"{name!r}: expected a path for what is on this machine: {path}")


def weights_of(entry: ZooEntry) -> Path:
    """Return the weights of a model, checked against its card, and downloaded where they are not there.

    Raises:
        UserError: They cannot be had, or are others than the card says.
    """
    card, path = entry.card, weights_beside(entry.path, entry.card)
    if entry.place:
        # an address that a card names gets no token of the user's
        urls, bring = ([card.url], fetch) if card.url else (entry.place.weights(card), download)
        again = f"; if the model has changed there, remove {entry.path}"
        name = f"{entry.place.folder}/{card.name}.safetensors"
        return bring(urls, filename=name, sha256=card.sha256, size=card.size, hint=again)
    if not path.is_file():
        if card.url:
            return fetch(card.url, card.sha256, f"weights/{card.sha256}/{card.file}", size=card.size)
        raise UserError(f"model {card.name!r} has no weights: its card expects {str(path)!r}")
    if (result := sha256_of(path)) != card.sha256:
        remedy = "reinstall pedzoo" if shipped("checkpoints") in entry.path.parents else "get both anew"
        raise UserError(
            f"weights {str(path)!r} have sha256 {result}, but their card says {card.sha256}: {remedy}"
        )
    return path


def no_model(name: str, others: Iterable[str] = (), kind: str = "model") -> UserError:
    """Return the error for a name that no model has, with the nearest one.

    Of all the models that there are it lists those of the same family, ``sgan_goal.*``; families if it is of
    none.

    Args:
        name: What was asked for.
        others: Names that would do as well, besides those of models.
        kind: What was expected.
    """
    # robots walk among people, and are none
    known = [one for one in names() if kind != "policy" or not one.startswith(ROBOTS)]
    others = list(others)
    near = get_close_matches(name, [*others, *known], n=1)
    families = [f"{one.partition('.')[0]}." for one in (name, *near)]
    family = next(filter(None, ([one for one in known if one.startswith(stem)] for stem in families)), [])
    error = unknown(kind, name, {*others, *(family or (f"{one.partition('.')[0]}.*" for one in known))})
    if is_name(name) and shipped("checkpoints") != Path(__file__).parents[3] / "checkpoints":
        return UserError(
            f"{error}; pip brings few of our weights: set {SOURCES} to the folder checkpoints of a checkout "
            "of pedzoo, or to an address that has them"
        )
    return error


def of_robots(name: str) -> UserError:
    """Return the error for weights of robots, by the name that was given, in the place of those of people."""
    return UserError(
        f"{name!r} moves robots, and is no model of people: pedzoo evaluate {name} --suite robots, "
        "or load_robot_policy of pedzoo.policies.load"
    )


def names() -> list[str]:
    """Return the names of all models on this machine: shipped, in the user's folders, and fetched."""
    return sorted({*(name for folder in _folders() for name in card_files(folder)), *fetched_models()})


def robots() -> list[str]:
    """Return the names of those that move robots; see `pedzoo.policies.load.load_robot_policy`."""
    return [name for name in names() if name.startswith(ROBOTS)]


def _sources(address: bool) -> list[str]:
    """Return the user's sources that are addresses, or those that are folders."""
    sources = (source.strip().rstrip("/") for source in os.environ.get(SOURCES, "").split(","))
    return [source for source in sources if source and is_address(source) == address]


def _folders() -> list[Path]:
    return [shipped("checkpoints"), *(expanded(source) for source in _sources(address=False))]


def _by_name(name: str) -> ZooEntry | None:
    for folder in _folders():
        if file := card_files(folder).get(name):
            return _named(file)
    if len(stored := fetched_models().get(name, [])) > 1:
        raise UserError(f"{name!r} was fetched from {len(stored)} places, say which: {' or '.join(stored)}")
    if stored:
        return _fetched(stored[0])
    failed = [f"no folder {str(folder)!r}" for folder in _folders() if not folder.is_dir()]
    for source in _sources(address=True):
        try:
            return _fetched(f"{source}/{name}")
        except UserError as error:
            failed.append(str(error))
    if failed:
        raise UserError(f"{no_model(name)}; {SOURCES}: {'; '.join(failed)}")
    return None


def _only_one(folder: Path) -> ZooEntry:
    if (own := folder / CARD).is_file():
        return ZooEntry(read_card(own), own)
    if len(cards := card_files(folder)) != 1:
        remedy = f"say which: {', '.join(str(folder / name) for name in cards)}" if cards else "no card in it"
        raise UserError(f"folder {str(folder)!r} is not that of one model: {remedy}")
    return _named(*cards.values())


def _fetched(name: str) -> ZooEntry:
    """Return the model of an address. A card that was fetched is kept: its model stays what it was."""
    where = place(name)
    path = download(where.cards, f"{where.folder}/{where.model}.yaml")
    try:
        return _named(path)._replace(place=where)
    except UserError as error:
        path.unlink(missing_ok=True)  # perhaps a page of the server's about something else
        raise UserError(f"{name}: {error}") from error


def _named(path: Path) -> ZooEntry:
    """Return the model of a card's file, which must be named after it, or its folder must."""
    card = read_card(path)
    if card.name != name_of_files(path):
        what = "folder" if path.name == CARD else "file"
        raise UserError(
            f"model card {str(path)!r} is of {card.name!r}: the {what} must have the model's name"
        )
    return ZooEntry(card, path)
