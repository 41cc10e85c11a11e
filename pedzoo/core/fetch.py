"""Downloads into the user's cache, checked and atomic: a file is there whole or not at all.

An interrupted download resumes where it stopped, also in a later process. A file that one mirror lacks comes
from the next one. With the environment variable ``PEDZOO_OFFLINE`` set, the network is not used. pooch has
neither resume nor mirrors, and huggingface_hub serves its own hub alone: so neither is used here.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from pedzoo import __version__
from pedzoo.core.errors import UserError
from pedzoo.core.paths import cache_home

if TYPE_CHECKING:
    import requests

TIMEOUT = (10.0, 30.0)
"""Seconds within which a server has to accept the connection, and to send each next piece of the file."""

WAITS = (0.5, 1.0, 2.0)
"""Seconds before each further try at an address. A try that brings more of the file starts the list again."""

LONGEST_WAIT = 30.0
"""Seconds that a busy server may ask for."""

BUSY = (408, 425, 429, 500, 502, 503, 504)
"""Answers that another try may change."""

PATIENCE, SLOWEST = 180.0, 1000.0
"""Seconds that any file may take, and the fewest bytes per second after that."""

_BLOCK = 1 << 13
"""Bytes per piece, at most."""

_NO_LINK = getattr(os, "O_NOFOLLOW", 0)

_FAILED: set[str] = set()
"""Hosts that failed in this process. They are asked last, so that not every file waits for them."""


class _RefusedError(Exception):
    """This address does not give the file; another one may."""


class _BrokeOffError(Exception):
    """This try did not give the whole file; the next one may, after ``wait`` seconds."""

    wait = 0.0


def offline() -> bool:
    """Return whether ``PEDZOO_OFFLINE`` forbids the network (set to anything but nothing, 0, false or no)."""
    return os.environ.get("PEDZOO_OFFLINE", "").lower() not in ("", "0", "false", "no")


def sha256_of(path: Path) -> str:
    """Return a file's sha256 in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
        size: Its length in bytes, where it is known; another one is refused without reading on.
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
    said = []
    try:
        with _alone(target):
            if _is_there(target, sha256):  # another process may have brought it meanwhile
                return target
            target.parent.mkdir(parents=True, exist_ok=True)
            for url in sorted(addresses, key=lambda url: _host(url) in _FAILED):
                try:
                    os.replace(_whole(url, target, sha256, ExpectedLength(size, limit), token), target)
                    return target
                except _RefusedError as error:
                    said.append(f"{url}: {error}")
    except OSError as error:
        raise UserError(f"cannot write {target}: {error.strerror or error}") from error
    raise UserError(f"cannot download {target.name}: {'; '.join(said)}: {way_out}")


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


def _whole(url: str, target: Path, sha256: str | None, expected: ExpectedLength, token: str | None) -> Path:
    """Try at one address until all of the file has come, and return where it is."""
    part = target.with_name(f".{target.name}.part")
    if part.is_symlink():  # the name is known to others who may write there
        part.unlink()
    clock = DownloadTimer(time.monotonic(), _length(part))
    mixed, furthest, waits = part.exists(), 0, iter(WAITS)
    while True:
        if sha256 is None:
            part.unlink(missing_ok=True)
        try:
            _stream(url, part, expected, clock, token)
        except _BrokeOffError as error:
            if (length := _length(part)) > furthest:
                furthest, waits = length, iter(WAITS)
            if (wait := next(waits, None)) is None:
                _FAILED.add(_host(url))
                raise _RefusedError(f"{error}, tried {len(WAITS) + 1} times") from error
            clock.check(length)
            time.sleep(max(wait, error.wait))
            continue
        digest = sha256_of(part)
        if sha256 in (None, digest):
            return part
        part.unlink()
        if not mixed:
            raise _RefusedError(f"does not have the expected content: sha256 {digest}, expected {sha256}")
        mixed = False  # part of it is of an earlier download: try once more from the start


class ExpectedLength(NamedTuple):
    """The known length of a file, or the greatest that is accepted."""

    size: int | None
    limit: int | None

    def check(self, length: int) -> None:
        """Check a length that a server has sent or announced."""
        if self.size is not None and length > self.size:
            raise _RefusedError(f"has more than the expected {self.size} bytes")
        if self.limit is not None and length > self.limit:
            raise _RefusedError(f"has {length} bytes, and at most {self.limit} are read of such a file")


class DownloadTimer(NamedTuple):
    """When a download began, and how much of the file was there then."""

    began: float
    had: int

    def check(self, length: int) -> None:
        """Check that the server is fast enough, its interruptions included."""
        seconds = time.monotonic() - self.began
        got = max(length - self.had, 0)
        if seconds > PATIENCE + got / SLOWEST:
            raise _RefusedError(f"gave {got} bytes in {seconds:.0f} s: too slow, try again later")


def _host(url: str) -> str:
    return url.partition("://")[2].partition("/")[0]


def _length(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _stream(url: str, part: Path, expected: ExpectedLength, clock: DownloadTimer, token: str | None) -> None:
    """Ask once for the missing rest of a file. Append it to ``part``, or begin ``part`` anew."""
    import requests  # takes 0.1 s: only downloads pay for it
    import urllib3

    class Session(requests.Session):
        def rebuild_auth(self, prepared_request: Any, response: Any) -> None:  # not from .netrc
            if self.should_strip_auth(response.request.url, prepared_request.url):
                prepared_request.headers.pop("Authorization", None)

    # Compressed on the way, a file's parts and its length would be those of something else.
    headers = {"Accept-Encoding": "identity", "User-Agent": f"pedzoo/{__version__}"}
    headers |= {"Authorization": f"Bearer {token}"} if token else {}
    if start := _length(part):
        headers["Range"] = f"bytes={start}-"
    # without ``auth`` requests takes that of .netrc
    asked: dict[str, Any] = {"stream": True, "timeout": TIMEOUT, "auth": lambda request: request}
    again = requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError
    try:
        with Session() as session, session.get(url, headers=headers, **asked) as answer:
            _read(answer, part, start, expected, clock)
    except urllib3.exceptions.HTTPError as error:  # while the file comes: requests is not between
        raise _BrokeOffError(_root(error)) from error
    except requests.RequestException as error:
        final = isinstance(error, requests.exceptions.SSLError) or not isinstance(error, again)
        raise (_RefusedError if final else _BrokeOffError)(_root(error)) from error


def _read(
    answer: requests.Response, part: Path, start: int, expected: ExpectedLength, clock: DownloadTimer
) -> None:
    from tqdm import tqdm

    size = expected.size
    said, where = f"{answer.status_code} {answer.reason}", answer.headers.get("Content-Range", "")
    goes_on = answer.status_code == 206 and start > 0
    if answer.status_code == 416 and where == f"bytes */{start}":
        return  # nothing was missing
    if answer.status_code == 416 or (goes_on and not where.startswith(f"bytes {start}-")):
        part.unlink()
        raise _BrokeOffError(f"cannot go on at byte {start}")
    if answer.status_code in BUSY:
        error, asked = _BrokeOffError(said), answer.headers.get("Retry-After", "")
        error.wait = min(float(asked), LONGEST_WAIT) if asked.isdecimal() else 0.0
        raise error
    if not answer.ok:
        raise _RefusedError(said)
    done = start if goes_on else 0
    length = answer.headers.get("Content-Length", "")
    total = done + int(length) if length.isdecimal() else size
    if size is not None and total != size:
        raise _RefusedError(f"has {total} bytes, expected {size}")
    expected.check(total or 0)
    if answer.headers.get("Content-Encoding", "identity") != "identity":
        raise _RefusedError("is sent compressed, although that was not asked for")
    look = {"unit": "B", "unit_scale": True, "disable": None, "leave": False, "delay": 0.5}
    bar = tqdm(total=total, initial=done, desc=part.name[1:-5], **look)
    mode = "ab" if goes_on else "wb"
    with bar, open(part, mode, opener=lambda *at: os.open(at[0], at[1] | _NO_LINK, 0o666)) as file:
        # all bytes that have come: `iter_content` waits for whole blocks
        while block := answer.raw.read1(_BLOCK):
            done += file.write(block)
            bar.update(len(block))
            expected.check(done)
            clock.check(done)
    if size is not None and done < size:
        raise _BrokeOffError(f"broke off after {done} of {size} bytes")


def _root(error: BaseException) -> str:
    """Return what an exception of requests' comes from, without the layers about it."""
    for inner in (getattr(error, "reason", None), error.__cause__, *error.args):
        if isinstance(inner, Exception):
            return _root(inner)
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
