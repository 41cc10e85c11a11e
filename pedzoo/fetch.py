"""Downloads into the user's cache, checked and atomic: a file is there whole or not at all."""

from __future__ import annotations

from pathlib import Path

from pedzoo.errors import UserError
from pedzoo.paths import cache_home


def fetch(url: str, sha256: str | None, filename: str, hint: str = "") -> Path:
    """Return the local copy of ``url``, downloading it first where the cache does not have it.

    Args:
        url: Address of the file.
        sha256: Its expected checksum; None accepts any content (for files that the caller checks itself).
        filename: Path below the cache folder (`pedzoo.paths.cache_home`).
        hint: Another way to give the file, for the error message: "or give its path as weights=...".

    Raises:
        UserError: No network, no such file, or a wrong checksum; names the place for a file got otherwise.
    """
    import pooch  # drags in requests: only who downloads pays for it

    target = cache_home() / filename
    way_out = f"get the file elsewhere and save it as {target} {hint}".rstrip()
    pooch.get_logger().setLevel("WARNING")
    try:
        found = pooch.retrieve(
            url,
            known_hash=f"sha256:{sha256}" if sha256 else None,
            fname=target.name,
            path=target.parent,
            progressbar=not target.exists(),
        )
    except OSError as error:  # everything of requests' is an OSError too
        raise UserError(f"cannot download {url} ({error}): {way_out}") from error
    except ValueError as error:
        raise UserError(
            f"{url} does not have the expected content, sha256 {sha256}: the file has changed or was damaged "
            f"on the way; try again, or {way_out}"
        ) from error
    return Path(found)
