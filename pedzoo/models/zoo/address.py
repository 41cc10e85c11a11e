"""Models at addresses: ``hf://OWNER/REPO/ARCH.TAG``, ``https://HOST/FOLDER/ARCH.TAG``. Needs no torch."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote, urlsplit

from pedzoo.core.errors import UserError
from pedzoo.core.fetch import fetch
from pedzoo.core.paths import CARD, WEIGHTS, cache_home
from pedzoo.core.size_limits import LARGEST_CARD, load_yaml
from pedzoo.models.zoo.card import ModelCard, check_name, is_name

_WORD = "[A-Za-z0-9][A-Za-z0-9_.-]*"
_HUB = re.compile(f"hf://({_WORD})/({_WORD})(?:@({_WORD}))?(?:/([^/]+))?")
_FRONT = re.compile(r"---\n(.*?)\n---\n", re.DOTALL)

KEPT = "models"
"""Folder of the cache that holds what was fetched."""


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


def kept_models() -> dict[str, list[str]]:
    """Return the addresses of all models whose cards were fetched, by their plain names."""
    root = cache_home() / KEPT
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
    """Fetch a file; only the hub gets the user's ``HF_TOKEN``. Arguments as of `fetch`.

    A file without a ``size`` is a card or the page of one.
    """
    limit = LARGEST_CARD if size is None else None
    token = os.environ.get("HF_TOKEN") if all(url.startswith(f"{_hub()}/") for url in urls) else None
    return fetch(urls, sha256, filename, hint, size, limit=limit, token=token)


def _hub() -> str:
    return os.environ.get("HF_ENDPOINT", "https://huggingface.co").rstrip("/")


def _on_hub(name: str) -> ModelAddress:
    match = _HUB.fullmatch(name)
    if not match:
        raise UserError(f"{name!r}: expected hf://OWNER/REPO, with @REVISION and /ARCH.TAG where wanted")
    owner, repo, revision, model = match.groups()
    revision = revision or "main"
    url, below = f"{_hub()}/{owner}/{repo}/resolve/{revision}", f"{KEPT}/hf/{owner}/{repo}/{revision}"
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
    below = f"{KEPT}/{parts.scheme}/{quote(parts.netloc, safe='')}{folder}"
    return ModelAddress(f"{parts.scheme}://{parts.netloc}{folder}", below, model)
