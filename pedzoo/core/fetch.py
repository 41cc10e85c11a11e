"""Downloads into the user's cache, checked and atomic: a file is there with the right content, or not at all.

The client of huggingface_hub brings the bytes from any address: it goes on after an interruption, tries again
and shows the progress. With the environment variable ``PEDZOO_OFFLINE`` set, the network is not used.
"""

import hashlib
import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from pedzoo import __version__
from pedzoo.core.adapters import pieces_as_they_come
from pedzoo.core.errors import UserError
from pedzoo.core.paths import cache_home, sha256_of


class _RefusedError(Exception):
    """This address does not give the file; another one may."""


class _WrongFileError(_RefusedError):
    """What this address gave is of no use."""


def offline() -> bool:
    """Return whether ``PEDZOO_OFFLINE`` forbids the network (unless it is empty, 0, false or no)."""
    return os.environ.get("PEDZOO_OFFLINE", "").lower() not in ("", "0", "false", "no")


def fetch(
    urls: str | Sequence[str],
    sha256: str | None,
    filename: str,
    hint: str = "",
    size: int | None = None,
    *,
    limit: int | None = None,
    folder: Path | None = None,
    token: str | None = None,
) -> Path:
    """Return the local copy of a file; download it first where it is missing or has other content.

    Two processes that want one file download it once. An interrupted download is stored beside the file and
    continued by the next call; without a ``sha256`` it starts again, because its part may be of another file.

    Args:
        urls: The file's address, or those of its mirrors in the order in which they are tried.
        sha256: Its checksum; None takes any content, and a file that is there (for what the caller checks).
        filename: Path below the folder, which it may not leave.
        hint: Another way to give the file, for the error message: "or give its path as weights=...".
        size: Its length in bytes, where it is known.
        limit: Bytes that it may have at most, where its length is not known.
        folder: Where it goes; `pedzoo.core.paths.cache_home` by default.
        token: Sent to the addresses' hosts as ``Authorization: Bearer``, and to no other.

    Raises:
        UserError: No mirror gave it, with what each of them did and the place for a file got otherwise;
            offline; or the name leads out of the folder.
    """
    target = _below(folder or cache_home(), filename)
    if _is_there(target, sha256):
        return target
    addresses = [urls] if isinstance(urls, str) else list(urls)
    way_out = f"get the file elsewhere and save it as {target} {hint}".rstrip()
    if offline():
        state = "has other content than expected" if target.exists() else "is not there"
        raise UserError(
            f"{target} {state}, and PEDZOO_OFFLINE forbids the network: unset it, or {way_out} (from "
            f"{' or '.join(addresses)})"
        )
    part, reasons = target.with_name(f".{target.name}.part"), []
    try:
        with _alone(target):
            if _is_there(target, sha256):  # another process may have brought it meanwhile
                return target
            target.parent.mkdir(parents=True, exist_ok=True)
            for url in addresses:
                try:
                    _bring(url, part, sha256, size, limit, token)
                except _RefusedError as error:
                    reasons.append(f"{url}: {error}")
                else:
                    os.replace(part, target)
                    return target
    except OSError as error:
        raise UserError(f"cannot write {target}: {error.strerror or error}") from error
    raise UserError(f"cannot download {target.name}: {'; '.join(reasons)}: {way_out}")


def _below(folder: Path, filename: str) -> Path:
    plain = PurePosixPath(filename.replace("\\", "/"))
    if plain.is_absolute() or not plain.name or ".." in plain.parts or set(filename) & {":", "\0"}:
        raise UserError(f"file name {filename!r} may lead out of {folder}: expected a path below it")
    return folder / plain


def _is_there(target: Path, sha256: str | None) -> bool:
    return target.is_file() and (sha256 is None or sha256_of(target) == sha256)


@contextmanager
def _alone(target: Path) -> Iterator[None]:
    """Keep other processes from downloading the same file while the block runs."""
    from filelock import FileLock, Timeout

    name = hashlib.sha256(str(target.absolute()).encode()).hexdigest()[:16]
    lock = FileLock(cache_home() / "locks" / f"{name}.lock")
    Path(lock.lock_file).parent.mkdir(parents=True, exist_ok=True)
    try:
        lock.acquire(timeout=1.0)
    except Timeout:
        print(f"pedzoo: waiting for another process that downloads {target.name}", file=sys.stderr)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def _bring(
    url: str, part: Path, sha256: str | None, size: int | None, limit: int | None, token: str | None
) -> None:
    """Bring the file at an address to ``part``, after what an earlier call left of it."""
    if part.is_symlink() or sha256 is None:  # the name is known to others who may write there
        part.unlink(missing_ok=True)
    resumed = part.exists() and part.stat().st_size > 0
    try:
        _transfer(url, part, size, limit, token)
        if sha256 not in (None, digest := sha256_of(part)):
            raise _WrongFileError(f"does not have the expected content: sha256 {digest}, expected {sha256}")
    except _WrongFileError:
        part.unlink(missing_ok=True)
        if not resumed:
            raise
        _bring(url, part, sha256, size, limit, token)  # part of it may be of another file


def _transfer(url: str, part: Path, size: int | None, limit: int | None, token: str | None) -> None:
    """Append the missing rest of a file to ``part``."""
    from huggingface_hub.file_download import http_get  # takes 0.2 s: only downloads pay for it

    # compressed on the way, a file's parts and its length would be those of something else
    headers = {"Accept-Encoding": "identity", "User-Agent": f"pedzoo/{__version__}"}
    headers |= {"Authorization": f"Bearer {token}"} if token else {}
    with _LimitedFile(part, size or limit) as file:
        begin = {"resume_size": file.tell(), "expected_size": size}
        try:
            with pieces_as_they_come():
                http_get(url, file, headers=headers, displayed_filename=part.name[1:-5], **begin)
        except _RefusedError:
            raise
        except Exception as error:  # the classes of the client's errors differ between its versions
            if isinstance(error, OSError) and error.errno:
                raise  # this machine's
            answer = getattr(error, "response", None)
            reason = " ".join(str(error).split()) or type(error).__name__
            if answer is not None:
                reason = f"{answer.status_code} {answer.reason_phrase}"
            elif reason.startswith("Consistency check failed"):
                reason = f"has {file.tell()} bytes, expected {size}"
            # an answer to its end that is too short, or a part that is longer than the file
            wrong = isinstance(error, OSError) and (answer is None or answer.status_code == 416)
            raise (_WrongFileError if wrong else _RefusedError)(reason) from error


class _LimitedFile(io.FileIO):
    """A file to append to: no link of others, and of a greatest length."""

    def __init__(self, path: Path, limit: int | None) -> None:
        no_link = getattr(os, "O_NOFOLLOW", 0)
        super().__init__(path, "a", opener=lambda name, flags: os.open(name, flags | no_link, 0o666))
        self.limit = limit

    def write(self, data: Any) -> int:
        if self.limit is not None and self.tell() + len(data) > self.limit:
            raise _WrongFileError(f"has more than {self.limit} bytes")
        return super().write(data)
