"""Downloads, from a server on this machine."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from pedzoo.errors import UserError
from pedzoo.fetch import fetch

CONTENT = b"weights"
SUM = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Address of a folder with one file; the cache is elsewhere."""
    served = tmp_path / "served"
    served.mkdir()
    (served / "file.bin").write_bytes(CONTENT)
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    handler = partial(SimpleHTTPRequestHandler, directory=str(served))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("checksum", [SUM, None])
def test_a_file_is_downloaded_once(url: str, tmp_path: Path, checksum: str | None) -> None:
    path = fetch(f"{url}/file.bin", checksum, "models/file.bin")
    assert path == tmp_path / "cache" / "models" / "file.bin"
    assert path.read_bytes() == CONTENT
    (tmp_path / "served" / "file.bin").unlink()
    assert fetch(f"{url}/file.bin", checksum, "models/file.bin") == path


def test_a_wrong_sum_leaves_nothing(url: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not have the expected content"):
        fetch(f"{url}/file.bin", "0" * 64, "file.bin")
    assert not (tmp_path / "cache" / "file.bin").exists()


def test_no_such_file_and_no_network_say_what_to_do(url: str, tmp_path: Path) -> None:
    place = tmp_path / "cache" / "none.bin"
    for address in (f"{url}/none.bin", "http://127.0.0.1:9/none.bin"):
        with pytest.raises(UserError, match="cannot download") as caught:
            fetch(address, SUM, "none.bin", "or give weights=...")
        assert address in str(caught.value)
        assert f"save it as {place} or give weights=..." in str(caught.value)
        assert not place.exists()
