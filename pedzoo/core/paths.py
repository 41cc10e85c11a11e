"""Folders and files: where they lie, what they may be called, and how they are written."""

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pedzoo.core.errors import UserError, unknown

_PACKAGE = Path(__file__).parents[1]

CARD, WEIGHTS = "card.yaml", "weights.safetensors"
"""Files of a model's own folder, which has the model's name."""

PLOTS = (".png", ".pdf", ".svg")

CODECS = {".webm": "VP90", ".mp4": "vp09"}
"""Endings of videos. VP9 is the codec that OpenCV's wheels can write and every browser can show."""

PAGES = (".html", ".htm")
"""Those that browsers open."""

REPORTS = (".json",)


def shipped(folder: str) -> Path:
    """Return ``configs`` or ``checkpoints``: beside the package in a checkout, inside it in a wheel."""
    inside = _PACKAGE / folder
    return inside if inside.is_dir() else _PACKAGE.parent / folder


def expanded(path: str | Path) -> Path:
    """Return a path with ``~`` written out; what no file can be called stays, and no file is there."""
    with suppress(ValueError):  # a zero byte
        return Path(os.path.expanduser(path))
    return Path(path)


def weight_files() -> dict[str, Path]:
    """Return the files of all shipped weights by name, in alphabetical order."""
    return {path.parent.name: path for path in sorted(shipped("checkpoints").glob(f"*/{WEIGHTS}"))}


def config_names() -> list[str]:
    """Return the names that ``--config`` accepts without a path."""
    folder = shipped("configs")
    return sorted(path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.yaml"))


def find_config(name: str) -> Path:
    """Return the file of a shipped config's name or of a path. Raises UserError: neither exists."""
    for path in (Path(name), shipped("configs") / f"{name}.yaml"):
        if path.is_file():
            return path
    raise unknown("config", name, config_names())


def data_root(root: str | None) -> Path:
    """Return the folder with recordings: ``root``, the variable ``PEDZOO_DATA``, or what was downloaded.

    Raises:
        UserError: Neither is given and nothing was downloaded, or the folder does not exist.
    """
    given = root or os.environ.get("PEDZOO_DATA")
    how = "give its folder as --data.root or in the environment variable PEDZOO_DATA"
    if not given:
        if (downloaded := data_home()).is_dir():
            return downloaded
        raise UserError(f"no recordings found: {how}; `--data.fold embedded` needs none")
    path = expanded(given)
    if not path.is_dir():
        raise UserError(f"data root {given!r} is not a folder: {how}; `--data.fold embedded` needs none")
    return path


def cache_home() -> Path:
    """Return the folder for downloads: ``PEDZOO_HOME``, or the user's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return expanded(os.environ.get("PEDZOO_HOME") or Path(base) / "pedzoo")


def data_home() -> Path:
    """Return the folder that ``pedzoo download`` brings datasets to, one folder each."""
    return cache_home() / "data"


def sha256_of(path: Path) -> str:
    """Return a file's sha256 in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


PARTS = ".*.part*"
"""Pattern of the unfinished files that a killed process leaves behind."""


def write_atomically(path: Path, data: bytes | memoryview) -> None:
    """Write a file by `atomic_write`."""
    with atomic_write(path) as part:
        part.write_bytes(data)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary file's path, and rename that file to ``path`` at the end of the block.

    An error, a full disk, a killed process or a power cut leaves the old file or the new one, never a part
    of one. A missing folder is made. Raises UserError: it cannot be written.
    """
    part = path.with_name(f".{path.stem}.{os.urandom(4).hex()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.touch(exist_ok=False)  # no link of others, who cannot know its name beforehand
        yield part
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error
    finally:
        with suppress(OSError):  # the folder is none
            part.unlink(missing_ok=True)
    if os.name != "nt":  # the names in the folder; some network disks cannot, and do it by themselves
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            with suppress(OSError):
                os.fsync(handle)
        finally:
            os.close(handle)


def check_ending(what: str, path: str | Path, endings: Iterable[str]) -> None:
    """Raise UserError for a path with another ending, in capitals or not; ``what`` begins the message."""
    if Path(path).suffix.lower() not in (allowed := tuple(endings)):
        raise UserError(f"{what}: expected a file that ends in {' or '.join(allowed)}")
