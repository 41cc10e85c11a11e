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

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.fetch import fetch
from pedzoo.core.paths import CARD, WEIGHTS, cache_home, expanded, sha256_of, shipped
from pedzoo.core.registry import MODELS, names_code
from pedzoo.core.untrusted import LARGEST_CARD, load_yaml
from pedzoo.models.zoo.card import ModelCard, card_files, check_name, is_name, read_card

SOURCES = "PEDZOO_ZOO"
"""Environment variable: folders and addresses, with commas between, where names are looked up, too."""

ROBOTS = "robot_"  # name prefix of robot policies
FETCHED = "models"  # folder of the cache that holds what was fetched

_WORD = "[A-Za-z0-9][A-Za-z0-9_.-]*"
_HUB = re.compile(f"hf://({_WORD})/({_WORD})(?:@({_WORD}))?(?:/([^/]+))?")
_FRONT = re.compile(r"---\n(.*?)\n---\n", re.DOTALL)


class ZooEntry(NamedTuple):
    """A model of the zoo: its card, where that lies, and the addresses at which its folder may be, if any."""

    card: ModelCard
    path: Path
    folders: tuple[str, ...] = ()


def is_address(name: str) -> bool:
    """Return whether a name is an address on the net."""
    return name.startswith(("hf://", "http://", "https://"))


def is_file(name: str) -> bool:
    """Return whether a name is that of a file: weights, a checkpoint, or a class in a file of one's own.

    Raises:
        UserError: It is the address of a file of this machine, and its path would do.
    """
    if name.startswith("file:"):
        from urllib.request import url2pathname  # imports a client of the web

        path = url2pathname(urlsplit(name).path) or "FOLDER/ARCH.TAG"
        raise UserError(f"{name!r}: expected a path for what is on this machine: {path}")
    return not is_address(name) and (names_code(name) or name.endswith((".ckpt", ".safetensors")))


def find(name: str) -> ZooEntry | None:
    """Return the model of a name; its card is fetched where it must, its weights are not.

    Args:
        name: ``ARCH.TAG``; ``FOLDER/ARCH.TAG``, or a ``FOLDER`` of one model; or an address.

    Returns:
        None for what has no card: a file of weights or of code, an architecture, a word that is nothing.

    Raises:
        UserError: There is no model at that place, several have the name, or its card is refused.
    """
    if is_file(name):
        return None
    try:
        if is_address(name):
            return _fetched(name)
        path = expanded(name)
        if path.name == name:
            if is_name(name) and (result := _by_name(name)):
                return result
            if name in MODELS.names() or not ((path / CARD).is_file() or card_files(path)):
                return None
        if not path.is_dir():
            raise unknown(f"model of {str(path.parent)!r}", path.name, card_files(path.parent))
        if (path / CARD).is_file():
            return ZooEntry(read_card(path / CARD), path / CARD)
        if len(cards := card_files(path)) != 1:
            which = f"say which: {', '.join(str(path / one) for one in cards)}" if cards else "no card in it"
            raise UserError(f"folder {str(path)!r} is not that of one model: {which}")
        return _named(*cards.values())
    except OSError as error:  # longer than names of files may be, a folder that others may not read
        raise UserError(f"no model {name!r:.100}: {error.strerror}") from error


def _by_name(name: str) -> ZooEntry | None:
    folders, addresses = _sources()
    for folder in folders:
        if (path := folder / name / CARD).is_file():
            return _named(path)
    if len(stored := _addresses_fetched().get(name, [])) > 1:
        raise UserError(f"{name!r} was fetched from {len(stored)} places, say which: {' or '.join(stored)}")
    if stored:
        return _fetched(stored[0])
    failed = [f"no folder {str(folder)!r}" for folder in folders if not folder.is_dir()]
    for address in addresses:
        try:
            return _fetched(f"{address}/{name}")
        except UserError as error:
            failed.append(str(error))
    if failed:
        raise UserError(f"{no_model(name)}; {SOURCES}: {'; '.join(failed)}")
    return None


def _named(path: Path) -> ZooEntry:
    """Return the model of a card in a folder that must have its name."""
    card = read_card(path)
    if card.name != path.parent.name:
        raise UserError(
            f"model card {str(path)!r} is of {card.name!r}: the folder must have the model's name"
        )
    return ZooEntry(card, path)


def _fetched(name: str) -> ZooEntry:
    """Return the model of an address. A card that was fetched is kept: its model stays what it was."""
    url, place = _on_hub(name) if name.startswith("hf:") else _on_web(name)
    # the model's own folder, or one that is this model's alone, as a repository of the hub
    folders = f"{url}/{Path(place).name}", url
    path = download([f"{folder}/{CARD}" for folder in folders], f"{FETCHED}/{place}/{CARD}")
    try:
        return _named(path)._replace(folders=folders)
    except UserError as error:
        path.unlink(missing_ok=True)  # perhaps a page of the server's about something else
        raise UserError(f"{name}: {error}") from error


def _on_hub(name: str) -> tuple[str, str]:
    """Return the address of a model on the hub, and its folder in the cache, which has its name."""
    match = _HUB.fullmatch(name)
    if not match:
        raise UserError(f"{name!r}: expected hf://OWNER/REPO, with @REVISION and /ARCH.TAG where wanted")
    owner, repo, revision, model = match.groups(default="")
    url = f"{_hub()}/{owner}/{repo}/resolve/{revision or 'main'}"
    place = f"hf/{owner}/{repo}/{revision or 'main'}"
    if model:
        return url, f"{place}/{check_name(model)}"
    # the repository is one model's: the front matter of its README says which
    page = download([f"{url}/README.md"], f"{FETCHED}/{place}/README.md")
    front = _FRONT.match(page.read_text("utf-8", errors="replace"))
    try:
        said = load_yaml(front[1]) if front else None
    except UserError as error:
        raise UserError(f"{name}: the front matter of its README {error}") from error
    model = said.get("model_name") if isinstance(said, dict) else None
    if not isinstance(model, str) or not is_name(model):
        raise UserError(f"{name}: its README does not say which model it is (model_name); add /ARCH.TAG")
    return url, f"{place}/{model}"


def _on_web(name: str) -> tuple[str, str]:
    """Return the same of a model on the web."""
    try:
        parts = urlsplit(name)
    except ValueError as error:  # brackets that do not close
        raise UserError(f"{name!r}: {error}") from error
    folder, _, model = parts.path.rpartition("/")
    if not parts.hostname or parts.username or parts.query or parts.fragment or not is_name(model):
        raise UserError(f"{name!r}: expected {parts.scheme}://HOST/FOLDER/ARCH.TAG and nothing else")
    place = f"{parts.scheme}/{quote(parts.netloc, safe='')}{folder}/{model}"
    return f"{parts.scheme}://{parts.netloc}{folder}", place


def _addresses_fetched() -> dict[str, list[str]]:
    """Return the addresses of all models whose cards were fetched, by their plain names."""
    root, result = cache_home() / FETCHED, {}
    for path in sorted(root.glob(f"*/*/**/{CARD}")):
        kind, *inside, model = path.relative_to(root).parts[:-1]
        if kind == "hf" and len(inside) == 3:
            address = "hf://{}/{}@{}/{}".format(*inside, model)
        elif kind in ("http", "https") and inside:
            address = "/".join((f"{kind}://{unquote(inside[0])}", *inside[1:], model))
        else:
            continue
        if is_name(model):
            result.setdefault(model, []).append(address)
    return result


def weights_of(entry: ZooEntry) -> Path:
    """Return a model's weights, downloaded if they must be. Raises UserError: they are not its card's."""
    card, path = entry.card, entry.path.with_name(WEIGHTS)
    if entry.folders:
        # an address that a card names gets no token of the user's
        urls = [card.url] if card.url else [f"{folder}/{WEIGHTS}" for folder in entry.folders]
        again = f"; if the model has changed there, remove {entry.path}"
        place = path.relative_to(cache_home()).as_posix()
        bring = fetch if card.url else download
        return bring(urls, filename=place, sha256=card.sha256, size=card.size, hint=again)
    if not path.is_file():
        if card.url:
            return fetch(card.url, card.sha256, f"weights/{card.sha256}/{WEIGHTS}", size=card.size)
        raise UserError(f"model {card.name!r} has no weights: its card expects {str(path)!r}")
    if (result := sha256_of(path)) != card.sha256:
        remedy = "reinstall pedzoo" if shipped("checkpoints") in entry.path.parents else "get both anew"
        raise UserError(
            f"weights {str(path)!r} have sha256 {result}, but their card says {card.sha256}: {remedy}"
        )
    return path


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


def no_model(name: str, others: Iterable[str] = (), kind: str = "model") -> UserError:
    """Return the error for a name that no model has, with the nearest one of models and ``others``.

    It lists those of the same family, ``sgan_goal.*``, or else families. ``kind`` is what was expected.
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
    return sorted({*(name for folder in _sources()[0] for name in card_files(folder)), *_addresses_fetched()})


def robots() -> list[str]:
    """Return the names of those that move robots; see `pedzoo.policies.load.load_robot_policy`."""
    return [name for name in names() if name.startswith(ROBOTS)]


def _sources() -> tuple[list[Path], list[str]]:
    """Return the folders, ours first, and the addresses in which names are looked up."""
    given = [one.strip().rstrip("/") for one in os.environ.get(SOURCES, "").split(",")]
    folders = [expanded(one) for one in given if one and not is_address(one)]
    return [shipped("checkpoints"), *folders], [one for one in given if is_address(one)]
