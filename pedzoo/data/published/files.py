"""Files that lie in public repositories at pinned commits, with a checksum each, and their mirrors."""

from dataclasses import dataclass
from pathlib import Path

from pedzoo.core.fetch import fetch

HOSTS = (
    "https://raw.githubusercontent.com/{repository}/{commit}/{path}",
    "https://cdn.jsdelivr.net/gh/{repository}@{commit}/{path}",
)
"""Addresses of a file of a GitHub repository, in the order in which they are tried for each repository."""

_FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class PublishedFile:
    """One file, the same in all its places."""

    path: str  # below the folder of the dataset
    sha256: str  # its checksum
    size: int  # bytes
    places: tuple[tuple[str, str, str], ...]  # repository, commit and path in it, the best first

    def urls(self) -> list[str]:
        """Return the addresses of all mirrors in the order in which they are tried."""
        places = [dict(zip(("repository", "commit", "path"), place, strict=True)) for place in self.places]
        return [host.format(**place) for place in places for host in HOSTS]


def published() -> list[str]:
    """Return the names of the datasets that can be downloaded."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def files_of(name: str) -> list[PublishedFile]:
    """Return the files of a dataset."""
    import yaml

    listed = yaml.safe_load((_FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))
    repositories = {key: place.split("@") for key, place in listed["repositories"].items()}
    files = []
    for path, entry in listed["files"].items():
        places = tuple((*repositories[key], place) for key, place in entry["places"].items())
        files.append(PublishedFile(path, entry["sha256"], entry["size"], places))
    return files


def bring(files: list[PublishedFile], folder: Path, name: str) -> None:
    """Download what is not there or damaged, ``name`` in the bar. Raises UserError: no mirror has it."""
    from tqdm import tqdm

    for file in tqdm(files, desc=name, unit="file", disable=None, leave=False):
        fetch(file.urls(), file.sha256, file.path, size=file.size, folder=folder)
